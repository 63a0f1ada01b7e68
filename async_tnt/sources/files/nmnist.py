"""N-MNIST recordings on disk: five bytes an event, no header.

    byte 0   x
    byte 1   y; 240 marks a timer overflow, not an event
    byte 2   bit 7: polarity (1 = ON); bits 6-0: bits 22-16 of the time
    byte 3   bits 15-8 of the time
    byte 4   bits 7-0 of the time, in microseconds

Events are in order of time. At each overflow row the camera's timer has lost 2^13 us, so the times
of this row and of every later one are that much later than stored. N-Caltech101 uses the same
layout on a larger sensor.

References
----------
Orchard, Jayawant, Cohen, Thakor 2015, Converting Static Image Datasets to Spiking Neuromorphic
Datasets Using Saccades, Frontiers in Neuroscience 9:437. The overflow rule is the one of the Python
readers in use for the data set: the timer in the camera's own event words has 13 bits, and the
marking row carries on from there. The authors' MATLAB reader, Read_Ndataset.m, has no such rule.
"""

from __future__ import annotations

import os

import numpy as np

from async_tnt.base.files import refuse_git_lfs, user_path
from async_tnt.volume.events import structured

SENSOR = (34, 34)
"""Width and height of N-MNIST's sensor crop, in pixels."""

BYTES_PER_EVENT = 5
"""Bytes of an event, or of a row that marks an overflow."""

OVERFLOW_Y = 240
"""The y of a row that marks an overflow of the camera's timer."""

OVERFLOW_US = 1 << 13
"""Microseconds that the timer has lost at each overflow."""


def read_nmnist(path: str | os.PathLike[str]) -> np.ndarray:
    """All events of one recording in N-MNIST's format.

    The format has no checksum. Two kinds of damage can be recognised: the file ends inside an
    event, or a time is earlier than the time before it.

    Parameters
    ----------
    path : the `.bin` file.

    Returns
    -------
    Structured array of `EVENT_DTYPE`, in order of time, with any pixel up to 255: `open_recording`
    leaves out events off the sensor. Overflow rows are already applied and removed.

    Raises
    ------
    ValueError : the file is damaged.
    OSError : the file is missing, is a folder, or is not readable.
    """
    path = user_path(path)
    refuse_git_lfs(path)
    raw = path.read_bytes()
    n_rows, n_left = divmod(len(raw), BYTES_PER_EVENT)
    rows = np.frombuffer(raw, np.uint8, n_rows * BYTES_PER_EVENT).reshape(n_rows, BYTES_PER_EVENT)

    t_us = rows[:, 2].astype(np.int64) & 0x7F
    t_us = t_us << 16 | rows[:, 3].astype(np.int64) << 8 | rows[:, 4]
    is_overflow = rows[:, 1] == OVERFLOW_Y
    t_us += OVERFLOW_US * np.cumsum(is_overflow)

    event_rows = np.flatnonzero(~is_overflow)
    columns = (t_us, rows[:, 0], rows[:, 1], rows[:, 2] >> 7)
    events = structured([column[event_rows] for column in columns], len(event_rows))

    problem = ""
    backwards = np.flatnonzero(np.diff(events["t"]) < 0)
    if len(backwards):
        i = int(backwards[0]) + 1
        problem = (
            f"event {i}: `t` must never decrease, got {events['t'][i]} us after "
            f"{events['t'][i - 1]} us (byte {event_rows[i] * BYTES_PER_EVENT})"
        )
    elif n_left:
        problem = (
            f"the size must be a multiple of {BYTES_PER_EVENT} bytes (one event each), got "
            f"{len(raw)}: the file ends {n_left} bytes into row {n_rows}"
        )
    if problem:
        raise ValueError(
            f"{path}: damaged N-MNIST recording of {len(raw)} bytes: {problem}. Fetch the file "
            "again."
        )
    return events
