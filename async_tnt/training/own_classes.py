"""A folder of one's own classes -> recordings in memory, of one sensor, split by recording."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from async_tnt.datasets.class_folders import find_recordings, name_of
from async_tnt.pixels.selection import PixelSelection
from async_tnt.pixels.selector import PixelSelector
from async_tnt.recordings import READERS

from .windows import Progress, Recordings, no_progress

LONGEST_US = 1 << 31  # what a column of int32 holds


@dataclass(frozen=True)
class OwnClasses:
    """Labelled recordings of one camera.

    Parameters
    ----------
    recordings : their times count from each recording's first event.
    classes : names, in order; `recordings.labels` are places in them.
    sensor : (width, height) of these events: the camera's, or the region's that was cut out of it.
    left_out : what was left out and why, one line each.
    camera : (width, height) of the camera.
    left_out_pixels : events that were left out by their pixels, in words; "" where none could be.
    """

    recordings: Recordings
    classes: tuple[str, ...]
    sensor: tuple[int, int]
    left_out: tuple[str, ...]
    camera: tuple[int, int]
    left_out_pixels: str = ""


def read_classes(
    folder: str | os.PathLike[str],
    *,
    part: str = "Train",
    pixels: PixelSelection | None = None,
    classes: tuple[str, ...] | None = None,
    skip_damaged: bool = False,
    progress: Progress = no_progress,
) -> OwnClasses:
    """Read `<folder>/<class>/<recording>`, or `<folder>/<part>/<class>/<recording>` where there is such a folder.

    Events older than their recording's first one are left out, as a stream leaves them out; the others are put in
    order of time. A recording without events is left out, and so is a second copy of one in the same class: on both
    sides of the split, it would be learned by heart and then asked for.

    Parameters
    ----------
    pixels : what of the recordings to learn from; by default all events. Its `sensor`, (width, height) of the camera,
        is needed where no recording says it, and for `.bin` of another than N-MNIST's 34 x 34. What it leaves out is
        as if it had never been recorded: times count from the first event that is left.
    classes : the classes there must be; by default the folders there are, at least two.
    skip_damaged : False refuses a recording that cannot be read, with an error that names it; True leaves it out.

    Raises
    ------
    ValueError : fewer than two classes, or others than `classes`; a class without recordings, or without events; the
        same recording in two classes; recordings of different sensors, or of another one than that of `pixels`; a
        region or a mask that does not suit the sensor; an event off the sensor; a damaged recording.
    OSError : no such folder.
    """
    pixels = PixelSelection() if pixels is None else pixels
    selector = PixelSelector(pixels, None)
    found = find_recordings(folder, part)
    names = tuple(found) if classes is None else classes
    _check_classes(folder, found, classes)
    paths = [(label, path) for label, name in enumerate(names) for path in found.get(name, [])]
    events, labels, kept, left_out = [], [], [], []
    sensors: dict[tuple[int, int], str] = {}
    seen: dict[bytes, tuple[int, str]] = {}
    for label, path in progress(paths, "reading", len(paths)):
        try:
            recording, sensor = selector.open_to_learn(path, strict=True)
            read = recording.read()
        except (ValueError, OSError) as error:
            if not skip_damaged:
                raise ValueError(_told(error, path)) from None
            left_out.append(_told(error, path).replace(str(path), name_of(path)))
            continue
        if len(read) == 0:
            left_out.append(f"{name_of(path)}: no events")
            continue
        read = _from_first_event(_seen(read, selector, sensor, path))
        if len(read) == 0:
            left_out.append(f"{name_of(path)}: no events at the pixels that are not left out")
            continue
        if read["t"][-1] >= LONGEST_US:
            raise ValueError(
                f"{path}: lasts {read['t'][-1] / 60e6:.0f} minutes, more than the 35 that training takes; "
                "cut it into shorter recordings"
            )
        twin_label, twin = seen.setdefault(_fingerprint(read), (label, name_of(path)))
        if twin_label != label:
            raise ValueError(f"{twin} and {name_of(path)} hold the same events, but are of two classes; remove one")
        if twin != name_of(path):
            left_out.append(f"{name_of(path)}: the same events as {twin}")
            continue
        if recording.sensor is not None:
            sensors.setdefault((int(recording.sensor[0]), int(recording.sensor[1])), name_of(path))
        events.append(read)
        labels.append(label)
        kept.append(name_of(path))
    empty = [name for label, name in enumerate(names) if label not in labels]
    if empty and (classes is None or not labels):  # of a given list of classes, one recording is enough
        more = f"{'' if left_out[0].endswith('.') else '.'} And {len(left_out) - 1} more" if len(left_out) > 1 else ""
        why = f" (left out: {left_out[0]}{more})" if left_out else ""
        if left_out and pixels.camera is None and any(path.suffix.lower() == ".bin" for _, path in paths):
            why += "; a .bin of another camera than N-MNIST's 34x34 needs --sensor WxH"
        raise ValueError(
            f"{folder}: no event in any recording of class {', '.join(empty)}; record some, or remove the folder{why}"
        )
    camera = _one_sensor(folder, sensors, pixels, events)
    size = pixels.region or camera
    recordings = Recordings.from_events(events, labels, kept)
    _check_on_sensor(recordings, size)
    return OwnClasses(recordings, names, size, tuple(left_out), camera, selector.summary())


def _seen(events: np.ndarray, selector: PixelSelector, sensor: tuple[int, int] | None, path: Path) -> np.ndarray:
    """The events that are not left out by their pixels."""
    name = name_of(path)
    select = selector.filter_of(name, sensor)
    try:
        seen: np.ndarray = select(events)
    except ValueError as error:  # of a format that does not state its sensor
        said = "" if sensor is None else f", as --sensor, --mask or --start-from says {sensor[0]}x{sensor[1]}"
        raise ValueError(f"{name}: {error}{said}") from None
    return seen


def _check_classes(
    folder: str | os.PathLike[str], found: dict[str, list[Path]], classes: tuple[str, ...] | None
) -> None:
    if classes is not None:
        unknown = [name for name in found if name not in classes]
        if unknown:
            raise ValueError(f"{folder}: class {', '.join(unknown)} is unknown here; known are {', '.join(classes)}")
        if not any(found.values()):
            raise ValueError(f"{folder}: no recordings in any class folder")
        return
    if len(found) < 2:
        raise ValueError(f"{folder}: there must be at least two class folders to tell apart, got {', '.join(found)}")
    bare = [name for name, paths in found.items() if not paths]
    if bare:
        raise ValueError(
            f"{folder}: no recordings in the class folder {', '.join(bare)}; expected files in "
            f"{', '.join(sorted(READERS))} there, or remove the folder"
        )


def _from_first_event(events: np.ndarray) -> np.ndarray:
    """Times from the first event on, in order."""
    if len(events) == 0:
        return events
    events["t"] -= events["t"][0]
    if (np.diff(events["t"]) < 0).any():
        events = events[events["t"] >= 0]
        events = events[np.argsort(events["t"], kind="stable")]
    return events


def _fingerprint(events: np.ndarray) -> bytes:
    """Equal for equal events, whatever file they come from."""
    hashed = hashlib.blake2b(digest_size=16)
    for name, dtype in (("t", np.int64), ("x", np.uint16), ("y", np.uint16), ("p", np.uint8)):
        hashed.update(np.ascontiguousarray(events[name], dtype).tobytes())
    return hashed.digest()


def _one_sensor(
    folder: str | os.PathLike[str],
    sensors: dict[tuple[int, int], str],
    pixels: PixelSelection,
    events: list[np.ndarray],
) -> tuple[int, int]:
    """The sensor of all recordings."""
    given = pixels.camera
    if given is not None:
        who = "--sensor" if pixels.mask is None or pixels.sensor is not None else pixels.mask.name
        sensors = {given: who, **{size: name for size, name in sensors.items() if size != given}}
    if len(sensors) > 1:
        said = ", ".join(f"{width}x{height} ({name})" for (width, height), name in sensors.items())
        raise ValueError(f"{folder}: all recordings must be of one sensor, got {said}")
    if not sensors:
        x, y = (max(int(recording[name].max()) for recording in events) for name in "xy")
        raise ValueError(
            f"{folder}: no recording says how large its sensor is; give --sensor WxH "
            f"(the events need at least {x + 1}x{y + 1})"
        )
    return next(iter(sensors))


def _check_on_sensor(recordings: Recordings, sensor: tuple[int, int]) -> None:
    for name, side in zip("xy", sensor, strict=True):
        off = np.flatnonzero(getattr(recordings, name) >= side)
        if len(off):
            r = int(np.searchsorted(recordings.offsets, off[0], side="right")) - 1
            raise ValueError(
                f"{recordings.names[r]}: every event must lie on the {sensor[0]}x{sensor[1]} sensor, got {name} = "
                f"{getattr(recordings, name)[off[0]]} at event {off[0] - recordings.offsets[r]}"
            )


def _told(error: Exception, path: Path) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}."
    text = str(error)
    text = text if path.name in text else f"{name_of(path)}: {text}"
    return text if text.endswith(".") else f"{text}."
