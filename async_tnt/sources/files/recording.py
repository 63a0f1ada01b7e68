"""A recording of any known format, as packets of events.

Its reader is found by its suffix, and by its first bytes where a suffix can mean several formats. A further format is
one more entry in `READERS`: its suffix, and a function of a path and `ReadOptions` that returns a `Source`.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from async_tnt.checks import is_whole, positive_int, short
from async_tnt.events import EVENT_DTYPE
from async_tnt.files import refuse_git_lfs, user_path
from async_tnt.sources.files.aedat import Aedat2Source, Aedat3Source
from async_tnt.sources.files.nmnist import SENSOR as NMNIST_SENSOR
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.sources.files.numpy_files import NpySource, open_npz
from async_tnt.sources.files.prophesee import DatSource, EvtSource
from async_tnt.sources.files.ros_bags import open_ros_bag
from async_tnt.sources.files.source import (
    ArraySource,
    CorruptData,
    DamagedRecording,
    ReadOptions,
    Source,
    events_on_sensor,
)
from async_tnt.sources.files.text_files import open_csv, open_txt
from async_tnt.sources.files.worker_source import open_aedat4, open_es, open_hdf5
from async_tnt.sources.sensor import Sensor

Reader = Callable[[Path, ReadOptions], Source]

NMNIST = "N-MNIST"
BY_FIRST_BYTES: dict[bytes, Reader] = {
    b"\x89HDF\r\n\x1a\n": open_hdf5,
    b"#!AER-DAT4": open_aedat4,
    b"#!AER-DAT2.": Aedat2Source,
    b"#!AER-DAT3.1": Aedat3Source,
    b"Event Stream": open_es,
}


def _open_by_content(path: Path, options: ReadOptions) -> Source:
    """Many programs write `.raw`, `.dat`, `.h5` and `.aedat`: the first bytes tell which format it is."""
    with path.open("rb") as file:
        start = file.read(4096)
    for magic, open_it in BY_FIRST_BYTES.items():
        if start.startswith(magic):
            return open_it(path, options)
    if not start:
        raise ValueError(f"{path}: the file is empty")
    header = start.lower()
    if header.startswith(b"%") and (b"% evt " in header or b"% format evt" in header):
        return EvtSource(path, options)
    if header.startswith(b"%") and path.suffix.lower() == ".dat":
        return DatSource(path, options)
    raise ValueError(
        f"{path}: its first bytes are not those of a known format: expected a header of EVT (with a line `% evt 3.0` "
        f"or `% format EVT3`), of DAT (lines that begin with %), AEDAT 2.0, 3.1 or 4, ES or HDF5; got {start[:16]!r}"
    )


def _open_nmnist(path: Path, options: ReadOptions) -> Source:
    """N-MNIST's format, of its 34 x 34 pixels or of the stated sensor, which the file does not state."""
    if options.sensor not in (None, NMNIST_SENSOR):
        return ArraySource(read_nmnist(path, sensor=None), None, NMNIST)
    return ArraySource(read_nmnist(path), NMNIST_SENSOR, NMNIST)


READERS: dict[str, Reader] = {
    ".bin": _open_nmnist,
    ".npy": NpySource,
    ".npz": open_npz,
    ".txt": open_txt,
    ".csv": open_csv,
    ".tsv": open_csv,
    **dict.fromkeys((".bag", ".db3", ".mcap"), open_ros_bag),
    **dict.fromkeys((".raw", ".dat", ".aedat", ".aedat4", ".es", ".h5", ".hdf5"), _open_by_content),
}
"""Suffix, in lower case -> function of (path, options) that opens such a file."""


@dataclass(eq=False, repr=False)
class Recording:
    """The events of one file, and the packets they come in. Made by `open_recording`.

    Each iteration reads the file again and yields packets that the caller may change. All formats but `.bin` and `.npz`
    are read block by block, so that memory does not grow with the file.
    `n_events`, `earliest_us`, `duration_us` and `len` take a pass over the file, unless one was made before.

    Parameters
    ----------
    source : reads the file's events, block by block.
    path, sensor, packet_events, strict, between_us : see `open_recording`; attributes, too.

    Attributes
    ----------
    stated_sensor : (width, height) as the file or its format states it; `sensor` may come from the caller.
    format : the name of the file's format.
    """

    path: Path
    source: Source
    sensor: Sensor | None
    packet_events: int
    strict: bool = False
    between_us: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        self.stated_sensor = self.source.sensor
        self.format = self.source.format
        self._totals: tuple[int, int, int] | None = None  # events, earliest and newest time, of a whole pass
        self._has_warned = False

    @property
    def n_events(self) -> int:
        """Events in the recording, up to the damage if there is any."""
        return self._counted()[0]

    @property
    def earliest_us(self) -> int:
        """Time of the earliest event, in microseconds; 0 without events."""
        return self._counted()[1]

    @property
    def duration_us(self) -> int:
        """Time from the earliest to the latest event, in microseconds; 0 for fewer than two events."""
        _, earliest_us, newest_us = self._counted()
        return newest_us - earliest_us

    def read(self) -> np.ndarray:
        """All events at once: a new structured array of `EVENT_DTYPE`."""
        return np.concatenate([np.empty(0, EVENT_DTYPE), *self._blocks()])

    def __iter__(self) -> Iterator[np.ndarray]:
        waiting: list[np.ndarray] = []
        n_waiting = 0
        for block in self._blocks():
            waiting.append(block)
            n_waiting += len(block)
            if n_waiting < self.packet_events:
                continue
            events = np.concatenate(waiting)  # a copy, which packets are parts of
            stop = n_waiting - n_waiting % self.packet_events
            for start in range(0, stop, self.packet_events):
                yield events[start : start + self.packet_events]
            waiting, n_waiting = [events[stop:]], n_waiting - stop
        if n_waiting:
            yield np.concatenate(waiting)

    def __len__(self) -> int:
        """Packets in the recording."""
        return -(-self.n_events // self.packet_events)

    def __repr__(self) -> str:
        # without counts, which may take a pass over gigabytes
        return f"Recording({str(self.path)!r}, sensor {self.sensor}, packets of {self.packet_events})"

    def _counted(self) -> tuple[int, int, int]:
        if self._totals is None:
            for _ in self._blocks():
                pass
        assert self._totals is not None  # for mypy: a whole pass sets it
        return self._totals

    def _blocks(self) -> Iterator[np.ndarray]:
        """One pass: the source's blocks, checked and counted."""
        n_read = n_events = earliest_us = newest_us = 0
        try:
            for block in self.source.blocks():
                events, problem = events_on_sensor(block, self.sensor, n_read)
                n_read += len(events)
                if self.between_us is not None:
                    if len(events) and (events["t"] >= self.between_us[1]).all():
                        break
                    events = events[(events["t"] >= self.between_us[0]) & (events["t"] < self.between_us[1])]
                if len(events):
                    first_us = int(events["t"].min())
                    earliest_us = min(earliest_us, first_us) if n_events else first_us
                    newest_us = max(newest_us, int(events["t"].max()))
                    n_events += len(events)
                    yield events
                if problem and self.stated_sensor is None:
                    raise ValueError(
                        f"{self.path}: {problem}; the file states none, `sensor`, the model or another recording does"
                    )
                if problem:
                    raise CorruptData(problem)
        except CorruptData as error:
            self._report(str(error), n_events, newest_us)
        self._totals = n_events, earliest_us, newest_us

    def _report(self, problem: str, n_read: int, newest_us: int) -> None:
        text = f"{self.path}: damaged recording: {problem}"
        if self.strict:
            raise ValueError(f"{text}. Fetch the file again.") from None
        if not self._has_warned:
            self._has_warned = True
            until = f", up to {newest_us} us" if n_read else ""
            warnings.warn(f"{text}. Keeping the {n_read} events before{until}.", DamagedRecording, stacklevel=4)


def open_recording(
    path: str | os.PathLike[str],
    packet_events: int = 1000,
    *,
    strict: bool = False,
    sensor: Sensor | None = None,
    between_us: tuple[int, int] | None = None,
    columns: str | None = None,
    topic: str | None = None,
) -> Recording:
    """Open a recording of the format that its suffix means (`READERS`), or its first bytes where it may mean several.

    Parameters
    ----------
    path : file to read; `~` is the home folder.
    packet_events : events per packet when iterating; the last packet has what is left.
    strict : False reads a damaged file up to the damage and gives one `DamagedRecording` warning; True raises a
        ValueError when reading gets there. Either way, a file that cannot be understood at all, a damaged `.bin` or
        `.npz`, and a `.npy` of the wrong size are refused here, with a ValueError.
    sensor : (width, height) of the camera, for files that do not state it; a file that does keeps its own. A `.bin` has
        this sensor instead of N-MNIST's 34 x 34. An event off it is a ValueError when reading gets there.
    between_us : (start, end): only the events with start <= t < end. The file is read up to the first block of events
        that all come later.
    columns : the order of four columns, such as "xypt", in text and NumPy files that do not name them.
    topic : the topic to read, of a ROS bag with several topics of events.

    Options that a format does not need, because its files state the same or have no such thing, change nothing.

    Returns
    -------
    `Recording`: iterable of packets, with `sensor`, `duration_us`, `path`, `n_events` and `read()`.

    Raises
    ------
    ValueError : unknown suffix, damaged file, one of which not even the first event can be read, a pointer of Git LFS,
        a pipe or device, `packet_events` below 1, or another invalid option.
    OSError : missing, a folder, or not readable.
    ImportError : the format needs an extra that is not installed; names it.

    Example
    -------
    >>> recording = open_recording(sample_recordings()[7], packet_events=500)
    >>> recording.sensor
    (34, 34)
    >>> sum(len(packet) for packet in recording) == recording.n_events
    True
    """
    path = user_path(path)
    suffix = path.suffix.lower()
    packet_events = positive_int("packet_events", packet_events)
    options = ReadOptions(sensor, columns, topic)
    between_us = _checked_between(between_us)
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder, expected a recording; `async-tnt info` says what is in it")
    refuse_git_lfs(path)
    if suffix not in READERS and path.exists():  # else it is missing, whatever its suffix
        raise ValueError(f"{path}: unknown suffix {path.suffix!r}, expected one of {', '.join(sorted(READERS))}")
    if path.exists() and not path.is_file():  # opening a pipe without a writer waits forever
        raise ValueError(f"{path}: a recording must be a file that can be read more than once, got a pipe or a device")
    source = READERS.get(suffix, _open_by_content)(path, options)
    try:
        source.check_first()
    except CorruptData as error:
        raise ValueError(f"{path}: not one event can be read: {error}") from None
    return Recording(path, source, source.sensor or options.sensor, packet_events, strict=strict, between_us=between_us)


def _checked_between(between_us: tuple[int, int] | None) -> tuple[int, int] | None:
    """(start, end) as Python integers; a ValueError if it is no range of times."""
    if between_us is None:
        return None
    is_pair = isinstance(between_us, (tuple, list, np.ndarray)) and len(between_us) == 2
    if not (is_pair and all(map(is_whole, between_us)) and between_us[0] < between_us[1]):
        raise ValueError(
            f"`between_us` must be (start, end), whole microseconds with start < end, got {short(between_us)}"
        )
    return int(between_us[0]), int(between_us[1])


def sample_recordings() -> dict[int, Path]:
    """The bundled recordings, digit -> path: one simulated N-MNIST-like recording of each digit.

    `python -m experiments.samples` made them, in a checkout.
    """
    folder = Path(str(files("async_tnt") / "assets" / "samples"))
    return {int(path.stem): path for path in sorted(folder.glob("[0-9].bin"))}
