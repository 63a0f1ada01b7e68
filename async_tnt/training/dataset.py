"""Labelled recordings of one sensor, from a folder with a folder of recordings for each class."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.sources.files.labelled_recordings import LabelledRecording, find_recordings
from async_tnt.sources.files.off_sensor import likely_side
from async_tnt.sources.files.recording import READERS, Recording, open_recording
from async_tnt.sources.files.source import ReadOptions
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training.recordings import Recordings, RecordingsWriter
from async_tnt.training.work import Work
from async_tnt.volume.sensor import Sensor, format_size

MAX_US = 1 << 31
"""The end of the times, in microseconds, that a column of int32 holds: 35 minutes."""
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
    left_out : the recordings that were left out and why, one line each.
    left_out_events : how many events of `recordings` were left out by their pixels:
        `left_out_outside` of the region, `left_out_masked`. Empty without a region and a mask.
    n_late : how many events were left out because they are older than their recording's first one,
        where windows begin.
    n_off_sensor : how many events were left out because they lie off the camera's sensor.
    known : what a second part of the data set must not hold, see `read_part`.
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


@dataclass(frozen=True)
class Reading:
    """How the recordings of a data set are read, the same for all its parts.

    Parameters
    ----------
    pixels : the events to learn from, by their pixels. The others are removed as if they had never
        been recorded: times count from the first event that is left.
    options : how files are read that do not say it themselves. The sensor is that of `pixels`.
    work : where the events are kept, and who is told.
    """

    pixels: Pixels
    options: ReadOptions
    work: Work


def read_dataset(
    folder: str | os.PathLike[str],
    *,
    part: str = "Train",
    pixels: Pixels | None = None,
    reading: ReadOptions | None = None,
    classes: tuple[str, ...] | None = None,
    work: Work = Work(),  # noqa: B008  (frozen)
) -> Dataset:
    """Read the recordings that `find_recordings` finds, see `read_part`.

    Parameters
    ----------
    folder : the data set.
    part : the folder in it that is read, where there is one.
    pixels : the events to keep, by their pixels; by default all.
    reading : how files are read that do not say it themselves.
    work : where the events are kept, and who is told.
    classes : the class names that may occur; by default the folders there are, at least two.

    Raises
    ------
    ValueError, OSError : as `read_part`.
    """
    how = Reading(pixels or Pixels(), reading or ReadOptions(), work)
    return read_part(folder, how, part=part, classes=classes)


def read_part(
    folder: str | os.PathLike[str],
    reading: Reading,
    *,
    part: str = "Train",
    classes: tuple[str, ...] | None = None,
    with_pictures: Collection[str] = (),
    first: Dataset | None = None,
) -> Dataset:
    """Read the recordings of one part of a data set.

    The recordings state their sensor and agree, or `reading.pixels` has the camera's for those that
    do not state one. Recordings that cannot be read, have no events, or have so many events off the
    sensor that they must be of another camera are left out. So are single events off the sensor,
    and events older than their recording's first one, as in a stream. The others are sorted by
    time.

    The same recording in two classes is an error: one of its labels is wrong. In one class, the
    second one is left out: it might be learned on one side of the split and asked about on the
    other. All events are compared, also those that are removed.

    Parameters
    ----------
    folder : the data set.
    reading : how its files are read.
    part : the folder in it that is read, where there is one.
    classes : the class names that may occur; by default the folders there are, at least two.
    with_pictures : classes that need no recordings, as they have pictures.
    first : the part that is trained on. This part has its camera and its classes. Its recordings
        are left out here, and refused in another class.

    Raises
    ------
    ValueError : fewer than two classes, or others than `classes`; a class without recordings, or
        with none left; the same recording in two classes; recordings of different sensors, or of an
        unknown one; a region or a mask that does not fit the sensor; a recording that is too long.
    OSError : the folder does not exist.
    """
    pixels = reading.pixels
    if first is not None:
        classes = first.classes
        pixels = replace(pixels, sensor=first.camera)
    options = replace(reading.options, sensor=pixels.camera)
    found = find_recordings(folder, part)
    _check_classes(folder, found, classes, with_pictures)
    names = tuple(found) if classes is None else classes
    labelled = [
        (label, recording) for label, name in enumerate(names) for recording in found.get(name, [])
    ]

    camera = _camera_of(pixels, first)
    if camera is None:
        camera = _stated_camera([file for _, file in labelled], options)
    known = {} if first is None else first.known
    reader = _Reader(str(folder), pixels, options, camera, known)
    recordings, left_out = _read_all(labelled, reader, reading)

    _check_left(folder, names, recordings, left_out, classes, with_pictures)
    if camera is None:
        raise ParameterValueError(
            "sensor", f"must be given, the camera's: {folder} has pictures, which have no sensor"
        )
    left_out_events = {}
    if pixels.roi is not None:
        left_out_events["left_out_outside"] = reader.n_outside
    if pixels.mask is not None:
        left_out_events["left_out_masked"] = reader.n_masked
    return Dataset(
        recordings,
        names,
        camera.size,
        pixels.region or camera.size,
        tuple(line for _, line in left_out),
        left_out_events,
        reader.n_late,
        reader.n_off_sensor,
        reader.known,
    )


@dataclass(frozen=True)
class _Camera:
    """The sensor of a data set, and what states it.

    Parameters
    ----------
    size : (width, height), in pixels.
    source : the name of what states it: of a recording, or of a parameter.
    is_parameter : whether `source` is a parameter.
    """

    size: Sensor
    source: str
    is_parameter: bool = False


def _camera_of(pixels: Pixels, first: Dataset | None) -> _Camera | None:
    """The camera that is known before a recording is read; None: the recordings must state it."""
    if first is not None:
        return _Camera(first.camera, "the recordings to train on")
    if pixels.camera is None:
        return None
    source = "mask" if pixels.sensor is None else "sensor"
    return _Camera(pixels.camera, source, is_parameter=True)


def _stated_camera(files: Sequence[LabelledRecording], options: ReadOptions) -> _Camera | None:
    """The sensor of the first recording that states one."""
    for file in files:
        # an error is told when the recording is read
        with contextlib.suppress(ValueError, OSError):
            stated = _opened(file, options).stated_sensor
            if stated is not None:
                return _Camera((int(stated[0]), int(stated[1])), file.name)
    return None


def _read_all(
    labelled: Sequence[tuple[int, LabelledRecording]], reader: _Reader, reading: Reading
) -> tuple[Recordings, list[tuple[int, str]]]:
    """All recordings that can be read; label and reason of each one that is left out."""
    left_out: list[tuple[int, str]] = []
    bar = reading.work.progress(len(labelled), "reading")
    with RecordingsWriter(reading.work.store) as writer, bar:
        for label, file in labelled:
            try:
                writer.add(reader.read(file, label), label, file.name)
            except _LeftOut as error:
                # The reason goes into the model's record, which may be published. So it has the
                # file's name, but not its path.
                left_out.append((label, str(error).replace(str(file.path), file.name)))
            bar.update()
        return writer.finish(), left_out


def _check_left(
    folder: str | os.PathLike[str],
    names: tuple[str, ...],
    recordings: Recordings,
    left_out: Sequence[tuple[int, str]],
    classes: tuple[str, ...] | None,
    with_pictures: Collection[str],
) -> None:
    """Refuse a class of which no recording is left. Of given `classes`, some may have none."""
    with_recordings = {names[label] for label in recordings.labels}
    empty = [name for name in names if name not in with_recordings and name not in with_pictures]
    some_left = len(recordings) > 0 or len(with_pictures) > 0
    if not empty or (classes is not None and some_left):
        return
    reasons = [line.removesuffix(".") for label, line in left_out if names[label] in empty]
    more = f"; and {len(reasons) - 1} more" if len(reasons) > 1 else ""
    raise ValueError(
        f"{folder}: no recording of class {', '.join(empty)} is left; record some, or remove the "
        f"folder (left out: {reasons[0]}{more})"
    )


def _opened(file: LabelledRecording, options: ReadOptions) -> Recording:
    """A recording, or the part that is labelled."""
    return open_recording(
        file.path, strict=True, between_us=file.between_us, off_sensor="count", **asdict(options)
    )


class _LeftOut(Exception):
    """Why a recording is left out."""


class _Reader:
    """Reads recordings of one camera as the network will see them.

    It counts the events that it removes.

    Parameters
    ----------
    folder : the data set, for messages.
    pixels : which events are kept.
    options : how files are read.
    camera : the sensor; None if nothing states it.
    known : recordings that have been read before; those that are read are added.
    """

    def __init__(
        self,
        folder: str,
        pixels: Pixels,
        options: ReadOptions,
        camera: _Camera | None,
        known: Known,
    ) -> None:
        self._folder = folder
        self._options = options
        self._camera = camera
        self.known = known
        self.n_outside = 0
        self.n_masked = 0
        self.n_late = 0
        self.n_off_sensor = 0
        self._filter = None if camera is None else pixels.filter_of(camera.size)

    def read(self, file: LabelledRecording, label: int) -> np.ndarray:
        """The selected events, in order, with times from the first of them on.

        Raises
        ------
        _LeftOut : the recording cannot be read, or is not for training.
        ValueError : another sensor, or none; the same recording is in another class; it is too
            long.
        """
        try:
            recording = _opened(file, self._options)
            if recording.sensor is None and self._camera is not None:
                recording.sensor = self._camera.size  # another recording states it
            events = recording.read()
        except (ValueError, OSError) as error:
            raise _LeftOut(_message(error, file)) from None
        if len(events) == 0:
            raise _LeftOut(f"{file.name}: no events{_times_of(file, self._options)}")
        self._check_sensor(file, recording.stated_sensor)
        self.n_off_sensor += recording.counts.off_sensor
        if self._camera is None:
            width = likely_side(np.bincount(events["x"]))
            height = likely_side(np.bincount(events["y"]))
            raise ParameterValueError(
                "sensor",
                f"must be given: no recording of {self._folder} states its sensor ({file.name} "
                f"needs at least {width}x{height})",
            )
        self._check_new(file, label, events)
        return self._selected(file, events)

    def _check_sensor(self, file: LabelledRecording, stated: Sensor | None) -> None:
        """Refuse a recording of another sensor."""
        camera = self._camera
        if stated is None or camera is None or tuple(stated) == camera.size:
            return
        found = f"{format_size(stated)} ({file.name})"
        if camera.is_parameter:
            raise ParameterValueError(
                camera.source,
                f"must be of the recordings' sensor, {found}",
                format_size(camera.size),
            )
        raise ValueError(
            f"{self._folder}: all recordings must be of one sensor, got "
            f"{format_size(camera.size)} ({camera.source}) and {found}"
        )

    def _check_new(self, file: LabelledRecording, label: int, events: np.ndarray) -> None:
        """Refuse a recording that is in another class, too; leave out one that was read before."""
        mine = label, file.name
        first = self.known.setdefault(fingerprint(events), mine)
        if first is mine:
            return
        first_label, first_name = first
        if first_label != label:
            raise ValueError(
                f"{first_name} and {file.name} hold the same events but are in two classes; remove "
                "the wrong one"
            )
        raise _LeftOut(f"{file.name}: the same events as {first_name}")

    def _selected(self, file: LabelledRecording, events: np.ndarray) -> np.ndarray:
        """The events at the selected pixels, in order, with times from the first of them on.

        Older ones than that are left out. The times of `events` may be changed.
        """
        keep = self._filter
        kept = events
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
            minutes = seen["t"][-1] / 60e6
            raise ValueError(
                f"{file.path}: lasts {minutes:.0f} minutes, more than the 35 that training "
                "supports; cut it into shorter recordings"
            )
        self.n_late += len(kept) - len(seen)
        if keep is not None:
            self.n_outside += keep.counts.dropped_outside
            self.n_masked += keep.counts.dropped_masked
        return seen


def _times_of(file: LabelledRecording, options: ReadOptions) -> str:
    """The times that the file of a part without events has, for a message.

    Often a label's times count from another origin, or in another unit.
    """
    if file.between_us is None:
        return ""
    whole = open_recording(file.path, off_sensor="count", **asdict(options))
    if not whole.n_events:
        return ""
    latest_us = whole.earliest_us + whole.duration_us
    return f"; the file has {whole.earliest_us} to {latest_us} us"


def fingerprint(events: np.ndarray) -> bytes:
    """A digest of events, at least one.

    The same events have the same digest, whatever their file and the time they begin at.
    """
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
    """Refuse folders that are no classes, and classes without files."""
    if classes is not None:
        unknown = [name for name in found if name not in classes]
        if unknown:
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
    empty = [name for name, paths in found.items() if not paths]
    without = [name for name in empty if name not in with_pictures]
    if without:
        raise ValueError(
            f"{folder}: no recordings in the class folder {', '.join(without)}; expected files in "
            f"{', '.join(sorted(READERS))} there, or pictures, or remove the folder"
        )


def _message(error: Exception, file: LabelledRecording) -> str:
    """A sentence, with the file's name in it, about an error of reading it."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}."
    text = str(error)
    text = text if file.path.name in text else f"{file.name}: {text}"
    return text if text.endswith(".") else f"{text}."
