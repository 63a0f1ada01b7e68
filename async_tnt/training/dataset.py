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
    sensor : (width, height) of the sensor that the events are on: the camera's, or the region's if
        the events were cropped to a region.
    left_out : the recordings that were left out and why, one line each.
    left_out_events : how many events of `recordings` were left out because of their pixels, under
        the names `left_out_outside` (outside of the region) and `left_out_masked`. Empty without a
        region and a mask.
    n_late : how many events were left out because they are older than their recording's first
        event, where the first window begins.
    n_off_sensor : how many events were left out because they lie off the camera's sensor.
    known : the recordings that have been read. Another part of the data set must not hold them, see
        `read_part`.
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
    pixels : selects the events to learn from by their pixels. The others are removed as if they had
        never been recorded: times count from the first event that is left.
    options : facts about files that do not state them. Its sensor is not used: `pixels` has it.
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
    part : the folder in it that is read, where there is one.
    pixels : selects the events to keep by their pixels; by default all.
    reading : facts about files that do not state them.
    classes : the class names that may occur; by default the names of the class folders, of which
        there must be two.
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
    first: Dataset | None = None,
) -> Dataset:
    """Read the recordings of one part of a data set.

    All recordings must be of one sensor. `reading.pixels` states it, or at least one of the
    recordings.

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
    reading : how its files are read.
    part : the folder in it that is read, where there is one.
    classes : the class names that may occur; by default the names of the class folders, of which
        there must be two.
    with_pictures : classes that need no recordings, because they have pictures.
    first : the part to train on, when another part is read. The other part must be of the same
        camera and classes. A recording that is in `first`, too, is left out. If its class differs,
        it is an error.

    Raises
    ------
    ValueError : there are fewer than two classes, or classes that are not in `classes`; a class has
        no recordings, or none is left; the same recording is in two classes; the recordings are of
        different sensors, or no sensor is stated; a region or a mask does not fit the sensor; a
        recording is too long.
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
    labelled = []
    for label, name in enumerate(names):
        labelled += [(label, recording) for recording in found.get(name, [])]

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
    source : what states it: the name of a recording, or of a parameter.
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
        # a recording that cannot be opened is reported later, when it is read
        with contextlib.suppress(ValueError, OSError):
            stated = _opened(file, options).stated_sensor
            if stated is not None:
                return _Camera((int(stated[0]), int(stated[1])), file.name)
    return None


def _read_all(
    labelled: Sequence[tuple[int, LabelledRecording]], reader: _Reader, reading: Reading
) -> tuple[Recordings, list[tuple[int, str]]]:
    """Read all recordings. Returns them, and the label and the reason of each that is left out."""
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
    """Refuse a class of which no recording is left.

    With given `classes`, single classes may have no recordings, but not all of them.
    """
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
    camera : the sensor; None if nothing states it.
    known : recordings that have been read before. Each recording that is read is added.
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
        _LeftOut : the recording cannot be read, or is not for training.
        ValueError : the recording is of another sensor, no sensor is stated, the same recording is
            in another class, or it is too long.
        """
        try:
            recording = _opened(file, self._options)
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
        """Refuse a recording that another class has, too. Leave out a copy in the same class."""
        mine = label, file.name
        first = self.known.setdefault(fingerprint(events), mine)
        if first is mine:  # these events have not been read before
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
    """A text about the times of a whole session, for a labelled part that has no events.

    Such a label often has times that count from another origin, or in another unit. The text is
    empty for a recording that is no part of a session.
    """
    if file.between_us is None:
        return ""
    whole = open_recording(file.path, off_sensor="count", **asdict(options))
    if not whole.n_events:
        return ""
    latest_us = whole.earliest_us + whole.duration_us
    return f"; the file has {whole.earliest_us} to {latest_us} us"


def fingerprint(events: np.ndarray) -> bytes:
    """A digest of a recording's events, of which there must be one.

    The same events have the same digest in any file and with any start time.
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
    """Refuse folders that are no known classes, and classes without files."""
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
    """A sentence about an error that occurred while a file was read. It names the file."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}."
    text = str(error)
    text = text if file.path.name in text else f"{file.name}: {text}"
    return text if text.endswith(".") else f"{text}."
