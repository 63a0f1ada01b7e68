"""A recording of any known format, as packets of events.

The reader is found by the file's suffix, and by its first bytes where a suffix can mean several
formats. A new format is one more entry in `READERS`: its suffix, and a function of a path and
`ReadOptions` that returns a `Source`. If other formats have this suffix already, the first bytes of
the new format go into `BY_FIRST_BYTES`, and its name goes into the message of `_open_by_content`.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from async_tnt.base.checks import ParameterValueError, is_whole, positive_int
from async_tnt.base.files import refuse_git_lfs, user_path
from async_tnt.base.messages import short
from async_tnt.sources.files.aedat import Aedat2Source, Aedat3Source
from async_tnt.sources.files.nmnist import SENSOR as NMNIST_SENSOR
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.sources.files.numpy_files import NpySource, open_npz
from async_tnt.sources.files.off_sensor import EventsOffSensor, SensorCheck
from async_tnt.sources.files.prophesee import DatSource, EvtSource
from async_tnt.sources.files.ros_bags import open_ros_bag
from async_tnt.sources.files.source import (
    ArraySource,
    CorruptData,
    DamagedRecording,
    ReadOptions,
    Source,
    gathered,
)
from async_tnt.sources.files.source_error import SourceError
from async_tnt.sources.files.text_files import open_csv, open_txt
from async_tnt.sources.files.worker_source import open_aedat4, open_es, open_hdf5
from async_tnt.volume.events import EVENT_DTYPE
from async_tnt.volume.sensor import Sensor

Reader = Callable[[Path, ReadOptions], Source]

OffSensor = Literal["warn", "raise", "count"]
OFF_SENSOR = get_args(OffSensor)
"""What `open_recording` can do with events off the sensor."""

MODEL_SUFFIXES = (".safetensors", ".onnx", ".nir")
"""Suffixes of models, which are no recordings."""

BY_FIRST_BYTES: dict[bytes, Reader] = {
    b"\x89HDF\r\n\x1a\n": open_hdf5,
    b"#!AER-DAT4": open_aedat4,
    b"#!AER-DAT2.": Aedat2Source,
    b"#!AER-DAT3.1": Aedat3Source,
    b"Event Stream": open_es,
}
"""First bytes of a file -> function of (path, options) that opens it."""


def _open_by_content(path: Path, options: ReadOptions) -> Source:
    """Open a file by its first bytes: many programs write `.raw`, `.dat`, `.h5` and `.aedat`."""
    with path.open("rb") as file:
        first_bytes = file.read(4096)
    for magic, open_file in BY_FIRST_BYTES.items():
        if first_bytes.startswith(magic):
            return open_file(path, options)
    if not first_bytes:
        raise ValueError(f"{path}: the file is empty")
    if first_bytes.startswith(b"%"):
        header = first_bytes.lower()
        if b"% evt " in header or b"% format evt" in header:
            return EvtSource(path, options)
        if path.suffix.lower() == ".dat":
            return DatSource(path, options)
    raise ValueError(
        f"{path}: its first bytes are not those of a known format: expected a header of EVT (with "
        "a line `% evt 3.0` or `% format EVT3`), of DAT (lines that begin with %), AEDAT 2.0, 3.1 "
        f"or 4, ES or HDF5; got {first_bytes[:16]!r}"
    )


def _open_nmnist(path: Path, options: ReadOptions) -> Source:
    """Open a file in N-MNIST's format, which does not state the sensor.

    The sensor is N-MNIST's, 34 x 34, unless the caller states another sensor.
    """
    events = read_nmnist(path)
    if options.sensor not in (None, NMNIST_SENSOR):
        return ArraySource(events, None, "N-MNIST")
    source = ArraySource(events, NMNIST_SENSOR, "N-MNIST")
    source.sensor_hint = "a .bin is of N-MNIST's sensor unless {sensor} says another"
    return source


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


@dataclass(frozen=True, slots=True)
class RecordingCounts:
    """What became of a recording's events: received = kept + off_sensor.

    If the recording is damaged, these are the events before the damage.
    """

    received: int = 0
    """Events in the file, or in the part of it that is read."""
    kept: int = 0
    """Events that are handed on."""
    off_sensor: int = 0
    """Events that are left out because they lie off the sensor."""


@dataclass(frozen=True)
class _Totals:
    """What a whole pass over a recording has found."""

    counts: RecordingCounts
    earliest_us: int
    """Time of the earliest event, in microseconds; 0 without events."""
    newest_us: int
    """Time of the latest event, in microseconds; 0 without events."""


@dataclass(eq=False, repr=False)
class Recording:
    """The events of one file, in packets. `open_recording` makes it.

    Each iteration reads the file again and yields packets that the caller may change. A `.bin` or
    `.npz` is read as a whole. All other formats are read block by block, so that memory does not
    grow with the file. `counts`, `n_events`, `earliest_us`, `duration_us` and `len` take a pass
    over the file, unless one was made before.

    Parameters
    ----------
    source : reads the file's events, block by block.
    path, sensor, packet_events, strict, between_us, off_sensor : see `open_recording`. They are
        attributes, too.

    Attributes
    ----------
    stated_sensor : (width, height) as the file or its format states it; `sensor` may come from the
        caller.
    format : the name of the file's format.
    """

    path: Path
    source: Source
    sensor: Sensor | None
    packet_events: int
    strict: bool = False
    between_us: tuple[int, int] | None = None
    off_sensor: OffSensor = "warn"

    def __post_init__(self) -> None:
        self.stated_sensor = self.source.sensor
        self.format = self.source.format
        self._totals: _Totals | None = None
        self._warned: set[type[UserWarning]] = set()

    @property
    def counts(self) -> RecordingCounts:
        """What became of the recording's events."""
        return self._totals_of_pass().counts

    @property
    def n_events(self) -> int:
        """Events that are handed on."""
        return self._totals_of_pass().counts.kept

    @property
    def earliest_us(self) -> int:
        """Time of the earliest event, in microseconds; 0 without events."""
        return self._totals_of_pass().earliest_us

    @property
    def duration_us(self) -> int:
        """Time from the earliest to the latest event, in microseconds.

        0 for fewer than two events.
        """
        totals = self._totals_of_pass()
        return totals.newest_us - totals.earliest_us

    def read(self) -> np.ndarray:
        """All events in one new structured array of `EVENT_DTYPE`."""
        return np.concatenate([np.empty(0, EVENT_DTYPE), *self._blocks()])

    def __iter__(self) -> Iterator[np.ndarray]:
        waiting: list[np.ndarray] = []
        n_waiting = 0
        for block in self._blocks():
            waiting.append(block)
            n_waiting += len(block)
            if n_waiting < self.packet_events:
                continue
            events = np.concatenate(waiting)  # a copy: the packets are parts of it
            stop = n_waiting - n_waiting % self.packet_events
            for start in range(0, stop, self.packet_events):
                yield events[start : start + self.packet_events]
            waiting = [events[stop:]]
            n_waiting -= stop
        if n_waiting:
            yield np.concatenate(waiting)

    def __len__(self) -> int:
        """The number of packets in the recording."""
        return -(-self.n_events // self.packet_events)  # rounded up

    def __repr__(self) -> str:
        # without counts, which may take a pass over gigabytes
        return (
            f"Recording({str(self.path)!r}, sensor {self.sensor}, packets of {self.packet_events})"
        )

    def _totals_of_pass(self) -> _Totals:
        """The totals of a whole pass over the file. If no pass was made yet, this makes one."""
        if self._totals is None:
            for _ in self._blocks():
                pass
        assert self._totals is not None  # for mypy: a whole pass sets it
        return self._totals

    def _blocks(self) -> Iterator[np.ndarray]:
        """The source's blocks without the events off the sensor. Counts the events of this pass."""
        check = SensorCheck(self.sensor)
        n_kept = 0
        earliest_us = 0
        newest_us = 0
        try:
            for events in self._events_on_sensor(check):
                if not len(events):
                    continue
                first_us = int(events["t"].min())
                earliest_us = min(earliest_us, first_us) if n_kept else first_us
                newest_us = max(newest_us, int(events["t"].max()))
                n_kept += len(events)
                yield events
        except CorruptData as error:
            self._report_damage(str(error), n_kept, newest_us)

        counts = RecordingCounts(n_kept + check.n_off, n_kept, check.n_off)
        self._totals = _Totals(counts, earliest_us, newest_us)
        if check.n_off and self.off_sensor == "warn":
            left_out = "it is left out" if check.n_off == 1 else "they are left out"
            self._warn(EventsOffSensor, f"{self.path}: {check}; {left_out}")

    def _events_on_sensor(self, check: SensorCheck) -> Iterator[np.ndarray]:
        """The events of the part that is read, without events off the sensor.

        Raises
        ------
        SourceError : too many events are off the sensor; or an event is, and `off_sensor` is
            "raise".
        CorruptData : see `Source`; also if the events off the sensor become too many only later in
            the file.
        """
        for k, events in enumerate(gathered(self._events_between())):
            is_off = check.find_off(events)
            if check.n_off and self.off_sensor == "raise":
                # This block has the first event off the sensor of this pass.
                yield events[: int(np.argmax(is_off))].astype(EVENT_DTYPE, copy=False)
                raise SourceError(str(self.path), f"{check}{self._sensor_hint()}")
            if check.is_another_sensor and k > 0:
                raise CorruptData(f"{check}, where before it there were few")
            if check.is_another_sensor:
                raise SourceError(
                    str(self.path),
                    f"{check}: the recording is of another sensor, or damaged{self._sensor_hint()}",
                )
            if is_off.any():
                events = events[~is_off].astype(EVENT_DTYPE)
            yield events

    def _events_between(self) -> Iterator[np.ndarray]:
        """The source's blocks, or only their events between the two times of `between_us`."""
        if self.between_us is None:
            yield from self.source.blocks()
            return
        start_us, end_us = self.between_us
        for events in self.source.blocks():
            t = events["t"]
            if len(t) and (t >= end_us).all():
                return
            yield events[(t >= start_us) & (t < end_us)]

    def _sensor_hint(self) -> str:
        """Why the sensor may be wrong, for the end of a `SourceError`."""
        if self.source.sensor_hint:
            return f"; {self.source.sensor_hint}"
        if self.stated_sensor is None and self.sensor is not None:
            return "; the file states none, {sensor}, the model or another recording does"
        return ""

    def _report_damage(self, problem: str, n_kept: int, newest_us: int) -> None:
        """Raise a ValueError with `strict`, else warn."""
        text = f"{self.path}: damaged recording: {problem}"
        if self.strict:
            raise ValueError(f"{text}. Fetch the file again.") from None
        until = f", up to {newest_us} us" if n_kept else ""
        self._warn(DamagedRecording, f"{text}. Keeping the {n_kept} events before{until}.")

    def _warn(self, category: type[UserWarning], text: str) -> None:
        """Warn once of each category, however many passes find a reason to."""
        if category not in self._warned:
            self._warned.add(category)
            warnings.warn(text, category, stacklevel=5)


def open_recording(
    path: str | os.PathLike[str],
    packet_events: int = 1000,
    *,
    strict: bool = False,
    sensor: Sensor | None = None,
    between_us: tuple[int, int] | None = None,
    columns: str | None = None,
    topic: str | None = None,
    off_sensor: OffSensor | None = None,
) -> Recording:
    """Open a recording.

    Its format is known by its suffix, or by its first bytes where the suffix may mean several
    (`READERS`).

    Parameters
    ----------
    path : file to read; `~` is the home folder.
    packet_events : events per packet when iterating; the last packet has what is left.
    strict : False reads a damaged file up to the damage and gives one `DamagedRecording` warning.
        True raises a ValueError when reading gets there. Either way, three kinds of files are
        refused here, with a ValueError: a file that cannot be understood at all, a damaged `.bin`
        or `.npz`, and a `.npy` of the wrong size.
    sensor : (width, height) of the camera, for files that do not state it. A file that states a
        sensor keeps its own. A `.bin` has this sensor instead of N-MNIST's 34 x 34.
    between_us : (start, end): only the events with start <= t < end are read. The file is read up
        to the first block of events that all come later.
    columns : order of the four columns, such as "xypt", in text and NumPy files that do not name
        them.
    topic : name of the topic to read, in a ROS bag with several topics of events.
    off_sensor : what to do with events off the sensor. "warn" leaves them out and, at the end of
        the first pass, gives one `EventsOffSensor` warning. "raise" raises a ValueError at the
        first one. "count" leaves them out without a word. The default is "raise" with `strict`,
        else "warn". `Recording.counts` has their number. Too many of them mean that the recording
        is of another sensor, which is a ValueError: more than 100 that are more than 1 % of the
        events so far, or more than half of the events so far. (This is judged with every 65,536
        events. After the first of these, too many count as damage.)

    An option that a format does not need changes nothing, because its files state the same, or have
    no such thing.

    Returns
    -------
    `Recording`: iterable of packets, with `sensor`, `duration_us`, `path`, `n_events` and `read()`.

    Raises
    ------
    ValueError : the suffix is unknown; the file is damaged, or not even its first event can be
        read; the path is a pointer of Git LFS, a pipe or a device; `packet_events` is below 1, or
        another option is invalid.
    OSError : the file is missing, is a folder, or is not readable.
    ImportError : the format needs an extra that is not installed; the message names the extra.

    Example
    -------
    >>> recording = open_recording(sample_recordings()[7], packet_events=500)
    >>> recording.sensor
    (34, 34)
    >>> sum(len(packet) for packet in recording) == recording.n_events
    True
    """
    path = user_path(path)
    packet_events = positive_int("packet_events", packet_events)
    options = ReadOptions(sensor, columns, topic)
    between_us = _checked_between(between_us)
    if off_sensor is None:
        off_sensor = "raise" if strict else "warn"
    if off_sensor not in OFF_SENSOR:
        rule = f"must be one of {', '.join(OFF_SENSOR)}"
        raise ParameterValueError("off_sensor", rule, short(off_sensor))

    _check_path(path)
    source = READERS.get(path.suffix.lower(), _open_by_content)(path, options)
    try:
        source.check_first()
    except CorruptData as error:
        raise ValueError(f"{path}: not one event can be read: {error}") from None
    known_sensor = source.sensor or options.sensor
    return Recording(path, source, known_sensor, packet_events, strict, between_us, off_sensor)


def _check_path(path: Path) -> None:
    """Refuse a path that exists, but cannot be a recording. A missing file passes."""
    if path.is_dir():
        raise IsADirectoryError(
            f"{path} is a folder, expected a recording; `async-tnt info` says what is in it"
        )
    refuse_git_lfs(path)
    if not path.exists():
        return
    if path.suffix.lower() not in READERS:
        if path.suffix.lower() in MODEL_SUFFIXES:
            raise ValueError(f"{path}: a model, which has an option of its own, and no recording")
        raise ValueError(
            f"{path}: unknown suffix {path.suffix!r}, expected one of {', '.join(sorted(READERS))}"
        )
    if not path.is_file():  # opening a pipe without a writer waits forever
        raise ValueError(
            f"{path}: a recording must be a file that can be read more than once, got a pipe or a "
            "device"
        )


def _checked_between(between_us: tuple[int, int] | None) -> tuple[int, int] | None:
    """The times start and end as Python integers; None stays None.

    Raises
    ------
    ParameterValueError : `between_us` is no range of times.
    """
    if between_us is None:
        return None
    is_pair = isinstance(between_us, (tuple, list, np.ndarray)) and len(between_us) == 2
    if not (is_pair and all(map(is_whole, between_us)) and between_us[0] < between_us[1]):
        rule = "must be (start, end), whole microseconds with start < end"
        raise ParameterValueError("between_us", rule, short(between_us))
    start_us, end_us = between_us
    return int(start_us), int(end_us)


def sample_recordings() -> dict[int, Path]:
    """The bundled recordings, digit -> path: one simulated N-MNIST-like recording of each digit.

    `python -m experiments.samples` made them, in a checkout.
    """
    folder = Path(str(files("async_tnt") / "assets" / "samples"))
    return {int(path.stem): path for path in sorted(folder.glob("[0-9].bin"))}
