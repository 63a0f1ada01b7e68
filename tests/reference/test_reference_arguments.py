"""Every bad argument is named with its rule.

The reference shares no code with what it is compared with.
"""

import re
from pathlib import Path

import pytest
import tnt_reference
import torch
from tnt_reference import Classifier, LandmarkRegressor, Pipeline, tnt_volume
from tnt_reference.moving_image import shift_matrix

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
    (dict(t_max=-1), ValueError, r"`t_max` must be positive and finite, got -1"),
    (dict(t_max=float("nan")), ValueError, r"`t_max` must be positive and finite, got nan"),
    (dict(t_max=float("inf")), ValueError, r"`t_max` must be positive and finite, got inf"),
    (
        dict(landmark=(1, 2, 3)),
        ValueError,
        r"shape \(2,\) or \(4, 2\), one row an event, got \(3,\)",
    ),
    (dict(landmark=(1, float("nan"))), ValueError, r"`landmark` must be finite, got NaN"),
    (dict(landmark=(float("inf"), 1)), ValueError, r"`landmark` must be finite, got "),
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
    (lambda: shift_matrix(4, torch.zeros(())), "`n` must be odd, got 4"),
    (
        lambda: tnt_reference.LayerNetwork([{"op": "mish", "name": "a", "inputs": ["volume"]}], {}),
        "an op of layers must be one of conv, .*, got 'mish'",
    ),
    (
        lambda: Classifier(grid=(9, 3)),
        r"`grid` must have sides of at least 4 pixels, to be halved twice, got \(9, 3\)",
    ),
    *(
        (
            lambda network=network, shape=shape: network(grid=(5, 4))(torch.zeros(shape)),
            r"`volume` must have shape .* with \(C, H, W\) = \(9, 4, 5\), got ",
        )
        for network in (Classifier, LandmarkRegressor)
        for shape in ((9, 5, 4), (8, 4, 5), (4, 5), (1, 1, 9, 4, 5))
    ),
    (
        lambda: pipeline(representation="surface"),
        "`representation` must be one of volume, count, count_time, .*, got 'surface'",
    ),
    (
        lambda: pipeline(representation="count"),
        "`bins` must be 1 with representation 'count', got 9",
    ),
    (
        lambda: pipeline(representation="mean_time", bins=1),
        "`transform` must be 'none' with representation 'mean_time', got 'tnt'",
    ),
    (lambda: pipeline(transform="raw"), "`transform` must be 'tnt' or 'none', got 'raw'"),
    (lambda: pipeline(landmark="middle"), "`landmark` must be one of .*regressor; got 'middle'"),
    (lambda: pipeline(polarity="both"), "`polarity` must be one of signed, .*, got 'both'"),
    (lambda: pipeline(remove_flow=True), "`remove_flow` needs the flow fitted by landmark 'line'"),
    (
        lambda: pipeline(landmark="regressor"),
        "go together: got landmark 'regressor' and regressor NoneType",
    ),
    (
        lambda: pipeline(regressor=LandmarkRegressor()),
        "go together: got landmark 'running' and regressor LandmarkRegressor",
    ),
    (
        lambda: pipeline(polarity="split"),
        r"the classifier is built for \(channels, grid\) \(9, \(34, 34\)\), these settings give "
        r"\(18, \(34, 34\)\)",
    ),
    (
        lambda: pipeline(landmark="regressor", regressor=LandmarkRegressor(grid=(8, 8))),
        r"the regressor is built for \(channels, grid\) \(9, \(8, 8\)\), these settings give ",
    ),
    (lambda: pipeline().batch([]), "`windows` must hold at least one .*, got none"),
]


def pipeline(**settings):
    return Pipeline(Classifier(), **{"sensor": (34, 34), "window_us": 1_000, **settings})


@pytest.mark.parametrize(("call", "message"), OTHERS)
def test_bad_arguments_of_other_functions(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_events_that_are_counted_have_whole_pixels():
    with pytest.raises(TypeError, match="`x` and `y` must be whole pixels"):
        tnt_reference.count_image(T, [0.5, 1, 2, 3], Y, P, sensor=(34, 34))


def test_the_reference_imports_nothing_of_what_it_is_compared_with():
    standard = {"__future__", "collections", "itertools", "math", "operator", "typing"}
    for path in Path(tnt_reference.__file__).parent.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        imported = set(re.findall(r"^ *(?:from|import) +(\w+)", text, re.MULTILINE))
        assert imported <= standard | {"numpy", "torch"}
