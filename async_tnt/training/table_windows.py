"""Windows of recordings whose tables say what stands where, to learn from.

The recordings are those that are scored, too, see `evaluation.object_tables`. A window ends at a
moment of a table; the boxes of that moment are its objects, see `table_scenes`. Only the events of
these windows are kept, so that a data set of hundreds of gigabytes can be learned from.

    moments   Those of a recording are half a window apart at least. All recordings together have at
              most `MOST_MOMENTS`. Each recording has at most its equal share of them, evenly
              spread. So no long recording, and nothing that stands still, fills the set.
    boxes     Boxes without area, off the sensor or with too few events are left out, see
              `more_than_noise`. A moment without any other box is left out, too.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.evaluation.object_tables import ObjectTable, class_names, find_tables, read_table
from async_tnt.sources.files.recording import Recording, open_recording
from async_tnt.sources.files.source import ReadOptions
from async_tnt.training.recordings import BOX_DTYPE, Recordings, RecordingsWriter
from async_tnt.training.table_scenes import fewest_events, more_than_noise
from async_tnt.training.work import Work
from async_tnt.volume.events import EVENT_DTYPE
from async_tnt.volume.sensor import Sensor, format_size

PART = "train"
"""The folder of a data set in which recordings to learn from are looked for, if there is one."""
MOST_MOMENTS = 20_000
"""Most moments of all recordings together, for a sensor of at most `FULL_PIXELS`. The windows of a
larger sensor have more events. So it has fewer moments, in inverse proportion to its number of
pixels."""
FULL_PIXELS = 304 * 240
"""Most pixels of a sensor that has all of `MOST_MOMENTS`: Gen1's."""
LEAST_SHARE = 0.2
"""Least share of `MOST_MOMENTS` that a sensor has, however large it is."""


@dataclass(frozen=True)
class Tables:
    """The recordings of a folder, and what they show.

    Parameters
    ----------
    folder : the folder.
    classes : the classes of all tables.
    paths, tables : the recordings, and the table of each.
    left_out : the recordings that are left out and why, one line each. `WindowReader` adds lines.
    """

    folder: Path
    classes: tuple[str, ...]
    paths: list[Path]
    tables: list[ObjectTable]
    left_out: list[str]

    def name_of(self, path: Path) -> str:
        """The name of a recording for messages and reports."""
        return path.relative_to(self.folder).as_posix()

    def leave_out(self, path: Path, error: Exception, more: str = "") -> None:
        """Note why a recording is left out. The note has names of files, but no path."""
        name = self.name_of(path)
        reason = str(error).replace(f"{self.folder}/", "")
        if not reason.startswith(name):
            reason = f"{name}: {reason}"
        self.left_out.append(f"{reason}{more}")

    def check_any_left(self, n_left: int) -> None:
        """Refuse a folder of which nothing is left to learn from."""
        if n_left:
            return
        raise ValueError(f"{self.folder}: no recording is left{self.why_left_out()}")

    def why_left_out(self) -> str:
        """The first recording that is left out, for the end of a message; empty if none is."""
        if not self.left_out:
            return ""
        further = len(self.left_out) - 1
        more = f"; and {further} more" if further else ""
        return f" (left out: {self.left_out[0]}{more})"


def read_tables(folder: Path) -> Tables:
    """Read the tables of a folder's recordings.

    A recording whose table has points alone, or nothing, is left out.

    Raises
    ------
    ValueError, OSError : as `find_tables` and `class_names`; no recording is left.
    """
    pairs = find_tables(folder, PART)
    classes = class_names([table for _, table in pairs])
    tables = Tables(folder, classes, [], [], [])
    for path, table_file in pairs:
        try:
            table = read_table(table_file, classes)
            if not (table.size > 0).all(axis=1).any():
                raise ValueError(f"{table_file}: no boxes to learn from: w and h are needed")
        except ValueError as error:
            tables.leave_out(path, error)
            continue
        tables.paths.append(path)
        tables.tables.append(table)
    tables.check_any_left(len(tables.paths))
    return tables


def stated_sensor(tables: Tables, options: ReadOptions) -> Sensor:
    """The sensor of the first recording that states one.

    Raises
    ------
    ParameterValueError : no recording does.
    """
    for path in tables.paths:
        # a recording that cannot be opened is reported later, when it is read
        with contextlib.suppress(ValueError, OSError):
            sensor = open_recording(path, strict=True, **asdict(options)).stated_sensor
            if sensor is not None:
                return int(sensor[0]), int(sensor[1])
    raise ParameterValueError(
        "sensor", f"must be given: no recording of {tables.folder} states its sensor"
    )


class _LeftOut(Exception):
    """Raised for a recording that is left out, or not read any further. The message says why."""


@contextlib.contextmanager
def _leaving_out() -> Iterator[None]:
    """A context in which the error of a recording that cannot be read is a `_LeftOut`.

    One recording must not end the reading of all. Events off the sensor are such an error, too.
    """
    try:
        yield
    except OSError as error:
        raise _LeftOut(error.strerror) from None
    except ValueError as error:
        raise _LeftOut(error) from None


@dataclass
class WindowReader:
    """Reads the windows of recordings that end at the moments of their tables.

    Parameters
    ----------
    tables : the recordings and their tables.
    camera : (width, height) of the sensor of all recordings.
    window_us : length of a window.
    options : how files are read.

    Attributes
    ----------
    boxes_left_out, moments_left_out : why boxes and moments are left out -> how many.
    n_off_sensor : how many events were left out because they lie off the sensor, of those from the
        first to the last window of each recording that is not damaged.
    n_late : how many events come more than a window's length after a newer one. They may be missing
        in their windows, see `windows_before`.
    """

    tables: Tables
    camera: Sensor
    window_us: int
    options: ReadOptions
    boxes_left_out: Counter[str] = field(default_factory=Counter)
    moments_left_out: Counter[str] = field(default_factory=Counter)
    n_off_sensor: int = 0
    n_late: int = 0
    _boxes: list[np.ndarray] = field(default_factory=list)

    def read(self, work: Work) -> tuple[Recordings, np.ndarray]:
        """The windows of all recordings, as recordings of their own with boxes.

        Returns them, and the file of each window, a number of `tables.paths`: int64, (R,).

        Raises
        ------
        ValueError : a recording is of another sensor, or no window is left.
        OSError : the disk is full.
        """
        n_files = len(self.tables.paths)
        n_most = most_moments(self.camera, n_files)
        files: list[int] = []
        bar = work.progress(n_files, "reading")
        with RecordingsWriter(work.store) as writer, bar:
            for k in range(n_files):
                n_read = self._read(k, n_most, writer)
                files += [k] * n_read
                bar.update()
            self.tables.check_any_left(len(files))
            recordings = replace(writer.finish(), boxes=np.concatenate(self._boxes))
        return recordings, np.array(files, np.int64)

    def _read(self, k: int, n_most: int, writer: RecordingsWriter) -> int:
        """Read the windows of recording `k`, at most `n_most`. Returns their number.

        A recording that cannot be read is noted. Its windows before the damage stay.
        """
        path = self.tables.paths[k]
        moments = list(self.tables.tables[k].moments())
        times_us = np.array([t for t, _ in moments])
        chosen = spread(times_us, self.window_us // 2, n_most)
        self.moments_left_out["near others, or too many"] += len(moments) - len(chosen)
        ends_us = times_us[chosen].tolist()
        name = self.tables.name_of(path)
        n_before = len(self._boxes)
        try:
            for i, events in self._windows(path, ends_us):
                boxes = self._boxes_of(k, moments[chosen[i]][1], events)
                if not len(boxes):
                    self.moments_left_out["without a box that is left"] += 1
                    continue
                writer.add(events, int(boxes["label"][0]), f"{name} at {ends_us[i]} us")
                self._boxes.append(boxes)
            if len(self._boxes) == n_before:
                raise _LeftOut(
                    f"{name}: no box has enough events in the {self.window_us} us before any time "
                    f"in its table, {ends_us[0]} to {ends_us[-1]}"
                )
        except _LeftOut as error:
            n_read = len(self._boxes) - n_before
            more = f"; its {n_read} windows before that are learned from" if n_read else ""
            self.tables.leave_out(path, error, more)
        return len(self._boxes) - n_before

    def _windows(self, path: Path, ends_us: Sequence[int]) -> Iterator[tuple[int, np.ndarray]]:
        """Yield the windows of a recording that end at these times, see `windows_before`.

        Raises
        ------
        _LeftOut : the recording cannot be read any further.
        ParameterValueError : it is of another sensor than the others.
        """
        with _leaving_out():
            recording = self._open(path, ends_us[0], ends_us[-1])
        self._check_sensor(path, recording.stated_sensor)
        with _leaving_out():
            yield from windows_before(self._counting_late(recording), ends_us, self.window_us)
            self.n_off_sensor += recording.counts.off_sensor

    def _counting_late(self, packets: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """Yield the packets of a recording, and count their events in `n_late`."""
        newest_us = 0
        for packet in packets:
            self.n_late += int((packet["t"] < newest_us - self.window_us).sum())
            newest_us = max(newest_us, int(packet["t"].max()))
            yield packet

    def _open(self, path: Path, first_us: int, last_us: int) -> Recording:
        """The part of a recording that its windows need.

        first_us, last_us : the end of the first and of the last window.
        """
        begin_us = max(0, first_us - self.window_us)
        return open_recording(
            path,
            strict=True,
            between_us=(begin_us, max(begin_us + 1, last_us)),
            off_sensor="count",
            **asdict(replace(self.options, sensor=self.camera)),
        )

    def _check_sensor(self, path: Path, stated: Sensor | None) -> None:
        """Refuse a recording that states another sensor than that of all recordings."""
        if stated is not None and tuple(stated) != self.camera:
            name = self.tables.name_of(path)
            rule = f"must be that of all recordings; {name} has {format_size(stated)}"
            raise ParameterValueError("sensor", rule, format_size(self.camera))

    def _boxes_of(self, k: int, rows: slice, events: np.ndarray) -> np.ndarray:
        """The boxes of a moment that count. They belong to the window that is added next.

        The other boxes are counted in `boxes_left_out`.

        Parameters
        ----------
        k, rows : number of the recording, and the rows of its table.
        events : the events of the window that ends at this moment.
        """
        table = self.tables.tables[k]
        size = table.size[rows]
        middle = table.middle[rows]
        has_area = (size > 0).all(axis=1)
        is_on = has_area & ((middle >= 0) & (middle < self.camera)).all(axis=1)
        width, height = self.camera
        places = events["y"].astype(np.int64) * width + events["x"]
        of_pixels = np.bincount(places, minlength=width * height).reshape(1, height, width)
        low = np.maximum(middle - size / 2, 0)
        high = np.minimum(middle + size / 2, self.camera)
        more = more_than_noise(of_pixels, np.zeros(len(size), np.int64), low, high)
        counts = is_on & (more >= fewest_events(high - low))
        self.boxes_left_out["without area"] += int((~has_area).sum())
        self.boxes_left_out["off the sensor"] += int((has_area & ~is_on).sum())
        self.boxes_left_out["with too few events"] += int((is_on & ~counts).sum())

        boxes = np.empty(int(counts.sum()), BOX_DTYPE)
        boxes["recording"] = len(self._boxes)
        boxes["label"] = table.label[rows][counts]
        boxes["middle"] = middle[counts]
        boxes["size"] = size[counts]
        return boxes


def most_moments(sensor: Sensor, n_recordings: int) -> int:
    """The most moments of each recording, see `MOST_MOMENTS`.

    Examples
    --------
    >>> most_moments((304, 240), 1000), most_moments((1280, 720), 1000), most_moments((34, 34), 1)
    (20, 4, 20000)
    """
    share = float(np.clip(FULL_PIXELS / (sensor[0] * sensor[1]), LEAST_SHARE, 1))
    return max(1, round(share * MOST_MOMENTS) // n_recordings)


def spread(times_us: np.ndarray, apart_us: int, n_most: int) -> list[int]:
    """Numbers of at most `n_most` times that are `apart_us` apart at least, evenly spread.

    times_us : int64, (N,), increasing.

    Examples
    --------
    >>> times_us = np.array([0, 10, 60, 100, 170, 300])
    >>> spread(times_us, 50, 9), spread(times_us, 50, 2)
    ([0, 2, 4, 5], [0, 5])
    """
    chosen = [0]
    for k in range(1, len(times_us)):
        if times_us[k] - times_us[chosen[-1]] >= apart_us:
            chosen.append(k)
    if len(chosen) > n_most:
        chosen = [chosen[k] for k in np.linspace(0, len(chosen) - 1, n_most).astype(int)]
    return chosen


def windows_before(
    packets: Iterable[np.ndarray], ends_us: Sequence[int], window_us: int
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the number of each window, and its events.

    Times count from the window's start, and never decrease. A window is complete when a packet
    comes that begins a window's length after its end. Later packets are not searched for its
    events. Memory holds only packets of windows that are not complete.

    Parameters
    ----------
    packets : a recording's events, structured arrays.
    ends_us : the end of each window, which the window does not include, increasing.
    window_us : length of a window.
    """
    # the packets of window k or later ones, each with the time of its latest event
    held: list[tuple[np.ndarray, int]] = []
    k = 0
    for packet in packets:
        first_us = packet["t"].min()
        n_before = k
        while k < len(ends_us) and first_us >= ends_us[k] + window_us:
            yield k, _events_before(held, ends_us[k], window_us)
            k += 1
        if k == len(ends_us):
            return
        begin_us = ends_us[k] - window_us
        # not at each packet, of which a window of a large sensor has thousands
        if k > n_before:
            held = [(one, last_us) for one, last_us in held if last_us >= begin_us]
        last_us = packet["t"].max()
        if last_us >= begin_us:
            held.append((packet, last_us))
    for last in range(k, len(ends_us)):
        yield last, _events_before(held, ends_us[last], window_us)


def _events_before(
    held: Sequence[tuple[np.ndarray, int]], end_us: int, window_us: int
) -> np.ndarray:
    """The events of a window, sorted by time. Times count from its start.

    held : packets, each with the time of its latest event.
    """
    packets = [packet for packet, last_us in held if last_us >= end_us - window_us]
    events = np.concatenate([np.empty(0, EVENT_DTYPE), *packets])
    events = events[(events["t"] >= end_us - window_us) & (events["t"] < end_us)]
    events["t"] -= end_us - window_us
    return events[np.argsort(events["t"], kind="stable")]
