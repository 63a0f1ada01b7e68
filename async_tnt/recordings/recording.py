"""A recording of any known format, as packets of events."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path

import numpy as np

from async_tnt.recordings.nmnist import SENSOR, read_nmnist
from async_tnt.recordings.numpy_files import read_npy, read_npz

Reader = Callable[[Path], tuple[np.ndarray, tuple[int, int] | None]]


class Recording:
    """The events of one file, and the packets they come in. Made by `open_recording`.

    Iterating yields packets lazily, and afresh each time: copies, so that what is done to a packet stays
    there.
    """

    def __init__(self, path: Path, events: np.ndarray, sensor: tuple[int, int] | None, packet_events: int) -> None:
        self.path = path
        self.sensor = sensor
        self.packet_events = packet_events
        self._events = events

    @property
    def n_events(self) -> int:
        """Events in the recording."""
        return len(self._events)

    @property
    def duration_us(self) -> int:
        """Time from the earliest to the latest event, in microseconds; 0 for fewer than two events."""
        if len(self._events) == 0:
            return 0
        return int(self._events["t"].max() - self._events["t"].min())

    def read(self) -> np.ndarray:
        """All events at once: a structured array of `EVENT_DTYPE`, the caller's to change."""
        return self._events.copy()

    def __iter__(self) -> Iterator[np.ndarray]:
        for start in range(0, len(self._events), self.packet_events):
            yield self._events[start : start + self.packet_events].copy()

    def __len__(self) -> int:
        """Packets in the recording."""
        return -(-len(self._events) // self.packet_events)

    def __repr__(self) -> str:
        return (
            f"Recording({str(self.path)!r}, {self.n_events} events, {self.duration_us} us, "
            f"sensor {self.sensor}, packets of {self.packet_events})"
        )


def _read_bin(path: Path) -> tuple[np.ndarray, tuple[int, int]]:
    return read_nmnist(path), SENSOR


READERS: dict[str, Reader] = {".bin": _read_bin, ".npy": read_npy, ".npz": read_npz}
"""Suffix, in lower case -> function that reads such a file: (events, sensor or None)."""


def open_recording(path: str | os.PathLike[str], packet_events: int = 1000) -> Recording:
    """Open a recording; its suffix says the format (`READERS`).

    Parameters
    ----------
    path : file to read: `.bin` (N-MNIST), `.npy` or `.npz`.
    packet_events : events per packet when iterating; the last packet has what is left.

    Returns
    -------
    `Recording`: iterable of packets, with `sensor`, `duration_us`, `path`, `n_events` and `read()`.

    Raises
    ------
    ValueError : unknown suffix, damaged file, or `packet_events` below 1.
    OSError : missing or not readable.

    Example
    -------
    >>> recording = open_recording(sample_recordings()[7], packet_events=500)
    >>> recording.sensor
    (34, 34)
    >>> sum(len(packet) for packet in recording) == recording.n_events
    True
    """
    path = Path(path)
    if packet_events < 1:
        raise ValueError(f"`packet_events` must be at least 1, got {packet_events}")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: unknown suffix {path.suffix!r}, expected one of {', '.join(sorted(READERS))}")
    events, sensor = reader(path)
    return Recording(path, events, sensor, int(packet_events))


def sample_recordings() -> dict[int, Path]:
    """The bundled recordings, digit -> path: one simulated N-MNIST-like recording of each digit.

    See `async_tnt.simulation.samples` for how they were made.
    """
    folder = Path(str(files("async_tnt") / "assets" / "samples"))
    return {int(path.stem): path for path in sorted(folder.glob("[0-9].bin"))}
