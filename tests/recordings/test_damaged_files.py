"""Files cut short at every byte, and damage by hand: a prefix of the events, a clear word, or a ValueError."""

from io import BytesIO

import numpy as np
import pytest
from recordings.damaging import EVERY_WRITER, read
from recordings.written import dat, es, evt2, evt3, evt_header, made_events, uzh_text

from async_tnt.sources.files.child_end import Out
from async_tnt.sources.files.damage import DamagedRecording
from async_tnt.sources.files.hdf5_child import write_events
from async_tnt.sources.files.recording import open_recording

# bytes an event has: a file cut between two events is a whole file, and nothing can tell
WHOLE_AGAIN = (".raw", ".dat", ".es", ".txt", ".csv", ".bin")
SMALL = (34, 34)


@pytest.mark.parametrize("name", sorted(EVERY_WRITER))
def test_a_file_cut_at_any_byte_gives_its_first_events(tmp_path, name):
    events = made_events(40, step_us=300, sensor=SMALL)
    path = tmp_path / name
    EVERY_WRITER[name](path, events, SMALL)
    data = path.read_bytes()
    step = len(data) // 8 if name.endswith((".aedat4", ".h5", ".hdf5")) else 1  # a process for each pass
    n_refused = n_warned = n_silent = 0
    for size in range(0, len(data), step):
        path.write_bytes(data[:size])
        got, told, _ = read(path)
        if got is None:
            n_refused += 1
            continue
        n_warned += len(told)
        n_silent += not told
        np.testing.assert_array_equal(got, events[: len(got)])
        if told:
            assert f"Keeping the {len(got)} events before" in str(told[0].message)
            refused, _, _ = read(path, strict=True)
            assert refused is None
        elif not name.endswith(WHOLE_AGAIN) and len(got) < len(events):
            pytest.fail(f"{name} cut to {size} of {len(data)} bytes: {len(got)} events, and nothing said")
    assert n_refused + n_warned > 0
    if name in ("v2.dat", "evt2.raw"):
        assert n_silent <= len(data) // 4 + 1
    if name == "plain.bin":
        assert n_silent == len(events)


@pytest.mark.parametrize("name", ["dsec.h5", "metavision.hdf5"])
def test_a_hdf5_file_cut_at_every_byte_is_refused(tmp_path, name):
    """What the process of its own does, without one."""
    path = tmp_path / name
    EVERY_WRITER[name](path, made_events(5), SMALL)
    data = path.read_bytes()
    for size in range(len(data)):
        path.write_bytes(data[:size])
        out = BytesIO()
        write_events(str(path), Out(out))
        assert out.getvalue().startswith(b'{"error": "not a readable HDF5 file: ') and out.getvalue().count(b"\n") == 1
    path.write_bytes(data)
    write_events(str(path), Out(out := BytesIO()))
    assert b"error" not in out.getvalue()


def test_an_event_off_the_sensor_is_damage(tmp_path):
    for name, make in (("a.txt", uzh_text), ("a.raw", evt3), ("b.raw", evt2), ("a.dat", dat)):
        events = made_events(2_000)
        events["x"][1_234] = 320
        (tmp_path / name).write_bytes(make(events))
        with pytest.warns(DamagedRecording, match="event 1234 at x = 320, y = .* is off the 320 x 240 sensor") as told:
            got = open_recording(tmp_path / name).read()
        assert f"Keeping the 1234 events before, up to {events['t'][1233]} us." in str(told[0].message)
        np.testing.assert_array_equal(got, events[:1_234])
        with pytest.raises(ValueError, match="pass strict=False for the 1234 events before"):
            open_recording(tmp_path / name, strict=True).read()


def test_an_es_event_off_the_sensor_is_damage(tmp_path):
    events = made_events(20)
    events["x"][12] = 321
    (tmp_path / "a.es").write_bytes(es(events))
    with pytest.warns(DamagedRecording, match=r"the event at byte \d+ is off the 320 x 240 sensor"):
        np.testing.assert_array_equal(open_recording(tmp_path / "a.es").read(), events[:12])


def test_one_warning_however_often_it_is_read(tmp_path):
    (tmp_path / "a.dat").write_bytes(dat(made_events(9))[:-3])
    recording = open_recording(tmp_path / "a.dat")
    with pytest.warns(DamagedRecording, match="the file ends 5 bytes into event 8, which has 8") as told:
        assert (recording.n_events, len(recording.read()), len(list(recording))) == (8, 8, 1)
    assert len(told) == 1


def test_a_header_alone_tells_what_is_missing(tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(b"% evt 4.0\n")
    with pytest.raises(ValueError, match=r"`% evt` 2.0, 2.1 or 3.0, or `% format` EVT2, EVT21 or EVT3; got '4.0'"):
        open_recording(path)
    path.write_bytes(b"% evt 3.0\n% geometry 12")
    with pytest.raises(ValueError, match="the file ends inside its header, in '% geometry 12'"):
        open_recording(path)
    path.write_bytes(b"% evt 3.0\n% geometry 0x12\n")
    with pytest.raises(ValueError, match="must be two sizes in pixels, got '0x12'"):
        open_recording(path)
    path.write_bytes(evt_header("3.0") + b"\x01\x00\x02\x20")
    with pytest.warns(DamagedRecording, match="there is no TIME_HIGH"):
        assert open_recording(path).n_events == 0


def test_a_vector_beyond_the_format_is_damage(tmp_path):
    words = np.array([0x8001, 0x6005, 0x0009, 0x3000 | 2040, 0x4001, 0x4FFF], "<u2")
    (tmp_path / "a.raw").write_bytes(b"% evt 3.0\n" + words.tobytes())
    with pytest.warns(DamagedRecording, match="byte 20: a vector of events reaches beyond x = 2047"):
        assert open_recording(tmp_path / "a.raw").read().tolist() == [(4101, 2040, 9, 0)]
