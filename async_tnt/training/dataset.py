"""A folder of one's own classes -> recordings in memory, of one sensor, split by recording."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

from async_tnt.sources.class_folders import find_recordings
from async_tnt.sources.files.formats import READERS
from async_tnt.sources.files.source import Sensor
from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.sources.pixel_selector import PixelSelector
from async_tnt.training.dataset_camera import camera_of, check_named
from async_tnt.training.dataset_recording import (
    COPY,
    DAMAGED,
    OTHER_SENSOR,
    UNSEEN,
    OwnRecording,
    fingerprint,
    read_own,
)
from async_tnt.training.windows import Progress, Recordings, no_progress

MOST_SAY = "most recordings say"


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
    left_out_events : of `recordings`, by their pixels: how many were `left_out_outside` of the region, and
        `left_out_masked`. Without a region, or a mask, there is no such name.
    """

    recordings: Recordings
    classes: tuple[str, ...]
    sensor: Sensor
    left_out: tuple[str, ...]
    camera: Sensor
    left_out_events: dict[str, int] = field(default_factory=dict)


def read_classes(
    folder: str | os.PathLike[str],
    *,
    part: str = "Train",
    pixels: PixelSelection | None = None,
    classes: tuple[str, ...] | None = None,
    skip_damaged: bool = False,
    said_by: str | None = None,
    progress: Progress = no_progress,
) -> OwnClasses:
    """Read `<folder>/<class>/<recording>`, or `<folder>/<part>/<class>/<recording>` where there is such a folder.

    Events older than their recording's first one are left out, as a stream leaves them out; the others are put in
    order of time. A recording without events is left out.

    The camera is the one that `pixels` names, else the one that nearly all recordings state. A recording of another
    is left out, as a damaged one is. But more than one in ten of another are refused where `pixels` names no camera,
    or one that no recording states: `camera_of` and `check_named` say why.

    Copies are of two kinds. The same recording in two classes is an error: one of its labels is wrong. That is asked
    of all its events, so that two recordings which differ outside of the region alone are not taken for one. What is
    the same as another recording of its class in all that the network sees, is left out: on both sides of the split,
    it would be learned by heart and then asked for.

    Parameters
    ----------
    pixels : what of the recordings to learn from; by default all events. Its `sensor`, (width, height) of the camera,
        is needed where no recording says it, and for `.bin` of another than N-MNIST's 34 x 34. What it leaves out is
        as if it had never been recorded: times count from the first event that is left.
    classes : the classes there must be; by default the folders there are, at least two.
    skip_damaged : False refuses a recording that cannot be read or is of another sensor, with an error that names it;
        True leaves it out.
    said_by : who says the sensor in `pixels`, for messages, such as "--start-from is for"; by default as
        `PixelSelector.said_by`: an option.

    Raises
    ------
    ValueError : fewer than two classes, or others than `classes`; a class without recordings, or of which none is
        left; the same recording in two classes; recordings of different sensors, or of another one than is named, as
        above; a region or a mask that does not suit the sensor; a recording that lasts too long, or that cannot be
        left out, as `skip_damaged` says.
    OSError : no such folder.
    """
    pixels = PixelSelection() if pixels is None else pixels
    selector = PixelSelector(pixels, None)
    known = pixels.camera
    who = _bare(said_by or selector.said_by[0], pixels) if known is not None else MOST_SAY
    found = find_recordings(folder, part)
    names = tuple(found) if classes is None else classes
    _check_classes(folder, found, classes)
    paths = [(label, path) for label, name in enumerate(names) for path in found.get(name, [])]
    recordings: list[OwnRecording] = []
    for label, path in progress(paths, "reading", len(paths)):
        one = read_own(path, label, selector)
        if known is not None:
            one.fit(known, who)
            one.select(selector, known, who)
        elif one.sensor is not None:  # now, and not when all are in memory with what the network is not to see
            one.select(selector, one.sensor, "it says")
        _refuse_damaged(one, skip_damaged)
        recordings.append(one)
    if known is not None:
        check_named(folder, recordings, known, who)
        camera: Sensor | None = known
    else:
        camera = camera_of(folder, recordings)
        if camera is not None:
            selector.filter_of("", camera)  # refuses a region or a mask that does not suit it
            for one in recordings:
                one.fit(camera, who)
                one.select(selector, camera, who)
                _refuse_damaged(one, skip_damaged)
    _leave_out_copies(recordings)
    kept = [one for one in recordings if one.events is not None]
    empty = [name for label, name in enumerate(names) if label not in {one.label for one in kept}]
    if empty and (classes is None or not kept):  # of a given list of classes, one recording is enough
        out = [one for one in recordings if names[one.label] in empty]
        raise ValueError(f"{folder}: no recording of class {', '.join(empty)} is left; {_advice(out, pixels)}")
    if camera is None:
        _ask_for_sensor(folder, kept, selector)
    left_out_events = {}
    if pixels.roi is not None:
        left_out_events["left_out_outside"] = sum(one.n_outside for one in kept)
    if pixels.mask is not None:
        left_out_events["left_out_masked"] = sum(one.n_masked for one in kept)
    return OwnClasses(
        Recordings.from_events(
            (one.events for one in kept if one.events is not None),
            [one.label for one in kept],
            [one.name for one in kept],
        ),
        names,
        pixels.region or camera,
        tuple(one.left_out for one in recordings if one.cause),
        camera,
        left_out_events,
    )


def _bare(said_by: str, pixels: PixelSelection) -> str:
    """Without the mask's folder: a model's record, which names what was left out, may be given away."""
    return said_by if pixels.mask is None else said_by.replace(pixels.mask.name, Path(pixels.mask.name).name)


def _refuse_damaged(one: OwnRecording, skip_damaged: bool) -> None:
    if one.cause in (DAMAGED, OTHER_SENSOR) and not skip_damaged:
        raise ValueError(one.refusal)


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


def _leave_out_copies(recordings: Iterable[OwnRecording]) -> None:
    """Of recordings that show the network the same; refuses the same recording in two classes."""
    recorded: dict[bytes, OwnRecording] = {}
    seen: dict[tuple[int, bytes], OwnRecording] = {}
    for one in recordings:
        if one.events is None:
            continue
        twin = recorded.setdefault(one.recorded, one)
        if twin.label != one.label:
            raise ValueError(
                f"{twin.name} and {one.name} hold the same events, but are of two classes; remove the wrong one"
            )
        twin = seen.setdefault((one.label, fingerprint(one.events)), one)
        if twin is not one:
            where = "" if twin.recorded == one.recorded else " at the pixels that are not left out"
            one.leave_out(COPY, f"{one.name}: the same events as {twin.name}{where}")


def _advice(left_out: Sequence[OwnRecording], pixels: PixelSelection) -> str:
    """What to do about classes of which these recordings, all there are, were left out."""
    causes = {one.cause for one in left_out}
    if UNSEEN in causes:
        given = {"--roi": pixels.roi, "--mask": pixels.mask}
        advice = f"look at {' and '.join(option for option, value in given.items() if value is not None)}"
    elif OTHER_SENSOR in causes:
        advice = "all recordings must be of one sensor"
    else:
        advice = "record some, or remove the folder"
    if not left_out:
        return advice
    first = left_out[0].left_out
    more = f"{'' if first.endswith('.') else '.'} And {len(left_out) - 1} more" if len(left_out) > 1 else ""
    advice += f" (left out: {first}{more})"
    unfit = (DAMAGED, OTHER_SENSOR)
    if pixels.camera is None and any(one.cause in unfit and one.path.suffix.lower() == ".bin" for one in left_out):
        advice += "; a .bin of another camera than N-MNIST's 34x34 needs --sensor WxH"
    return advice


def _ask_for_sensor(folder: str | os.PathLike[str], kept: Sequence[OwnRecording], selector: PixelSelector) -> NoReturn:
    """The refusal of recordings none of which says its sensor."""
    selector.filter_of(kept[0].name, None)  # has better words where --roi needs it
    x, y = (max(int(one.events[name].max()) for one in kept if one.events is not None) for name in "xy")
    raise ValueError(
        f"{folder}: no recording says how large its sensor is; give --sensor WxH "
        f"(the events need at least {x + 1}x{y + 1})"
    )
