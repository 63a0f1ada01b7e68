"""Files to damage, of every format, and a reader that holds each of them to what is promised."""

import time
import warnings

import numpy as np
from recordings.written import BYTES, WRITERS, evt21, made_events

from async_tnt.sources.files.damage import DamagedRecording
from async_tnt.sources.files.recording import open_recording

SLOWEST_S = 20.0  # a case takes milliseconds; on a busy machine, and with faery's process, more


def atis(events, sensor):
    """Event Stream with ATIS events: six bits of time, 63 n us in a byte of its own; every third an exposure."""
    out = [b"Event Stream\x02\x00\x00\x02", np.array(sensor, "<u2").tobytes()]
    before = 0
    for i, (t, x, y, p) in enumerate(events.tolist()):
        passed = t - before
        place = np.array([x, sensor[1] - 1 - y], "<u2").tobytes()
        out += [b"\xff" * (passed // 189), *([bytes([0xFC + passed % 189 // 63])] if passed % 189 >= 63 else [])]
        out.append(bytes([passed % 63 << 2 | 2 * p]) + place)
        if i % 3 == 0:
            out.append(bytes([1]) + place)
        before = t
    return b"".join(out)


def dat1(events, sensor):
    header = f"% Version 1\n% Width {sensor[0]}\n% Height {sensor[1]}\n".encode()
    words = np.empty((len(events), 2), "<u4")
    words[:, 0] = events["t"]
    words[:, 1] = events["x"] | events["y"].astype(np.uint32) << 9 | events["p"].astype(np.uint32) << 17
    return header + b"\x00\x08" + words.tobytes()


def nmnist(events, sensor):
    rows = np.empty((len(events), 5), np.uint8)
    rows[:, 0], rows[:, 1] = events["x"], events["y"]
    rows[:, 2] = events["t"] >> 16 | events["p"].astype(np.int64) << 7
    rows[:, 3], rows[:, 4] = events["t"] >> 8 & 255, events["t"] & 255
    return rows.tobytes()


def _from_bytes(make):
    return lambda path, events, sensor: path.write_bytes(make(events, sensor))


LINEAR = BYTES | {
    "atis.es": atis,
    "v1.dat": dat1,
    "legacy.raw": lambda events, sensor: evt21(events, sensor, "legacy"),
}
"""Formats whose first bytes alone decide the first events: file name -> function from events and sensor to bytes."""

EVERY_WRITER = (
    WRITERS
    | {name: _from_bytes(make) for name, make in (LINEAR | {"plain.bin": nmnist}).items()}
    | {
        "records.npy": lambda path, events, sensor: np.save(path, events),
        "columns.npy": lambda path, events, sensor: np.save(path, np.array(events.tolist())),
        "packed.npz": lambda path, events, sensor: np.savez_compressed(path, events=events, sensor=np.array(sensor)),
        "plain.npz": lambda path, events, sensor: np.savez(path, **{name: events[name] for name in "txyp"}),
    }
)
"""File name -> function that writes such a file: (path, events, sensor)."""


def read(path, **how):
    """(events, or None where the file is refused; the warnings; the recording), within the promises:

    nothing but a ValueError that names the file; at most one warning, DamagedRecording, in three passes; the same
    events in every pass; valid events, on the sensor; and an end.
    """
    started = time.monotonic()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            recording = open_recording(path, packet_events=64, **how)
            packets = list(recording)
            assert recording.n_events == sum(map(len, packets))
            again = recording.read()
        except ValueError as error:
            assert str(path) in str(error)
            assert "\n" not in str(error)
            assert time.monotonic() - started < SLOWEST_S
            return None, told, None
    assert time.monotonic() - started < SLOWEST_S
    assert len(told) <= 1
    assert all(issubclass(warning.category, DamagedRecording) for warning in told)
    got = np.concatenate(packets) if packets else made_events(0)
    np.testing.assert_array_equal(got, again)
    assert (got["t"] >= 0).all() and (got["t"] < 1 << 62).all() and (got["p"] <= 1).all()
    if recording.sensor is not None:
        assert (got["x"] < recording.sensor[0]).all() and (got["y"] < recording.sensor[1]).all()
    return got, told, recording
