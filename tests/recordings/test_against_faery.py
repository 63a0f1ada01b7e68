"""What faery writes is read as faery reads it; and where its times differ from ours, on bytes made by hand."""

import numpy as np
import pytest
from recordings.written import evt2, evt3, evt_header, made_events

from async_tnt.sources.files.recording import open_recording

faery = pytest.importorskip("faery", reason="needs the extra `files`")
SENSOR = (1280, 720)


def theirs(events):
    packed = np.empty(len(events), faery.EVENTS_DTYPE)
    for name, ours in (("t", "t"), ("x", "x"), ("y", "y"), ("on", "p")):
        packed[name] = events[ours]
    return packed


@pytest.mark.parametrize(
    ("suffix", "version"), [(".raw", "evt2"), (".raw", "evt3"), (".dat", "dat2"), (".es", None), (".aedat4", None)]
)
def test_faerys_files_are_read_back(tmp_path, suffix, version):
    events = made_events(30_000, sensor=SENSOR)
    path = tmp_path / f"a{suffix}"
    faery.events_stream_from_array(theirs(events), SENSOR).to_file(path, version=version)
    recording = open_recording(path)
    if suffix == ".es":  # the format has no t0: faery takes it off
        events["t"] -= events["t"][0]
    np.testing.assert_array_equal(recording.read(), events)
    assert recording.sensor == SENSOR


def read_both(path, data):
    path.write_bytes(data)
    return open_recording(path).read()["t"], faery.events_stream_from_file(path).to_array()["t"].astype(np.int64)


def test_faery_holds_times_that_step_back(tmp_path):
    """Why EVT is not read by faery: a time that is 11 us before the last one becomes the last one."""
    words = np.array([0x8001, 0x6010, 0x0009, 0x2001, 0x6005, 0x2002, 0x6011, 0x2003], "<u2")
    ours, held = read_both(tmp_path / "a.raw", evt_header("3.0") + words.tobytes())
    assert ours.tolist() == [4112, 4101, 4113]
    assert held.tolist() == [4112, 4112, 4113]

    events = made_events(2_000)
    events["t"][::7] -= 11
    ours, held = read_both(tmp_path / "a.raw", evt3(events))
    np.testing.assert_array_equal(ours, events["t"])
    assert (held - ours).max() == 11


def test_faery_takes_a_step_back_in_evt2_for_a_wrap(tmp_path):
    events = made_events(2_000)
    events["t"][::7] -= 11
    ours, theirs_us = read_both(tmp_path / "a.raw", evt2(events))
    np.testing.assert_array_equal(ours, events["t"])
    assert (theirs_us - ours).max() >= 1 << 34  # 4.8 hours


def test_times_agree_where_they_never_step_back(tmp_path):
    for make in (evt2, evt3):
        ours, theirs_us = read_both(tmp_path / "a.raw", make(made_events(2_000)))
        np.testing.assert_array_equal(ours, theirs_us)
