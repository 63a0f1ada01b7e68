"""Every bad argument is named with its rule.

The reference shares no code with what it is compared with.
"""

import re
from pathlib import Path

import pytest
import tnt_reference
import torch
from tnt_reference import tnt_volume

WINDOW = dict(start_us=1_000, window_us=5_000, sensor=(34, 34), grid=(34, 34))
T = [1_200, 1_300, 5_000, 6_000]
X = [0, 33, 17, 5]
Y = [33, 0, 16, 4]
P = [1, 0, 0, 1]

BAD = [
    (
        dict(x=[0, 34, 17, 5]),
        ValueError,
        r"`x` must be in \[0, 33\], inside the sensor, got 34 at event 1",
    ),
    (
        dict(y=[33, 0, -1, 4]),
        ValueError,
        r"`y` must be in \[0, 33\], inside the sensor, got -1 at event 2",
    ),
    (dict(x=[[0, 33, 17, 5]]), ValueError, r"`x` must be one-dimensional, got shape \(1, 4\)"),
    (dict(t=[1j, 2, 3, 4]), TypeError, r"`t` must hold real numbers, got torch.complex64"),
    (dict(t=[float("inf"), 0, 1, 9]), ValueError, r"`t` must be finite, got inf at event 0"),
    (
        dict(t=torch.tensor(T).float()),
        TypeError,
        r"`t` must hold integers or float64, got torch.float32",
    ),
    (
        dict(x=[1, 2, 3]),
        ValueError,
        r"event columns must have one length, got {'t': 4, 'x': 3, 'y': 4}",
    ),
    (dict(p=[1, 0, 1]), ValueError, r"`p` must be as long as `t`: got 3 and 4"),
    (dict(p=[1, 0, -2, 1]), ValueError, r"`p` must be bool, 0/1 or -1/\+1, got -2 at event 2"),
    (dict(p=[1, 0, 1, 0.5]), ValueError, r"`p` must be bool, 0/1 or -1/\+1, got 0.5 at event 3"),
    (dict(window_us=0), ValueError, r"`window_us` must be positive, got 0; .* pass at least 1"),
    (
        dict(sensor=(34, 0)),
        ValueError,
        r"`sensor` must have sides of at least 1 pixels, got \(34, 0\)",
    ),
    (
        dict(grid=(34, 1)),
        ValueError,
        r"`grid` must have sides of at least 2 pixels, got \(34, 1\)",
    ),
    (dict(grid=34), TypeError, r"`grid` must be \(width, height\), two whole numbers, got 34"),
    (dict(grid=(2.0, 2)), TypeError, r"`grid` must be \(width, height\), two whole numbers"),
    (dict(start_us=0.5), TypeError, r"`start_us` must be a whole number, got 0\.5"),
    (dict(bins=0), ValueError, r"`bins` must be at least 1, got 0"),
    (dict(polarity="both"), ValueError, r"must be one of signed, unsigned, split, got 'both'"),
    (dict(dtype=torch.int64), TypeError, r"`dtype` must be a floating-point type, got torch.int64"),
    (dict(t_max=0), ValueError, r"`t_max` must be positive and finite, got 0"),
    (dict(t_max=float("nan")), ValueError, r"`t_max` must be positive and finite, got nan"),
    (
        dict(landmark=(1, 2, 3)),
        ValueError,
        r"shape \(2,\) or \(4, 2\), one row an event, got \(3,\)",
    ),
    (dict(landmark=(1, float("nan"))), ValueError, r"`landmark` must be finite, got NaN"),
    (dict(landmark="middle"), ValueError, r"`landmark` must be one of center, running, line, win"),
    (dict(landmark="regressor"), ValueError, r"landmark 'regressor' needs a network"),
    (
        dict(remove_flow=True),
        ValueError,
        r"`remove_flow` needs the flow fitted by landmark 'line', got .* 'running'",
    ),
]


@pytest.mark.parametrize(("bad", "error", "message"), BAD)
def test_bad_arguments(bad, error, message):
    with pytest.raises(error, match=message):
        tnt_volume(**{**dict(t=T, x=X, y=Y, p=P), **WINDOW, **bad})


# what computes only some of the things that the rules above are about
AT = dict(start_us=1_000, window_us=5_000, sensor=(34, 34))
OTHERS = [
    (
        lambda: tnt_reference.time_image(
            T, X, Y, P, **WINDOW, representation="count_time", polarity="signed"
        ),
        "`polarity` must be 'split' or 'unsigned': times have no sign",
    ),
    (
        lambda: tnt_reference.time_image(T, X, Y, P, **WINDOW, representation="count"),
        "`representation` must be 'count_time', 'mean_time' or 'time_surface', got 'count'",
    ),
    (
        lambda: tnt_reference.count_timestamp_image(T, X, Y, P[1:], **AT),
        "`p` must be as long as `t`: got 3 and 4",
    ),
    (
        lambda: tnt_reference.move_by_flow(T, X, Y, (1, 2, 3), start_us=0, window_us=1),
        r"`flow` must be \(v_x, v_y\), got shape \(3,\)",
    ),
    (
        lambda: tnt_reference.move_by_flow(T, X, Y, (1, 2), start_us=0, window_us=0),
        "`window_us` must be positive, got 0",
    ),
    (lambda: tnt_reference.windows_of_events(T, 0), "`n` must be at least 1, got 0"),
]


@pytest.mark.parametrize(("call", "message"), OTHERS)
def test_bad_arguments_of_other_functions(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_the_reference_imports_nothing_of_what_it_is_compared_with():
    standard = {"__future__", "collections", "itertools", "math", "operator", "typing"}
    for path in Path(tnt_reference.__file__).parent.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        imported = set(re.findall(r"^ *(?:from|import) +(\w+)", text, re.MULTILINE))
        assert imported <= standard | {"numpy", "torch"}
