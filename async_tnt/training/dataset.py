"""A folder with a folder of recordings for each class -> labelled recordings of one sensor."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from async_tnt.progress import Bar, no_progress
from async_tnt.sources.files.recording import READERS, open_recording
from async_tnt.sources.labelled_recordings import LabelledRecording, find_recordings
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.sources.sensor import Sensor, format_size
from async_tnt.training.recordings import Recordings, RecordingsWriter

MAX_US = 1 << 31  # what a column of int32 holds
MAX_WAITING = 1 << 24
"""Events that are kept until a recording states its sensor."""


@dataclass(frozen=True)
class Dataset:
    """Labelled recordings of one camera.

    Parameters
    ----------
    recordings : their times count from each recording's first event.
    classes : names; `recordings.labels` are indices into them.
    camera : (width, height) of the camera.
    sensor : (width, height) of these events: the camera's, or that of the region that was cropped.
    left_out : which recordings were left out and why, one line each.
    left_out_events : how many events of `recordings` were left out by their pixels: `left_out_outside` of the region,
        `left_out_masked`. Empty without a region and a mask.
    n_late : how many were left out because they are older than their recording's first one, where windows begin.
    known : what a second part of the data set must not hold, see `read_dataset`.
    """

    recordings: Recordings
    classes: tuple[str, ...]
    camera: Sensor
    sensor: Sensor
    left_out: tuple[str, ...]
    left_out_events: Mapping[str, int]
    n_late: int
    known: Known


@dataclass
class Known:
    """Recordings that have been read, so that the same one is noticed again.

    Parameters
    ----------
    recorded : fingerprint -> label and name.
    seen : label and fingerprint of the selected events -> fingerprint of all, and name.
    """

    recorded: dict[bytes, tuple[int, str]] = field(default_factory=dict)
    seen: dict[tuple[int, bytes], tuple[bytes, str]] = field(default_factory=dict)


def read_dataset(
    folder: str | os.PathLike[str],
    *,
    part: str = "Train",
    pixels: PixelSelection | None = None,
    sensor_source: str = "`sensor`",
    classes: tuple[str, ...] | None = None,
    known: Known | None = None,
    store: Path | None = None,
    progress: Callable[..., Bar] = no_progress,
) -> Dataset:
    """Read the recordings that `find_recordings` finds.

    The recordings state their sensor and agree, or `pixels.camera` gives it to those that do not state one. Recordings
    that cannot be read, have no events, or have an event off the sensor are left out. So are events older than their
    recording's first one, as in a stream; the others are sorted by time.

    The same recording in two classes is an error: one of its labels is wrong. All events are compared, so recordings
    that differ only outside of the region are not the same. A recording that the network could not tell from another
    one of its class is left out: it might be learned on one side of the split and asked about on the other.

    Parameters
    ----------
    folder : the data set.
    part : the folder in it that is read, where there is one.
    pixels : which events to learn from; by default all. The others are removed as if they had never been recorded:
        times count from the first event that is left.
    sensor_source : where `pixels.camera` comes from, for messages.
    classes : the class names that may occur; by default the folders there are, at least two.
    known : of the part to train on: its recordings are left out here, and refused in another class. With `classes`.
    store : a folder for the events, see `RecordingsWriter`; None: in memory.
    progress : makes the progress bar, which counts recordings.

    Raises
    ------
    ValueError : fewer than two classes, or others than `classes`; a class without recordings, or with none left; the
        same recording in two classes; recordings of different sensors, or of an unknown one; a region or a mask that
        does not fit the sensor; a recording that is too long.
    OSError : no such folder.
    """
    pixels = PixelSelection() if pixels is None else pixels
    found = find_recordings(folder, part)
    _check_classes(folder, found, classes)
    names = tuple(found) if classes is None else classes
    labelled = [(label, one) for label, name in enumerate(names) for one in found.get(name, [])]
    camera, source = pixels.camera, sensor_source
    waiting: list[_Recording] = []  # until the sensor is known
    n_waiting = 0  # their events
    with RecordingsWriter(store) as writer, progress(len(labelled), "reading") as bar:
        selection = _Selection(writer, Known() if known is None else known)
        for label, which in labelled:
            one = _Recording.read(which, label, pixels.camera)
            waiting.append(one)
            n_waiting += 0 if one.events is None else len(one.events)
            if camera is None:
                camera, source = one.sensor, one.name
            elif one.sensor not in (None, camera):
                raise ValueError(
                    f"{folder}: all recordings must be of one sensor, got {format_size(camera)} ({source}) and "
                    f"{format_size(one.sensor)} ({one.name})"
                )
            if camera is not None:
                keep = _filter(pixels, camera)
                for read in waiting:
                    read.select(keep, camera)
                    selection.add(read)
                waiting.clear()
                n_waiting = 0
            bar.update()
            if n_waiting > MAX_WAITING:
                break
        if camera is None and any(one.events is not None for one in waiting):
            x, y = (max(int(one.events[axis].max()) for one in waiting if one.events is not None) for axis in "xy")
            raise ValueError(
                f"{folder}: none of {len(waiting)} recordings states its sensor; give `sensor` (their events need "
                f"at least {x + 1}x{y + 1})"
            )
        for one in waiting:
            selection.add(one)
        recordings = writer.finish()
    empty = [name for label, name in enumerate(names) if label not in recordings.labels]
    if empty and (classes is None or not len(recordings)):  # of given classes, some may have no recordings
        out = [line.removesuffix(".") for label, line in selection.left_out if names[label] in empty]
        raise ValueError(
            f"{folder}: no recording of class {', '.join(empty)} is left; record some, or remove the folder "
            f"(left out: {out[0]}{f'; and {len(out) - 1} more' if len(out) > 1 else ''})"
        )
    assert camera is not None  # as there are recordings
    left_out_events = {}
    if pixels.roi is not None:
        left_out_events["left_out_outside"] = selection.n_outside
    if pixels.mask is not None:
        left_out_events["left_out_masked"] = selection.n_masked
    left_out = tuple(line for _, line in selection.left_out)
    region = pixels.region or camera
    return Dataset(recordings, names, camera, region, left_out, left_out_events, selection.n_late, selection.known)


def file_sizes(folder: Path, part: str = "Train") -> dict[str, int]:
    """Recording -> bytes, of all that `folder` or `folder/part` holds; -1 for a link to nothing."""
    recordings = [one for some in find_recordings(folder, part).values() for one in some]
    return {one.name: one.path.stat().st_size if one.path.exists() else -1 for one in recordings}


@dataclass
class _Recording:
    """A recording on its way from its file to the network.

    Parameters
    ----------
    label : index of its class.
    events : None if it is left out.
    sensor : (width, height) as the file states it, or None.
    fingerprint : of its events before any is removed.
    left_out : why it is left out, or "".
    n_outside, n_masked, n_late : events removed outside of the region, at masked pixels, and older than the first one.
    """

    file: LabelledRecording
    label: int
    events: np.ndarray | None = None
    sensor: Sensor | None = None
    fingerprint: bytes = b""
    left_out: str = ""
    n_outside: int = 0
    n_masked: int = 0
    n_late: int = 0

    @classmethod
    def read(cls, file: LabelledRecording, label: int, sensor: Sensor | None) -> _Recording:
        """All events of a recording; `sensor` is that of a file that does not state one."""
        one = cls(file, label)
        try:
            recording = open_recording(file.path, strict=True, sensor=sensor, between_us=file.between_us)
            events = recording.read()
        except (ValueError, OSError) as error:
            return one.leave_out(_message(error, file))
        if len(events) == 0:
            return one.leave_out(f"{one.name}: no events")
        if recording.stated_sensor is not None:
            one.sensor = int(recording.stated_sensor[0]), int(recording.stated_sensor[1])
        one.events, one.fingerprint = events, fingerprint(events)
        return one

    @property
    def name(self) -> str:
        return self.file.name

    def leave_out(self, why: str) -> _Recording:
        """Give the reason by name, not by path: it goes into the model's record, which may be published."""
        self.events, self.left_out = None, why.replace(str(self.file.path), self.name)
        return self

    def select(self, keep: PixelFilter | None, sensor: Sensor) -> None:
        """Reduce the events to those that the network will see, with times from the first of them on, in order.

        Raises
        ------
        ValueError : it is too long.
        """
        if self.events is None:
            return
        for axis, side in zip("xy", sensor, strict=True):
            off = np.flatnonzero(self.events[axis] >= side)
            if len(off):
                got = f"{axis} = {self.events[axis][off[0]]} at event {off[0]}"
                self.leave_out(f"{self.name}: every event must lie on the {format_size(sensor)} sensor, got {got}.")
                return
        seen = self.events if keep is None else keep(self.events)
        if keep is not None:
            self.n_outside, self.n_masked = keep.counts.dropped_outside, keep.counts.dropped_masked
            keep.reset()
        self.n_late = len(seen)
        seen = from_first_event(seen)
        self.n_late -= len(seen)
        if len(seen) == 0:
            self.leave_out(f"{self.name}: no events at the selected pixels")
            return
        if seen["t"][-1] >= MAX_US:
            raise ValueError(
                f"{self.file.path}: lasts {seen['t'][-1] / 60e6:.0f} minutes, more than the 35 that training supports; "
                "cut it into shorter recordings"
            )
        self.events = seen


class _Selection:
    """The recordings that are kept, and why others are not.

    Left out are those that look the same to the network as an earlier one of their class; the same recording in two
    classes is refused.
    """

    def __init__(self, writer: RecordingsWriter, known: Known) -> None:
        self._writer = writer
        self.known = known
        self.left_out: list[tuple[int, str]] = []
        """Label and reason."""
        self.n_outside = self.n_masked = self.n_late = 0

    def add(self, one: _Recording) -> None:
        """Keep a recording, or not.

        Raises
        ------
        ValueError : it is also in another class.
        """
        if one.events is not None:
            label, name = self.known.recorded.setdefault(one.fingerprint, (one.label, one.name))
            if label != one.label:
                raise ValueError(
                    f"{name} and {one.name} hold the same events but are in two classes; remove the wrong one"
                )
            mine = one.fingerprint, one.name
            twin = self.known.seen.setdefault((label, fingerprint(one.events)), mine)
            if twin is not mine:
                where = "" if twin[0] == one.fingerprint else " at the selected pixels"
                one.leave_out(f"{one.name}: the same events as {twin[1]}{where}")
        if one.events is None:
            self.left_out.append((one.label, one.left_out))
            return
        self._writer.add(one.events, one.label, one.name)
        self.n_outside += one.n_outside
        self.n_masked += one.n_masked
        self.n_late += one.n_late
        one.events = None  # they are in the writer


def from_first_event(events: np.ndarray) -> np.ndarray:
    """Times from the first event on, in order, without older events. The times of `events` are changed in place."""
    if len(events) == 0:
        return events
    events["t"] -= events["t"][0]
    if (np.diff(events["t"]) < 0).any():
        events = events[events["t"] >= 0]
        events = events[np.argsort(events["t"], kind="stable")]
    return events


def fingerprint(events: np.ndarray) -> bytes:
    """The same for the same events, whatever their file and the time they begin at. At least one event."""
    hashed = hashlib.blake2b(digest_size=16)
    hashed.update((events["t"].astype(np.int64) - np.int64(events["t"][0])).tobytes())
    for name, dtype in (("x", np.uint16), ("y", np.uint16), ("p", np.uint8)):
        hashed.update(np.ascontiguousarray(events[name], dtype).tobytes())
    return hashed.digest()


def _filter(pixels: PixelSelection, sensor: Sensor) -> PixelFilter | None:
    """The filter that keeps these pixels; None if it would keep all."""
    if not pixels.leaves_out:
        return None
    mask = None if pixels.mask is None else pixels.mask.pixels(sensor)
    return PixelFilter(sensor, pixels.roi, mask, crop=pixels.crop)


def _check_classes(
    folder: str | os.PathLike[str], found: dict[str, list[LabelledRecording]], classes: tuple[str, ...] | None
) -> None:
    if classes is not None:
        unknown = [name for name in found if name not in classes]
        if unknown:
            raise ValueError(f"{folder}: unknown class {', '.join(unknown)}; known are {', '.join(classes)}")
        if not any(found.values()):
            raise ValueError(f"{folder}: no recordings in any class folder")
        return
    if len(found) < 2:
        raise ValueError(f"{folder}: there must be at least two class folders, got {', '.join(found)}")
    without = [name for name, paths in found.items() if not paths]
    if without:
        raise ValueError(
            f"{folder}: no recordings in the class folder {', '.join(without)}; expected files in "
            f"{', '.join(sorted(READERS))} there, or remove the folder"
        )


def _message(error: Exception, file: LabelledRecording) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}."
    text = str(error)
    text = text if file.path.name in text else f"{file.name}: {text}"
    return text if text.endswith(".") else f"{text}."
