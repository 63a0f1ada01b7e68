"""N-MNIST recordings on disk: five bytes an event, no header.

    byte 0   x
    byte 1   y; 240 marks a timer overflow, not an event
    byte 2   bit 7: polarity (1 = ON); bits 6-0: bits 22-16 of the time
    byte 3   bits 15-8 of the time
    byte 4   bits 7-0 of the time, in microseconds

Events are in order of time. At each overflow row the camera's timer had lost 2^13 us: this row and every
later one is that much later than stored. N-Caltech101 uses the same layout on a larger sensor.

References
----------
Orchard, Jayawant, Cohen, Thakor 2015, Converting Static Image Datasets to Spiking Neuromorphic Datasets
Using Saccades, Frontiers in Neuroscience 9:437. The overflow rule is the one of the Python readers in use
for the data set: the timer in the camera's own event words has 13 bits, and the marking row carries on from
there. The authors' MATLAB reader, Read_Ndataset.m, has no such rule.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.checks import refuse_where
from async_tnt.events import as_events, structured
from async_tnt.files import replacing
from async_tnt.sources.sensor import checked_sensor

SENSOR = (34, 34)
"""Width and height of N-MNIST's sensor crop, in pixels."""

BYTES_PER_EVENT = 5
OVERFLOW_Y = 240
OVERFLOW_US = 1 << 13
TIME_LIMIT_US = 1 << 23


def read_nmnist(path: str | os.PathLike[str], *, sensor: tuple[int, int] | None = SENSOR) -> np.ndarray:
    """Read one recording in N-MNIST's format.

    The format has no checksum. Damage that can be recognised: a file that ends inside an event, an event off the
    sensor, and a time earlier than the one before it.

    Parameters
    ----------
    path : the `.bin` file.
    sensor : (width, height) that every event must lie on; None for any pixel up to 255.

    Returns
    -------
    Structured array of `EVENT_DTYPE`, in order of time. Overflow rows are already applied and removed.

    Raises
    ------
    ValueError : damage.
    OSError : missing, a folder, or not readable.
    """
    path = Path(path)
    raw = path.read_bytes()
    n_rows, n_left = divmod(len(raw), BYTES_PER_EVENT)
    rows = np.frombuffer(raw, np.uint8, n_rows * BYTES_PER_EVENT).reshape(n_rows, BYTES_PER_EVENT)

    t_us = rows[:, 2].astype(np.int64) & 0x7F
    t_us = t_us << 16 | rows[:, 3].astype(np.int64) << 8 | rows[:, 4]
    is_overflow = rows[:, 1] == OVERFLOW_Y
    t_us += OVERFLOW_US * np.cumsum(is_overflow)

    event_rows = np.flatnonzero(~is_overflow)
    columns = t_us, rows[:, 0], rows[:, 1], rows[:, 2] >> 7
    events = structured([column[event_rows] for column in columns], len(event_rows))
    problem = _first_problem(events, event_rows, sensor)
    if problem is None and n_left:
        problem = (
            f"the size must be a multiple of {BYTES_PER_EVENT} bytes (one event each), got {len(raw)}: "
            f"the file ends {n_left} bytes into row {n_rows}"
        )
    if problem is None:
        return events
    remedy = "Fetch the file again" + (", or say its sensor if it is of another camera" if "sensor" in problem else "")
    raise ValueError(f"{path}: damaged N-MNIST recording of {len(raw)} bytes: {problem}. {remedy}.")


def write_nmnist(path: str | os.PathLike[str], events: Any, *, sensor: tuple[int, int] | None = SENSOR) -> None:
    """Write events in N-MNIST's format; `read_nmnist` gives the same events back.

    Parameters
    ----------
    path : file to write, replaced if it exists.
    events : in any form that `Processor.push` accepts, in order of time.
    sensor : (width, height) that every event must lie on; None for any pixel the format can hold: up to 255, without
        row 240, which marks a timer overflow.

    Raises
    ------
    TypeError, ValueError : not events, or a value does not fit the format. Nothing is written then.
    OSError : the file cannot be written.
    """
    width, height = (256, 256) if sensor is None else checked_sensor(sensor)
    events = as_events(events, (min(width, 256), min(height, 256)))
    t_us = events["t"]
    refuse_where(t_us >= TIME_LIMIT_US, "t", t_us, f"must be in [0, {TIME_LIMIT_US})")
    refuse_where(events["y"] == OVERFLOW_Y, "y", events["y"], f"must not be {OVERFLOW_Y}, the mark of a timer overflow")
    refuse_where(np.diff(t_us, prepend=t_us[:1]) < 0, "t", t_us, "must never decrease")

    rows = np.empty((len(events), BYTES_PER_EVENT), np.uint8)
    rows[:, 0] = events["x"]
    rows[:, 1] = events["y"]
    rows[:, 2] = t_us >> 16 | events["p"].astype(np.int64) << 7
    rows[:, 3] = t_us >> 8 & 0xFF
    rows[:, 4] = t_us & 0xFF
    with replacing(Path(path)) as part:
        part.write_bytes(rows.tobytes())


def _first_problem(events: np.ndarray, rows: np.ndarray, sensor: tuple[int, int] | None) -> str | None:
    """What is wrong with the first bad event; None: all are good.

    rows : the row of the file that each event is from.
    """
    width, height = (256, 256) if sensor is None else checked_sensor(sensor)
    off_sensor = (events["x"] >= width) | (events["y"] >= height)
    backwards = np.diff(events["t"], prepend=events["t"][:1]) < 0
    bad = off_sensor | backwards
    if not bad.any():
        return None
    i = int(np.argmax(bad))
    t, x, y, _ = events[i].tolist()
    place = f"event {i} (byte {rows[i] * BYTES_PER_EVENT})"
    if off_sensor[i]:
        return f"every pixel must lie on the {width} x {height} sensor, got x = {x}, y = {y} at {place}"
    return f"`t` must never decrease, got {t} us after {events['t'][i - 1]} us at {place}"
