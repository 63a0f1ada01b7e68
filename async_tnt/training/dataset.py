"""A folder with a folder of recordings for each class -> labelled recordings of one sensor."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from async_tnt.base.progress import Bar
from async_tnt.sources.files.labelled_recordings import LabelledRecording, find_recordings
from async_tnt.sources.files.off_sensor import likely_side
from async_tnt.sources.files.recording import READERS, Recording, open_recording
from async_tnt.sources.files.source import ReadOptions
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training.recordings import Recordings, RecordingsWriter
from async_tnt.volume.sensor import Sensor, format_size

MAX_US = 1 << 31  # what a column of int32 holds
Known = dict[bytes, tuple[int, str]]
"""Fingerprint of a recording that has been read -> its label and name."""


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
    left_out_events : how many events of `recordings` were left out by their pixels:
        `left_out_outside` of the region, `left_out_masked`. Empty without a region and a mask.
    n_late : how many were left out because they are older than their recording's first one, where
        windows begin.
    n_off_sensor : how many were left out because they lie off the camera's sensor.
    known : what a second part of the data set must not hold, see `read_dataset`.
    """

    recordings: Recordings
    classes: tuple[str, ...]
    camera: Sensor
    sensor: Sensor
    left_out: tuple[str, ...]
    left_out_events: Mapping[str, int]
    n_late: int
    n_off_sensor: int
    known: Known


def read_dataset(
    folder: str | os.PathLike[str],
    *,
    part: str = "Train",
    pixels: Pixels | None = None,
    reading: ReadOptions | None = None,
    sensor_source: str = "`sensor`",
    classes: tuple[str, ...] | None = None,
    with_pictures: Collection[str] = (),
    known: Known | None = None,
    store: Path | None = None,
    progress: Callable[..., Bar] = Bar,
) -> Dataset:
    """Read the recordings that `find_recordings` finds.

    The recordings state their sensor and agree, or `pixels.camera` gives it to those that do not
    state one. Recordings that cannot be read, have no events, or have so many events off the sensor
    that they must be of another are left out. So are single events off the sensor, and those older
    than their recording's first one, as in a stream; the others are sorted by time.

    The same recording in two classes is an error: one of its labels is wrong. In one class, the
    second one is left out: it might be learned on one side of the split and asked about on the
    other. All events are compared, also those that are removed.

    Parameters
    ----------
    folder : the data set.
    part : the folder in it that is read, where there is one.
    pixels : which events to learn from; by default all. The others are removed as if they had never
        been recorded: times count from the first event that is left.
    reading : how files are read that do not say it themselves; its sensor is that of `pixels`.
    sensor_source : where `pixels.camera` comes from, for messages.
    classes : the class names that may occur; by default the folders there are, at least two.
    with_pictures : classes that need no recordings, as they have pictures.
    known : of the part to train on: its recordings are left out here, and refused in another class.
        With `classes`.
    store : a folder for the events, see `RecordingsWriter`; None: in memory.
    progress : makes the progress bar, which counts recordings.

    Raises
    ------
    ValueError : fewer than two classes, or others than `classes`; a class without recordings, or
        with none left; the same recording in two classes; recordings of different sensors, or of an
        unknown one; a region or a mask that does not fit the sensor; a recording that is too long.
    OSError : no such folder.
    """
    pixels = Pixels() if pixels is None else pixels
    reading = replace(reading or ReadOptions(), sensor=pixels.camera)
    found = find_recordings(folder, part)
    _check_classes(folder, found, classes, with_pictures)
    names = tuple(found) if classes is None else classes
    labelled = [(label, one) for label, name in enumerate(names) for one in found.get(name, [])]
    camera, source = pixels.camera, sensor_source
    if camera is None:
        camera, source = _stated_sensor([file for _, file in labelled], reading)
    reader = _Reader(str(folder), pixels, reading, camera, source, {} if known is None else known)
    left_out: list[tuple[int, str]] = []
    with RecordingsWriter(store) as writer, progress(len(labelled), "reading") as bar:
        for label, file in labelled:
            try:
                writer.add(reader.read(file, label), label, file.name)
            except _LeftOut as error:
                # by name, not by path: the reason goes into the model's record, which may be
                # published
                left_out.append((label, str(error).replace(str(file.path), file.name)))
            bar.update()
        recordings = writer.finish()
    empty = [
        name
        for k, name in enumerate(names)
        if k not in recordings.labels and name not in with_pictures
    ]
    # of given classes, some may have no recordings
    if empty and (classes is None or not (len(recordings) or with_pictures)):
        out = [line.removesuffix(".") for label, line in left_out if names[label] in empty]
        raise ValueError(
            f"{folder}: no recording of class {', '.join(empty)} is left; record some, or remove "
            "the folder "
            f"(left out: {out[0]}{f'; and {len(out) - 1} more' if len(out) > 1 else ''})"
        )
    if camera is None:  # without a recording
        raise ValueError(f"{folder}: pictures have no sensor; give `sensor`, the camera's")
    left_out_events = {}
    if pixels.roi is not None:
        left_out_events["left_out_outside"] = reader.n_outside
    if pixels.mask is not None:
        left_out_events["left_out_masked"] = reader.n_masked
    reasons = tuple(line for _, line in left_out)
    return Dataset(
        recordings,
        names,
        camera,
        pixels.region or camera,
        reasons,
        left_out_events,
        reader.n_late,
        reader.n_off_sensor,
        reader.known,
    )


def _stated_sensor(
    files: list[LabelledRecording], reading: ReadOptions
) -> tuple[Sensor | None, str]:
    """The sensor of the first recording that states one, and its name."""
    for file in files:
        with contextlib.suppress(ValueError, OSError):  # told when it is read
            if (stated := _opened(file, reading).stated_sensor) is not None:
                return (int(stated[0]), int(stated[1])), file.name
    return None, ""


def _opened(file: LabelledRecording, reading: ReadOptions) -> Recording:
    """A recording, or the part that is labelled."""
    return open_recording(
        file.path, strict=True, between_us=file.between_us, off_sensor="count", **asdict(reading)
    )


class _LeftOut(Exception):
    """Why a recording is left out."""


class _Reader:
    """Reads recordings of one camera, as the network will see them, and counts the events that it
    removes.

    Parameters
    ----------
    camera, source : (width, height), and what states it; None if nothing does.
    known : recordings that have been read before.
    """

    def __init__(
        self,
        folder: str,
        pixels: Pixels,
        reading: ReadOptions,
        camera: Sensor | None,
        source: str,
        known: Known,
    ) -> None:
        self._folder = folder
        self._reading = reading
        self._camera = camera
        self._source = source
        self.known = known
        self.n_outside = self.n_masked = self.n_late = self.n_off_sensor = 0
        self._filter = None if camera is None else pixels.filter_of(camera)

    def read(self, file: LabelledRecording, label: int) -> np.ndarray:
        """The selected events, in order, with times from the first of them on.

        Raises
        ------
        _LeftOut : it cannot be read, or is not for training.
        ValueError : another sensor, or none; the same recording is in another class; it is too
            long.
        """
        try:
            recording = _opened(file, self._reading)
            recording.sensor = recording.sensor or self._camera  # another recording's
            events = recording.read()
        except (ValueError, OSError) as error:
            raise _LeftOut(_message(error, file)) from None
        if len(events) == 0:
            raise _LeftOut(f"{file.name}: no events{_times_of(file, self._reading)}")
        self._check_sensor(file, recording.stated_sensor)
        self.n_off_sensor += recording.counts.off_sensor
        if self._camera is None:
            width, height = (likely_side(np.bincount(events[axis])) for axis in "xy")
            raise ValueError(
                f"{self._folder}: no recording states its sensor; give `sensor` ({file.name} needs "
                "at least "
                f"{width}x{height})"
            )
        mine = label, file.name
        first = self.known.setdefault(fingerprint(events), mine)
        if first[0] != label:
            raise ValueError(
                f"{first[1]} and {file.name} hold the same events but are in two classes; remove "
                "the wrong one"
            )
        if first is not mine:
            raise _LeftOut(f"{file.name}: the same events as {first[1]}")
        return self._selected(file, events)

    def _check_sensor(self, file: LabelledRecording, stated: Sensor | None) -> None:
        if stated is not None and self._camera is not None and tuple(stated) != self._camera:
            raise ValueError(
                f"{self._folder}: all recordings must be of one sensor, got "
                f"{format_size(self._camera)} "
                f"({self._source}) and {format_size(stated)} ({file.name})"
            )

    def _selected(self, file: LabelledRecording, events: np.ndarray) -> np.ndarray:
        """What is seen of `events`, whose times are changed: in order, from the first on, without
        older ones."""
        keep, kept = self._filter, events
        if keep is not None:
            keep.reset()
            kept = keep(events)
        if len(kept) == 0:
            raise _LeftOut(f"{file.name}: no events at the selected pixels")
        kept["t"] -= kept["t"][0]
        seen = kept
        if (np.diff(kept["t"]) < 0).any():
            seen = kept[kept["t"] >= 0]
            seen = seen[np.argsort(seen["t"], kind="stable")]
        if seen["t"][-1] >= MAX_US:
            raise ValueError(
                f"{file.path}: lasts {seen['t'][-1] / 60e6:.0f} minutes, more than the 35 that "
                "training supports; "
                "cut it into shorter recordings"
            )
        self.n_late += len(kept) - len(seen)
        if keep is not None:
            self.n_outside += keep.counts.dropped_outside
            self.n_masked += keep.counts.dropped_masked
        return seen


def _times_of(file: LabelledRecording, reading: ReadOptions) -> str:
    """For a part without events: which times the file has. Often they count from another origin, or
    in another unit."""
    if file.between_us is None:
        return ""
    whole = open_recording(file.path, off_sensor="count", **asdict(reading))
    if not whole.n_events:
        return ""
    return f"; the file has {whole.earliest_us} to {whole.earliest_us + whole.duration_us} us"


def fingerprint(events: np.ndarray) -> bytes:
    """The same for the same events, whatever their file and the time they begin at. At least one
    event."""
    hashed = hashlib.blake2b(digest_size=16)
    hashed.update((events["t"].astype(np.int64) - np.int64(events["t"][0])).tobytes())
    for name, dtype in (("x", np.uint16), ("y", np.uint16), ("p", np.uint8)):
        hashed.update(np.ascontiguousarray(events[name], dtype).tobytes())
    return hashed.digest()


def _check_classes(
    folder: str | os.PathLike[str],
    found: dict[str, list[LabelledRecording]],
    classes: tuple[str, ...] | None,
    with_pictures: Collection[str],
) -> None:
    if classes is not None:
        if unknown := [name for name in found if name not in classes]:
            raise ValueError(
                f"{folder}: unknown class {', '.join(unknown)}; known are {', '.join(classes)}"
            )
        if not any(found.values()) and not with_pictures:
            raise ValueError(f"{folder}: no recordings in any class folder")
        return
    if len(found) < 2:
        raise ValueError(
            f"{folder}: there must be at least two class folders, got {', '.join(found)}"
        )
    if without := [
        name for name, paths in found.items() if not paths and name not in with_pictures
    ]:
        raise ValueError(
            f"{folder}: no recordings in the class folder {', '.join(without)}; expected files in "
            f"{', '.join(sorted(READERS))} there, or pictures, or remove the folder"
        )


def _message(error: Exception, file: LabelledRecording) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}."
    text = str(error)
    text = text if file.path.name in text else f"{file.name}: {text}"
    return text if text.endswith(".") else f"{text}."
