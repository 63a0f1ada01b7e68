"""Files of events in each format, written from the formats' public descriptions, or by faery and h5py.

Nothing here is taken from the readers: what both sides get wrong alike, no test would see.
"""

import struct

import numpy as np
import pytest

from async_tnt.events import EVENT_DTYPE

SENSOR = (320, 240)


def made_events(n, seed=0, sensor=SENSOR, step_us=50, start_us=1_000):
    rng = np.random.default_rng(seed)
    events = np.empty(n, EVENT_DTYPE)
    events["t"] = start_us + np.cumsum(rng.integers(0, step_us, n))
    events["x"] = rng.integers(0, sensor[0], n)
    events["y"] = rng.integers(0, sensor[1], n)
    events["p"] = rng.integers(0, 2, n)
    return events


def uzh_text(events, sensor=SENSOR):
    rows = "".join(f"{t // 10**6}.{t % 10**6:06d}000 {x} {y} {p}\n" for t, x, y, p in events.tolist())
    return (f"{sensor[0]} {sensor[1]}\n" + rows).encode()


def csv(events, sensor=SENSOR):
    return b"timestamp,x,y,polarity\n" + "".join(f"{t},{x},{y},{p}\n" for t, x, y, p in events.tolist()).encode()


def evt_header(version, sensor=SENSOR, more=""):
    name = f"EVT{version.replace('.0', '').replace('.', '')}"
    return f"% evt {version}\n% format {name};height={sensor[1]};width={sensor[0]}{more}\n% end\n".encode()


def evt2(events, sensor=SENSOR):
    out, high = [], None
    for t, x, y, p in events.tolist():
        if t >> 6 != high:
            high = t >> 6
            out.append(0x8 << 28 | high & (1 << 28) - 1)
        out.append(p << 28 | (t & 63) << 22 | x << 11 | y)
    return evt_header("2.0", sensor) + struct.pack(f"<{len(out)}I", *out)


def evt21(events, sensor=SENSOR, endianness="little"):
    """An event a word, at the bit that x has in its group of 32."""
    out, high = [], None
    for t, x, y, p in events.tolist():
        if t >> 6 != high:
            high = t >> 6
            out.append((0x8 << 28 | high & (1 << 28) - 1) << 32)
        out.append((p << 28 | (t & 63) << 22 | (x & ~31) << 11 | y) << 32 | 1 << (x & 31))
    if endianness == "legacy":
        body = b"".join(struct.pack("<II", word >> 32, word & 0xFFFFFFFF) for word in out)
    else:
        body = struct.pack(f"<{len(out)}Q", *out)
    return evt_header("2.1", sensor, f";endianness={endianness}") + body


def evt3(events, sensor=SENSOR):
    """Every third event as a vector of one."""
    out, high, low, row = [], None, None, None
    for i, (t, x, y, p) in enumerate(events.tolist()):
        if t >> 12 != high:
            high, low = t >> 12, None
            out.append(0x8 << 12 | high & 4095)
        if t & 4095 != low:
            low = t & 4095
            out.append(0x6 << 12 | low)
        if y != row:
            row = y
            out.append(row)
        if i % 3 == 0:
            out += [0x3 << 12 | p << 11 | max(x - 11, 0), 0x4 << 12 | 1 << min(x, 11)]
        else:
            out.append(0x2 << 12 | p << 11 | x)
    return evt_header("3.0", sensor) + struct.pack(f"<{len(out)}H", *out)


def dat(events, sensor=SENSOR):
    header = f"% Data file containing CD events.\n% Version 2\n% Width {sensor[0]}\n% Height {sensor[1]}\n".encode()
    body = (struct.pack("<II", t & 0xFFFFFFFF, p << 28 | y << 14 | x) for t, x, y, p in events.tolist())
    return header + b"\x0c\x08" + b"".join(body)


def es(events, sensor=SENSOR):
    out = [b"Event Stream\x02\x00\x00\x01", struct.pack("<HH", *sensor)]
    before = 0
    for t, x, y, p in events.tolist():
        passed = t - before
        out.append(b"\xff" * (passed // 127))
        out.append(struct.pack("<BHH", passed % 127 << 1 | p, x, sensor[1] - 1 - y))
        before = t
    return b"".join(out)


def aedat4(path, events, sensor=SENSOR):
    faery = pytest.importorskip("faery", reason="AEDAT4 needs faery")
    theirs = np.empty(len(events), faery.EVENTS_DTYPE)
    for name, ours in (("t", "t"), ("x", "x"), ("y", "y"), ("on", "p")):
        theirs[name] = events[ours]
    faery.events_stream_from_array(theirs, sensor).to_file(path)


def dsec(path, events, sensor=SENSOR, **how):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    offset = int(events["t"][0]) if len(events) else 0
    with h5py.File(path, "w") as file:
        for name, dtype in (("t", "u4"), ("x", "u2"), ("y", "u2"), ("p", "u1")):
            values = events[name] - offset if name == "t" else events[name]
            file.create_dataset(f"events/{name}", data=values.astype(dtype), **how)
        file["t_offset"] = np.int64(offset)
        n_ms = int(events["t"].max() - offset) // 1000 + 1 if len(events) else 1
        file["ms_to_idx"] = np.searchsorted(events["t"] - offset, 1000 * np.arange(n_ms)).astype("u8")


def metavision(path, events, sensor=SENSOR, **how):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    records = np.empty(len(events), np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")]))
    for name in ("x", "y", "p", "t"):
        records[name] = events[name]
    with h5py.File(path, "w") as file:
        file.attrs["geometry"] = f"{sensor[0]}x{sensor[1]}"
        file.create_dataset("CD/events", data=records, **how)


def _from_bytes(make):
    return lambda path, events, sensor=SENSOR: path.write_bytes(make(events, sensor))


BYTES = {
    "uzh.txt": uzh_text,
    "plain.csv": csv,
    "evt2.raw": evt2,
    "evt21.raw": evt21,
    "evt3.raw": evt3,
    "v2.dat": dat,
    "dvs.es": es,
}
WRITERS = {name: _from_bytes(make) for name, make in BYTES.items()} | {
    "dv.aedat4": aedat4,
    "dsec.h5": dsec,
    "metavision.hdf5": metavision,
}
"""File name -> function that writes such a file: (path, events, sensor)."""

SAYS_SENSOR = {name: name not in ("plain.csv", "dsec.h5") for name in WRITERS}
