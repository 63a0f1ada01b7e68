"""Columns of any kind give the same volume; every bad argument says what is wrong with it."""

import os
import subprocess
import sys

import numpy as np
import pytest
import tnt_reference
import torch
from tnt_reference import Pipeline, event_volume, fitted_flow, landmark, tnt_coordinates, tnt_volume

WINDOW = dict(start_us=1_000, window_us=5_000, sensor=(34, 34), grid=(34, 34))
T, X, Y, P = [1_200, 1_300, 5_000, 6_000], [0, 33, 17, 5], [33, 0, 16, 4], [1, 0, 0, 1]


def structured():
    """Fields of a packed record: strided, not aligned, as read from a file."""
    events = np.zeros(4, dtype=[("p", "u1"), ("t", "<i8"), ("x", "<u2"), ("y", "<u2")])
    events["t"], events["x"], events["y"], events["p"] = T, X, Y, P
    return events["t"], events["x"], events["y"], events["p"]


def read_only():
    columns = np.array(T), np.array(X, "u2"), np.array(Y, "u2"), np.array(P, bool)
    for column in columns:
        column.flags.writeable = False
    return columns


KINDS = {
    "lists": (T, X, Y, P),
    "the door's columns": (np.array(T), np.array(X, "u2"), np.array(Y, "u2"), np.array(P, "u1")),
    "unsigned": (np.array(T, "u8"), np.array(X, "u1"), np.array(Y, "u1"), np.array(P, bool)),
    "small signed": (np.array(T, "i2"), np.array(X, "i1"), np.array(Y, "i1"), 2 * np.array(P, "i1") - 1),
    "reversed views": tuple(np.array(c[::-1])[::-1] for c in (T, X, Y, P)),
    "packed record": structured(),
    "read-only": read_only(),
    "tensors": tuple(torch.tensor(c) for c in (T, X, Y, P)),
    "small tensors": (
        torch.tensor(T, dtype=torch.int16),
        torch.tensor(X, dtype=torch.uint16),
        torch.tensor(Y, dtype=torch.uint8),
        torch.tensor(P, dtype=torch.bool),
    ),
    "floats": ([float(a) for a in T], np.array(X, "f4"), torch.tensor(Y).double(), [1.0, -1.0, -1.0, 1.0]),
}


@pytest.mark.parametrize("kind", KINDS)
def test_columns_of_any_kind_give_the_same_volume(kind):
    expected = tnt_volume(*KINDS["tensors"], **WINDOW)
    assert expected.abs().sum() > 1
    assert torch.equal(tnt_volume(*KINDS[kind], **WINDOW), expected)
    assert torch.equal(event_volume(*KINDS[kind], **WINDOW), event_volume(T, X, Y, P, **WINDOW))


def test_float64_lists_keep_their_microseconds():
    """Left to itself, torch would make float32 of Python floats: 1e9 + 301 would become 1e9 + 320."""
    at = dict(start_us=10**9, window_us=800, sensor=(5, 5), grid=(5, 5))
    volume = event_volume([1e9 + 301.0], [1], [3], [1], **at)
    assert volume[3, 3, 1].item() == pytest.approx(0.99)


def test_the_callers_columns_stay_as_they_are():
    columns = KINDS["the door's columns"], KINDS["small tensors"]
    before = [[c.tolist() for c in events] for events in columns]
    for events in columns:
        tnt_volume(*events, **WINDOW, landmark="line", remove_flow=True)
        event_volume(*events, **WINDOW, polarity="split")
    assert [[c.tolist() for c in events] for events in columns] == before


def test_a_given_landmark_stays_as_it_is_and_may_be_an_array():
    point = np.array([3.0, 4.0])
    point.flags.writeable = False
    expected = tnt_volume(T, X, Y, P, **WINDOW, landmark=(3.0, 4.0))
    assert expected.abs().sum() > 0
    assert torch.equal(tnt_volume(T, X, Y, P, **WINDOW, landmark=point), expected)
    assert torch.equal(tnt_volume(T, X, Y, P, **WINDOW, landmark=[[3, 4]] * 4), expected)


def test_a_named_landmark_equals_its_rows_given():
    for name in ("center", "running", "line", "window"):
        rows = landmark(name, T, X, Y, **WINDOW)
        by_rows, by_name = (tnt_volume(T, X, Y, P, **WINDOW, landmark=which) for which in (rows, name))
        assert by_name.abs().sum() > 0
        assert torch.equal(by_rows, by_name)


BAD_EVENTS = [
    (dict(x=[0, 34, 17, 5]), ValueError, r"`x` must be in \[0, 33\], inside the sensor, got 34 at event 1"),
    (dict(x=[0, 3, -1, 5]), ValueError, r"`x` must be in \[0, 33\], inside the sensor, got -1 at event 2"),
    (dict(y=[0, 3, 1, 99]), ValueError, r"`y` must be in \[0, 33\], inside the sensor, got 99 at event 3"),
    (dict(y=[0, float("nan"), 1, 9]), ValueError, r"`y` must be in .*, got nan at event 1"),
    (dict(t=[float("inf"), 0, 1, 9]), ValueError, r"`t` must be finite, got inf at event 0"),
    (dict(t=torch.tensor(T).float()), TypeError, r"`t` must hold integers or float64, got torch.float32"),
    (dict(t=[T]), ValueError, r"`t` must be one-dimensional, got shape \(1, 4\)"),
    (dict(x=[1j] * 4), TypeError, r"`x` must hold real numbers, got torch.complex"),
    (dict(x=[1, 2, 3]), ValueError, r"event columns must have one length, got {'t': 4, 'x': 3, 'y': 4}"),
    (dict(p=[1, 0, 1]), ValueError, r"`p` must be as long as `t`: got 3 and 4"),
    (dict(p=[1, 0, 2, 0]), ValueError, r"`p` must be bool, 0/1 or -1/\+1, got 2 at event 2"),
    (dict(p=[1, 0, 1, 0.5]), ValueError, r"`p` must be bool, 0/1 or -1/\+1, got 0.5 at event 3"),
]
BAD_SETTINGS = [
    (dict(window_us=0), ValueError, r"`window_us` must be positive, got 0; .* pass at least 1"),
    (dict(window_us=1e5), TypeError, r"`window_us` must be a whole number, got 100000.0"),
    (dict(start_us=0.5), TypeError, r"`start_us` must be a whole number, got 0.5"),
    (dict(sensor=(34, 1)), ValueError, r"`sensor` must have sides of at least 2 pixels, got \(34, 1\)"),
    (dict(sensor=34), TypeError, r"`sensor` must be \(width, height\), two whole numbers, got 34"),
    (dict(grid=(34, 34, 2)), TypeError, r"`grid` must be \(width, height\), .* got \(34, 34, 2\)"),
    (dict(grid=(1, 34)), ValueError, r"`grid` must have sides of at least 2 pixels, got \(1, 34\)"),
    (dict(bins=0), ValueError, r"`bins` must be at least 1, got 0"),
    (dict(bins=9.0), TypeError, r"`bins` must be a whole number, got 9.0"),
    (dict(polarity="both"), ValueError, r"`polarity` must be one of signed, unsigned, split, got 'both'"),
    (dict(dtype=torch.int64), TypeError, r"`dtype` must be a floating-point type, got torch.int64"),
]
BAD_TRANSFORM = [
    (dict(t_max=0), ValueError, r"`t_max` must be positive and finite, got 0"),
    (dict(t_max=float("nan")), ValueError, r"`t_max` must be positive and finite, got nan"),
    (dict(landmark="middle"), ValueError, r"one of center, running, line, window, or .* got 'middle'"),
    (dict(landmark="regressor"), ValueError, r"landmark 'regressor' needs a network: use Pipeline"),
    (dict(landmark=(1, 2, 3)), ValueError, r"shape \(2,\) or \(4, 2\), one row an event, got \(3,\)"),
    (dict(landmark=torch.zeros(3, 2)), ValueError, r"must have shape \(2,\) or \(4, 2\).*, got \(3, 2\)"),
    (dict(landmark=(1, float("nan"))), ValueError, r"`landmark` must be finite, got NaN or infinity"),
    (
        dict(landmark="running", remove_flow=True),
        ValueError,
        r"`remove_flow` needs the flow fitted by landmark 'line', got landmark 'running'",
    ),
]


@pytest.mark.parametrize("bad, error, message", BAD_EVENTS + BAD_SETTINGS, ids=lambda a: str(a)[:40])
def test_bad_arguments_of_both_volumes(bad, error, message):
    arguments = {**dict(t=T, x=X, y=Y, p=P), **WINDOW, **bad}
    for volume in (event_volume, tnt_volume):
        with pytest.raises(error, match=message):
            volume(**arguments)


@pytest.mark.parametrize("bad, error, message", BAD_TRANSFORM, ids=lambda a: str(a)[:40])
def test_bad_arguments_of_the_transform(bad, error, message):
    arguments = {**dict(t=T, x=X, y=Y), **WINDOW, **bad}
    with pytest.raises(error, match=message):
        tnt_coordinates(**arguments)
    with pytest.raises(error, match=message):
        tnt_volume(p=P, **arguments)


def test_bad_arguments_of_landmark_and_flow():
    with pytest.raises(ValueError, match=r"`x` must be in \[0, 33\], inside the sensor, got 34 at event 0"):
        landmark("running", T, [34, 0, 0, 0], Y, **WINDOW)
    with pytest.raises(ValueError, match=r"`grid` must have sides of at least 2 pixels, got \(0, 34\)"):
        fitted_flow(T, X, Y, **{**WINDOW, "grid": (0, 34)})


def test_all_names_are_there():
    assert all(hasattr(tnt_reference, name) for name in tnt_reference.__all__)
    assert Pipeline.__name__ in tnt_reference.__all__


def test_the_reference_imports_nothing_of_what_it_is_held_against():
    """A child process that can import both says what importing the reference brought in."""
    code = "import sys, tnt_reference; print({'async_tnt', 'numba'} & set(sys.modules))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert child.stdout.strip() == "set()", child.stderr
