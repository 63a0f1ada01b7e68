"""Files cut short at every byte and files with random damage: a prefix, a clear word, or a ValueError."""

import os
import warnings

import numpy as np
import pytest
from recordings.written import WRITERS, dat, es, evt2, evt3, evt_header, made_events, uzh_text

from async_tnt.recordings import DamagedRecording, open_recording

CASES = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", "300"))  # of each format

SLOW = ("dv.aedat4",)  # a process of its own for each pass
SLOWER = 30

# bytes an event has: a file cut between two events is a whole file, and nothing can tell
WHOLE_AGAIN = {"evt2.raw", "evt21.raw", "evt3.raw", "v2.dat", "dvs.es", "uzh.txt", "plain.csv"}


def read(path, **how):
    """(events, or None where the file is refused; the warnings)."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            recording = open_recording(path, packet_events=64, **how)
            packets = list(recording)
            assert recording.n_events == sum(map(len, packets))
            recording.read()
        except ValueError as error:
            assert str(path) in str(error)
            return None, told, None
    assert len(told) <= 1  # one, in three passes
    assert all(issubclass(warning.category, DamagedRecording) for warning in told)
    return np.concatenate(packets) if packets else made_events(0), told, recording


@pytest.mark.parametrize("name", sorted(WRITERS))
def test_a_file_cut_at_any_byte_gives_its_first_events(tmp_path, name):
    events = made_events(40 if "h5" not in name and "hdf5" not in name else 5, step_us=300)
    path = tmp_path / name
    WRITERS[name](path, events)
    data = path.read_bytes()
    step = max(1, len(data) // (15 if name in SLOW else 1500))  # HDF5 is long
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
        elif name not in WHOLE_AGAIN:
            pytest.fail(f"{name} cut to {size} of {len(data)} bytes: {len(got)} events, and nothing said")
    assert n_refused + n_warned > 0
    if name in ("v2.dat", "evt2.raw"):
        assert n_silent <= len(data) // 4 + 1


def damaged(data, rng):
    """Bytes changed, cut out, put in, or set to zero."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        place = int(rng.integers(0, len(data))) if data else 0
        length = int(rng.integers(1, 12))
        kind = rng.integers(0, 5)
        if kind == 0 and data:
            data[place] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            data[place : place + length] = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        elif kind == 2:
            del data[place : place + length]
        elif kind == 3:
            data[place:place] = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        else:
            data[place : place + length] = bytes(length)
    return bytes(data)


@pytest.mark.parametrize("name", sorted(WRITERS))
def test_random_damage_never_crashes(tmp_path, name):
    events = made_events(60, step_us=3000)
    path = tmp_path / name
    WRITERS[name](path, events)
    data = path.read_bytes()
    rng = np.random.default_rng(len(name))
    n_told = 0
    n_cases = CASES // SLOWER if name in SLOW else CASES
    for _ in range(n_cases):
        path.write_bytes(damaged(data, rng))
        got, told, recording = read(path)
        n_told += got is None or len(told) > 0
        if got is None or len(got) == 0:
            continue
        assert (got["t"] >= 0).all() and (got["p"] <= 1).all()
        if recording.sensor is not None:
            assert (got["x"] < recording.sensor[0]).all() and (got["y"] < recording.sensor[1]).all()
    assert n_told > n_cases // 100


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
