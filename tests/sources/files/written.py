"""Files of events in each format.

They are written from the formats' public descriptions, or by NumPy, faery and h5py.

Nothing here is taken from the readers: no test would see a mistake that both sides share.
"""

import struct
from collections.abc import Callable
from itertools import groupby
from typing import NamedTuple

import numpy as np
import pytest
from made import events_of
from sources.files.ros_written import array_bag, evt3_bag, libcaer_bag, unpacked

SENSOR = (320, 240)
ANY_TEXT = "von José in Zürich\t1"  # headers may name people and places


def made_events(n, seed=0, sensor=SENSOR, step_us=50, start_us=1_000):
    rng = np.random.default_rng(seed)
    t = start_us + np.cumsum(rng.integers(0, step_us, n))
    return events_of(
        t, rng.integers(0, sensor[0], n), rng.integers(0, sensor[1], n), rng.integers(0, 2, n)
    )


def uzh_text(events, sensor=SENSOR):
    rows = "".join(
        f"{t // 10**6}.{t % 10**6:06d}000 {x} {y} {p}\n" for t, x, y, p in events.tolist()
    )
    return (f"{sensor[0]} {sensor[1]}\n" + rows).encode()


def csv(events, sensor=SENSOR):
    return (
        b"timestamp,x,y,polarity\n"
        + "".join(f"{t},{x},{y},{p}\n" for t, x, y, p in events.tolist()).encode()
    )


def evt_header(version, sensor=SENSOR, more=""):
    name = f"EVT{version.replace('.0', '').replace('.', '')}"
    lines = (
        f"evt {version}",
        ANY_TEXT,
        f"format {name};height={sensor[1]};width={sensor[0]}{more}",
        "end",
    )
    return "".join(f"% {line}\n" for line in lines).encode()


def evt2_words(events):
    high = None
    for t, x, y, p in events.tolist():
        if t >> 6 != high:
            high = t >> 6
            yield 0x8 << 28 | high & (1 << 28) - 1
        yield p << 28 | (t & 63) << 22 | x << 11 | y


def evt2(events, sensor=SENSOR):
    words = list(evt2_words(events))
    return evt_header("2.0", sensor) + struct.pack(f"<{len(words)}I", *words)


def evt21(events, sensor=SENSOR, endianness="little"):
    """An event a word, at the bit that x has in its group of 32."""
    halves = []
    for word in evt2_words(events):
        is_time = word >> 28 == 0x8
        upper, lower = (word, 0) if is_time else (word & ~(31 << 11), 1 << (word >> 11 & 31))
        halves += [upper, lower] if endianness == "legacy" else [lower, upper]
    return evt_header("2.1", sensor, f";endianness={endianness}") + struct.pack(
        f"<{len(halves)}I", *halves
    )


def evt3(events, sensor=SENSOR):
    """Every third event as a vector of one."""
    out = []
    high = None
    low = None
    row = None
    for i, (t, x, y, p) in enumerate(events.tolist()):
        if t >> 12 != high:
            high = t >> 12
            low = None
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
    header = f"% {ANY_TEXT}\n% Version 2\n% Width {sensor[0]}\n% Height {sensor[1]}\n".encode(
        "latin-1"
    )
    body = (
        struct.pack("<II", t & 0xFFFFFFFF, p << 28 | y << 14 | x) for t, x, y, p in events.tolist()
    )
    return header + b"\x0c\x08" + b"".join(body)


def es(events, sensor=SENSOR):
    out = [b"Event Stream\x02\x00\x00\x01", struct.pack("<HH", *sensor)]
    pytest.importorskip("faery", reason="ES needs faery")
    before = 0
    for t, x, y, p in events.tolist():
        passed = t - before
        out.append(b"\xff" * (passed // 127))
        out.append(struct.pack("<BHH", passed % 127 << 1 | p, x, sensor[1] - 1 - y))
        before = t
    return b"".join(out)


def aedat2(events, sensor, chip, davis=None):
    """Write a file of a DVS128 that states no camera, or of a DAVIS.

    Between every two events there is one that is not a pixel's.

    With `davis`, a size, the addresses are those of a DAVIS of these pixels, which the header need
    not name.
    """
    lines = ["#!AER-DAT2.0", f"# {ANY_TEXT}", *([f"# AEChip: eu.chips.{chip}"] if chip else [])]
    # jAER uses the encoding of its system
    out = ["".join(line + "\r\n" for line in lines).encode("latin-1")]
    for t, x, y, p in events.tolist():
        if chip or davis:
            size = davis or (240, 180)
            address = (size[1] - 1 - y) << 22 | (size[0] - 1 - x) << 12 | p << 11
            other = 1 << 31 | 7 << 22
        else:
            address = y << 8 | x << 1 | 1 - p
            other = 1 << 15
        out.append(struct.pack(">IIII", other, t & 0xFFFFFFFF, address, t & 0xFFFFFFFF))
    return b"".join(out)


def aedat3(events, sensor=(240, 180)):
    """Write packets of five polarity events (or a tenth of all) and one that is not valid.

    Between these packets there are special events.
    """
    out = [
        f"#!AER-DAT3.1\r\n#{ANY_TEXT}\r\n".encode() + b"#Source 1: DAVIS240C\r\n#!END-HEADER\r\n"
    ]
    n = max(5, len(events) // 10)
    for (_, overflows), rows in groupby(
        enumerate(events.tolist()), key=lambda row: (row[0] // n, row[1][0] >> 31)
    ):
        packet = [row for _, row in rows]
        out.append(
            struct.pack(
                "<hhiiiiii", 1, 1, 8, 4, overflows, len(packet) + 1, len(packet) + 1, len(packet)
            )
        )
        out += [
            struct.pack("<II", x << 17 | y << 2 | p << 1 | 1, t & 0x7FFFFFFF)
            for t, x, y, p in packet
        ]
        out += [
            struct.pack("<II", 5 << 17, 3),
            struct.pack("<hhiiiiiiII", 0, 1, 8, 4, overflows, 1, 1, 1, 3, 7),
        ]
    return b"".join(out)


def nmnist(events, sensor=(34, 34)):
    return b"".join(
        struct.pack(">BBBH", x, y, p << 7 | t >> 16, t & 0xFFFF) for t, x, y, p in events.tolist()
    )


def by_faery(path, events, sensor=SENSOR):
    """Write events by faery, in the format of the suffix."""
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


def metavision(path, events, sensor=SENSOR, **how):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    records = np.zeros(len(events), [("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
    records[["t", "x", "y", "p"]] = events
    with h5py.File(path, "w") as file:
        file.attrs["geometry"] = f"{sensor[0]}x{sensor[1]}"
        file.create_dataset("CD/events", data=records, **how)


def rvt(path, events, sensor=SENSOR, **how):
    """Write DSEC's layout without an offset, and with the sensor's sides beside the columns."""
    dsec(path, events, sensor, **how)
    import h5py

    with h5py.File(path, "a") as file:
        offset = file["t_offset"][()]
        del file["t_offset"]
        times = file["events/t"][()].astype("i8") + offset
        del file["events/t"]
        file.create_dataset("events/t", data=times, **how)
        file["events/width"], file["events/height"] = np.array(sensor, "u4")


def metavision_csv(events, sensor=SENSOR):
    rows = "".join(f"{x},{y},{p},{t}\n" for t, x, y, p in events.tolist())
    return f"%geometry:{sensor[0]},{sensor[1]}\n{rows}".encode()


def packets_bag(path, events, sensor=SENSOR):
    """Words of EVT3, cut into messages."""
    evt3_bag(path, unpacked(evt3(events, sensor)[len(evt_header("3.0", sensor)) :]), sensor)


def columns_of(events):
    return {name: events[name] for name in "txyp"}


def table_of(events):
    return np.array(events.tolist(), np.int64).reshape(-1, 4)


class Format(NamedTuple):
    """How to write one format, and what it can hold."""

    write: Callable
    """Function of (path, events, sensor) that writes a file."""
    largest: tuple[int, int] = (1 << 16, 1 << 16)
    """The largest sensor, (width, height)."""
    states_sensor: bool = True
    """Whether a file states its sensor."""
    whole_when_cut: bool = False
    """Whether a file that is cut between two events is a whole one, and nothing can tell."""
    in_worker: bool = False
    """Whether a file is read in a worker process, which takes a while."""


def _bytes(make, largest=(1 << 16, 1 << 16), states_sensor=True, in_worker=False):
    """A format whose events end where the file does, wherever that is."""

    def write(path, events, sensor=SENSOR):
        path.write_bytes(make(events, sensor))

    return Format(write, largest, states_sensor, whole_when_cut=True, in_worker=in_worker)


FORMATS = {
    "uzh.txt": _bytes(uzh_text),
    "plain.csv": _bytes(csv, states_sensor=False),
    "metavision.csv": _bytes(metavision_csv),
    "evt2.raw": _bytes(evt2, (2048, 2048)),
    "evt21.raw": _bytes(evt21, (2048, 2048)),
    "legacy.raw": _bytes(lambda events, sensor: evt21(events, sensor, "legacy"), (2048, 2048)),
    "evt3.raw": _bytes(evt3, (2048, 2048)),
    "v2.dat": _bytes(dat, (1 << 14, 1 << 14)),
    "dvs.es": _bytes(es, (65535, 65535), in_worker=True),
    "dvs128.aedat": _bytes(
        lambda events, sensor: aedat2(events, sensor, ""), (128, 128), states_sensor=False
    ),
    "davis.aedat": _bytes(lambda events, sensor: aedat2(events, sensor, "DAViS240C"), (240, 180)),
    "caer.aedat": _bytes(aedat3, (240, 180)),
    "plain.bin": _bytes(nmnist, (34, 34)),
    "records.npy": Format(lambda path, events, sensor: np.save(path, events), states_sensor=False),
    "packed.npz": Format(
        lambda path, events, sensor: np.savez_compressed(path, events=events, sensor=sensor)
    ),
    "table.npz": Format(
        lambda path, events, sensor: np.savez(path, events=table_of(events)), states_sensor=False
    ),
    "plain.npz": Format(
        lambda path, events, sensor: np.savez(path, **columns_of(events)), states_sensor=False
    ),
    # its pixels have 16 bits, signed
    "dv.aedat4": Format(by_faery, (32767, 32767), in_worker=True),
    "dsec.h5": Format(dsec, states_sensor=False, in_worker=True),
    "rvt.h5": Format(rvt, in_worker=True),
    "metavision.hdf5": Format(metavision, in_worker=True),
    "packets.bag": Format(packets_bag, (2048, 2048), in_worker=True),
    "packets.db3": Format(packets_bag, (2048, 2048), in_worker=True),
    "caer.mcap": Format(libcaer_bag, (2048, 2048), in_worker=True),
    "arrays.bag": Format(array_bag, in_worker=True),
    "arrays.mcap": Format(array_bag, in_worker=True),
}
"""File name -> `Format`. The tests of all formats take a new entry as it is, unless its sensor is
that of one camera: exceptions stand at the head of test_off_sensor.py and test_stated_sensor.py."""


def written(path, events, sensor=SENSOR):
    """Write events in the format of the path's name; returns the path."""
    FORMATS[path.name].write(path, events, sensor)
    return path
