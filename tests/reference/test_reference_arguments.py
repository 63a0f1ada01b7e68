"""Columns of any kind give the same volume; every bad argument is named with its rule."""

import re
from pathlib import Path

import numpy as np
import pytest
import tnt_reference
import torch
from tnt_reference import event_volume, tnt_volume

WINDOW = dict(start_us=1_000, window_us=5_000, sensor=(34, 34), grid=(34, 34))
T, X, Y, P = [1_200, 1_300, 5_000, 6_000], [0, 33, 17, 5], [33, 0, 16, 4], [1, 0, 0, 1]
RECORDS = np.array(list(zip(P, T, X, Y, strict=True)), [("p", "u1"), ("t", "<i8"), ("x", "<u2"), ("y", "<u2")])
RECORDS.flags.writeable = False
KINDS = {
    "lists": (T, X, Y, P),
    "fields of read-only records": tuple(RECORDS[name] for name in "txyp"),
    "unsigned": (np.array(T, "u8"), np.array(X, "u1"), np.array(Y, "u1"), np.array(P, bool)),
    "small signed": (np.array(T, "i2"), np.array(X, "i1"), np.array(Y, "i1"), 2 * np.array(P, "i1") - 1),
    "small tensors": tuple(
        torch.tensor(column, dtype=dtype)
        for column, dtype in zip((T, X, Y, P), (torch.int16, torch.uint16, torch.uint8, torch.bool), strict=True)
    ),
    "floats": ([float(a) for a in T], np.array(X, "f4"), torch.tensor(Y).double(), [1.0, -1.0, -1.0, 1.0]),
}


@pytest.mark.parametrize("kind", KINDS)
def test_columns_of_any_kind_give_the_same_volume_and_stay_as_they_are(kind):
    tensors = tuple(torch.tensor(column) for column in (T, X, Y, P))
    expected = tnt_volume(*tensors, **WINDOW, landmark="line", remove_flow=True)
    before = [list(column) for column in KINDS[kind]]
    assert expected.abs().sum() > 1
    assert torch.equal(tnt_volume(*KINDS[kind], **WINDOW, landmark="line", remove_flow=True), expected)
    assert torch.equal(event_volume(*KINDS[kind], **WINDOW), event_volume(*tensors, **WINDOW))
    assert [list(column) for column in KINDS[kind]] == before


def test_lists_of_floats_keep_their_microseconds():
    """Left to itself, torch would make float32 of Python floats: 1e9 + 301 would become 1e9 + 320."""
    at = dict(start_us=10**9, window_us=800, sensor=(5, 5), grid=(5, 5))
    assert event_volume([1e9 + 301.0], [1], [3], [1], **at)[3, 3, 1].item() == pytest.approx(0.99)


BAD = [
    (dict(x=[0, 34, 17, 5]), ValueError, r"`x` must be in \[0, 33\], inside the sensor, got 34 at event 1"),
    (dict(t=[float("inf"), 0, 1, 9]), ValueError, r"`t` must be finite, got inf at event 0"),
    (dict(t=torch.tensor(T).float()), TypeError, r"`t` must hold integers or float64, got torch.float32"),
    (dict(x=[1, 2, 3]), ValueError, r"event columns must have one length, got {'t': 4, 'x': 3, 'y': 4}"),
    (dict(p=[1, 0, 1, 0.5]), ValueError, r"`p` must be bool, 0/1 or -1/\+1, got 0.5 at event 3"),
    (dict(window_us=0), ValueError, r"`window_us` must be positive, got 0; .* pass at least 1"),
    (dict(sensor=(34, 1)), ValueError, r"`sensor` must have sides of at least 2 pixels, got \(34, 1\)"),
    (dict(bins=0), ValueError, r"`bins` must be at least 1, got 0"),
    (dict(t_max=float("nan")), ValueError, r"`t_max` must be positive and finite, got nan"),
    (dict(landmark=(1, 2, 3)), ValueError, r"shape \(2,\) or \(4, 2\), one row an event, got \(3,\)"),
    (dict(remove_flow=True), ValueError, r"`remove_flow` needs the flow fitted by landmark 'line', got .* 'running'"),
]


@pytest.mark.parametrize(("bad", "error", "message"), BAD)
def test_bad_arguments(bad, error, message):
    with pytest.raises(error, match=message):
        tnt_volume(**{**dict(t=T, x=X, y=Y, p=P), **WINDOW, **bad})


def test_the_reference_imports_nothing_of_what_it_is_compared_with():
    for path in Path(tnt_reference.__file__).parent.rglob("*.py"):
        imported = set(re.findall(r"^ *(?:from|import) +(\w+)", path.read_text(encoding="utf-8"), re.MULTILINE))
        assert imported <= {"__future__", "collections", "itertools", "math", "operator", "typing", "numpy", "torch"}
