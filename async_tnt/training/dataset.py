"""Read labelled recordings of one camera, from a folder that has a folder for each class."""

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
"""The first time that does not fit a column of int32, in microseconds: 35 minutes."""
Known = dict[bytes, tuple[int, str]]
"""Fingerprint of a recording that has been read -> its label and name."""


@dataclass(frozen=True)
class Dataset:
    """Labelled recordings of one camera.

    Parameters
    ----------
    recordings : the recordings. Times count from each recording's first event.
    classes : names; `recordings.labels` are indices into them.
    camera : (width, height) of the camera.
    sensor : (width, height) of the sensor that the events are on. It is the camera's sensor, or a
        region of it if the events were cropped to a region.
    left_out : the recordings that were left out and why, one line each.
    left_out_events : how many events of `recordings` were left out because of their pixels, under
        the names `left_out_outside` (outside of the region) and `left_out_masked`. Empty without a
        region and a mask.
    n_late : how many events were left out because they are older than their recording's first
        event, where the first window begins.
    n_off_sensor : how many events were left out because they lie off the camera's sensor.
    known : the recordings that have been read. Another part of the data set must not have them,
        too, see `read_part`.
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
    """How the recordings of a data set are read. All parts of the data set are read the same way.

    Parameters
    ----------
    pixels : selects the events to learn from by their pixels. All other events are removed as if
        they had never been recorded: times count from the first event that is left.
    options : facts about files that do not state them. The sensor of `pixels` is used, not the one
        of `options`.
    work : where the events are kept, and which progress bar is shown.
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
    part : the folder in the data set that is read, if there is one of this name.
    pixels : selects the events to keep by their pixels; by default all.
    reading : facts about files that do not state them.
    classes : the class names that may occur; by default the names of the class folders, of which
        there must be at least two.
    work : where the events are kept, and which progress bar is shown.

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
    train_part: Dataset | None = None,
) -> Dataset:
    """Read the recordings of one part of a data set.

    All recordings must be of one sensor. `reading.pixels` or at least one of the recordings must
    state it.

    These recordings and events are left out:

    - a recording that cannot be read, that has no events, or that has so many events off the sensor
      that it must be of another camera
    - single events off the sensor
    - events that are older than the first event of their recording, as in a stream

    All other events are sorted by time.

    The same recording in two classes is an error, as one of its labels is wrong. Of two copies in
    one class, the second one is left out. Otherwise the model might learn from one copy and be
    validated on the other. The comparison covers all events, also those that `reading.pixels`
    removes.

    Parameters
    ----------
    folder : the data set.
    reading : how the files of the data set are read.
    part : the folder in the data set that is read, if there is one of this name.
    classes : the class names that may occur; by default the names of the class folders, of which
        there must be at least two.
    with_pictures : classes that need no recordings, because they have pictures.
    train_part : the part to train on, when another part is read. The other part must be of the same
        camera and classes. A recording that is in `train_part`, too, is left out. If its class
        differs there, it is an error.

    Raises
    ------
    ValueError : there are fewer than two classes, or classes that are not in `classes`; a class has
        no recordings, or all of them are left out; the same recording is in two classes; the
        recordings are of different sensors, or no sensor is stated; a region or a mask does not fit
        the sensor; a recording is too long.
    OSError : the folder does not exist.
    """
    pixels = reading.pixels
    if train_part is not None:
        classes = train_part.classes
        pixels = replace(pixels, sensor=train_part.camera)
    options = replace(reading.options, sensor=pixels.camera)
    files_of_class = find_recordings(folder, part)
    _check_classes(folder, files_of_class, classes, with_pictures)
    names = tuple(files_of_class) if classes is None else classes
    labelled = []
    for label, name in enumerate(names):
        labelled += [(label, file) for file in files_of_class.get(name, [])]

    camera = _camera_of(pixels, train_part)
    if camera is None:
        camera = _stated_camera([file for _, file in labelled], options)
    known = {} if train_part is None else train_part.known
    reader = _Reader(str(folder), pixels, options, camera, known)
    recordings, left_out = _read_all(labelled, reader, reading)

    _check_no_class_empty(folder, names, recordings, left_out, classes, with_pictures)
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
        camera=camera.size,
        sensor=pixels.region or camera.size,
        left_out=tuple(line for _, line in left_out),
        left_out_events=left_out_events,
        n_late=reader.n_late,
        n_off_sensor=reader.n_off_sensor,
        known=reader.known,
    )


@dataclass(frozen=True)
class _Camera:
    """The sensor of a data set, and what states it.

    Parameters
    ----------
    size : (width, height), in pixels.
    source : what states it: the name of a recording, or of a parameter.
    is_parameter : whether `source` is a parameter.
    """

    size: Sensor
    source: str
    is_parameter: bool = False


def _camera_of(pixels: Pixels, train_part: Dataset | None) -> _Camera | None:
    """The camera that is known before a recording is read; None: the recordings must state it."""
    if train_part is not None:
        return _Camera(train_part.camera, "the recordings to train on")
    if pixels.camera is None:
        return None
    source = "mask" if pixels.sensor is None else "sensor"
    return _Camera(pixels.camera, source, is_parameter=True)


def _stated_camera(files: Sequence[LabelledRecording], options: ReadOptions) -> _Camera | None:
    """The sensor of the first recording that states one."""
    for file in files:
        # a recording that cannot be opened is reported later, when it is read
        with contextlib.suppress(ValueError, OSError):
            sensor = _open(file, options).stated_sensor
            if sensor is not None:
                return _Camera((int(sensor[0]), int(sensor[1])), file.name)
    return None


def _read_all(
    labelled: Sequence[tuple[int, LabelledRecording]], reader: _Reader, reading: Reading
) -> tuple[Recordings, list[tuple[int, str]]]:
    """Read all recordings. Returns them, and label and reason of each recording that is left out.

    labelled : label and file of each recording.
    """
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


def _check_no_class_empty(
    folder: str | os.PathLike[str],
    names: tuple[str, ...],
    recordings: Recordings,
    left_out: Sequence[tuple[int, str]],
    classes: tuple[str, ...] | None,
    with_pictures: Collection[str],
) -> None:
    """Refuse a class of which all recordings are left out.

    If `classes` are given, some of them may have no recordings. But at least one must have some.
    """
    with_recordings = {names[label] for label in recordings.labels}
    empty = [name for name in names if name not in with_recordings and name not in with_pictures]
    has_examples = len(recordings) > 0 or len(with_pictures) > 0
    if not empty or (classes is not None and has_examples):
        return
    reasons = [line.removesuffix(".") for label, line in left_out if names[label] in empty]
    further = f"; and {len(reasons) - 1} more" if len(reasons) > 1 else ""
    raise ValueError(
        f"{folder}: no recording of class {', '.join(empty)} is left; record some, or remove the "
        f"folder (left out: {reasons[0]}{further})"
    )


def _open(file: LabelledRecording, options: ReadOptions) -> Recording:
    """Open a recording, or the labelled part of a session."""
    return open_recording(
        file.path, strict=True, between_us=file.between_us, off_sensor="count", **asdict(options)
    )


class _LeftOut(Exception):
    """Raised for a recording that is left out. The message says why."""


class _Reader:
    """Reads recordings of one camera as the network will see them.

    It counts the events that it removes.

    Parameters
    ----------
    folder : the data set, for messages.
    pixels : which events are kept.
    options : how files are read.
    camera : the camera's sensor; None if nothing states it.
    known : recordings that have been read before. Each recording that is read is added to them.
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
        """Read the selected events of a recording, sorted by time. Times count from the first one.

        Raises
        ------
        _LeftOut : the recording is left out, see `read_part`.
        ValueError : the recording is of another sensor, no sensor is stated, the same recording is
            in another class, or it is too long.
        """
        try:
            recording = _open(file, self._options)
            if recording.sensor is None and self._camera is not None:
                recording.sensor = self._camera.size  # another recording stated it
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
        other = f"{format_size(stated)} ({file.name})"
        if camera.is_parameter:
            raise ParameterValueError(
                camera.source,
                f"must be of the recordings' sensor, {other}",
                format_size(camera.size),
            )
        raise ValueError(
            f"{self._folder}: all recordings must be of one sensor, got "
            f"{format_size(camera.size)} ({camera.source}) and {other}"
        )

    def _check_new(self, file: LabelledRecording, label: int, events: np.ndarray) -> None:
        """Refuse a recording that another class has, too. Leave out a copy in the same class."""
        this = label, file.name
        first = self.known.setdefault(fingerprint(events), this)
        if first is this:  # these events have not been read before
            return
        first_label, first_name = first
        if first_label != label:
            raise ValueError(
                f"{first_name} and {file.name} hold the same events but are in two classes; remove "
                "the wrong one"
            )
        raise _LeftOut(f"{file.name}: the same events as {first_name}")

    def _selected(self, file: LabelledRecording, events: np.ndarray) -> np.ndarray:
        """The events at the selected pixels, sorted by time. Times count from the first one.

        Events that are older than the first one are left out. The times in `events` may be changed.
        """
        pixel_filter = self._filter
        selected = events
        if pixel_filter is not None:
            pixel_filter.reset()
            selected = pixel_filter(events)
        if len(selected) == 0:
            raise _LeftOut(f"{file.name}: no events at the selected pixels")

        selected["t"] -= selected["t"][0]
        in_order = selected
        if (np.diff(selected["t"]) < 0).any():
            in_order = selected[selected["t"] >= 0]
            in_order = in_order[np.argsort(in_order["t"], kind="stable")]
        if in_order["t"][-1] >= MAX_US:
            minutes = in_order["t"][-1] / 60e6
            raise ValueError(
                f"{file.path}: lasts {minutes:.0f} minutes, more than the 35 that training "
                "supports; cut it into shorter recordings"
            )
        self.n_late += len(selected) - len(in_order)
        if pixel_filter is not None:
            self.n_outside += pixel_filter.counts.dropped_outside
            self.n_masked += pixel_filter.counts.dropped_masked
        return in_order


def _times_of(file: LabelledRecording, options: ReadOptions) -> str:
    """A text about the times of a whole session, for a labelled part that has no events.

    Such a label often has times that count from another origin, or in another unit. The text is
    empty for a file that is no session.
    """
    if file.between_us is None:
        return ""
    session = open_recording(file.path, off_sensor="count", **asdict(options))
    if not session.n_events:
        return ""
    latest_us = session.earliest_us + session.duration_us
    return f"; the file has {session.earliest_us} to {latest_us} us"


def fingerprint(events: np.ndarray) -> bytes:
    """A digest of a recording's events. There must be at least one event.

    The same events have the same digest in any file and with any start time.
    """
    hashed = hashlib.blake2b(digest_size=16)
    hashed.update((events["t"].astype(np.int64) - np.int64(events["t"][0])).tobytes())
    for name, dtype in (("x", np.uint16), ("y", np.uint16), ("p", np.uint8)):
        hashed.update(np.ascontiguousarray(events[name], dtype).tobytes())
    return hashed.digest()


def _check_classes(
    folder: str | os.PathLike[str],
    files_of_class: dict[str, list[LabelledRecording]],
    classes: tuple[str, ...] | None,
    with_pictures: Collection[str],
) -> None:
    """Refuse folders that are no known classes, and classes without recordings and pictures."""
    if classes is not None:
        unknown = [name for name in files_of_class if name not in classes]
        if unknown:
            raise ValueError(
                f"{folder}: unknown class {', '.join(unknown)}; known are {', '.join(classes)}"
            )
        if not any(files_of_class.values()) and not with_pictures:
            raise ValueError(f"{folder}: no recordings in any class folder")
        return
    if len(files_of_class) < 2:
        raise ValueError(
            f"{folder}: there must be at least two class folders, got {', '.join(files_of_class)}"
        )
    without_recordings = [name for name, files in files_of_class.items() if not files]
    empty = [name for name in without_recordings if name not in with_pictures]
    if empty:
        raise ValueError(
            f"{folder}: no recordings in the class folder {', '.join(empty)}; expected files in "
            f"{', '.join(sorted(READERS))} there, or pictures, or remove the folder"
        )


def _message(error: Exception, file: LabelledRecording) -> str:
    """A sentence about an error that occurred while a file was read. It names the file."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}."
    text = str(error)
    text = text if file.path.name in text else f"{file.name}: {text}"
    return text if text.endswith(".") else f"{text}."
