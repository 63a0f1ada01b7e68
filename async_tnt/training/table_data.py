"""Read recordings with tables of boxes into windows to train and validate on, for a map model.

Whole recordings, or groups of them, are held out, so that the same object is never on both sides.
If there is only one recording or group, its last moments are held out.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.evaluation.object_tables import TRACKS, part_folder
from async_tnt.simulation.pictures import SUFFIXES
from async_tnt.sources.files.labelled_recordings import is_recording
from async_tnt.sources.files.source import ReadOptions
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training.groups import groups_by_pattern, hold_out_end, hold_out_groups
from async_tnt.training.held_out import Split
from async_tnt.training.recordings import Recordings
from async_tnt.training.scenes import Scales
from async_tnt.training.settings import with_bins
from async_tnt.training.table_windows import (
    PART,
    Tables,
    WindowReader,
    read_tables,
    stated_sensor,
)
from async_tnt.training.training_data import TrainingData
from async_tnt.training.volume_choice import VolumeChoice
from async_tnt.training.windows import Windows
from async_tnt.training.work import Work

OTHER_PARTS = ("test", "val")
"""Folders of a data set that are no classes, and are not learned from."""
SIZES = (5, 95)
"""Percentiles of the longer sides of boxes that stand for the least and the largest size. The
default grid follows from the least one."""


def table_data(
    folder: Path,
    choice: VolumeChoice,
    *,
    pixels: Pixels,
    reading: ReadOptions,
    split: Split,
    work: Work,
) -> TrainingData:
    """Read a folder of recordings with tables of boxes into windows to train and validate on.

    Parameters
    ----------
    folder : holds the recordings and their tables, or has a folder `train` that does.
    choice, pixels, reading, split, work : see `dataset_data`.

    Raises
    ------
    ValueError : the folder has class folders, too; there is a region or a mask, or the part `Test`
        is asked for; no recording states its sensor, or two have different ones; no recording, or
        no box of a class, is left; or as `groups_by_pattern`.
    OSError : the folder does not exist.
    """
    if pixels.leaves_out:
        raise ValueError("regions and masks are for class folders, not for tables of boxes")
    if split.test:
        raise ValueError("the part `Test` of recordings with tables is for `evaluate`")
    part = part_folder(folder, PART)
    _check_no_class_folders(part)
    tables = read_tables(part)
    camera = pixels.camera or stated_sensor(tables, reading)
    config = choice.for_recordings(camera, None)
    reader = WindowReader(tables, camera, config.window_us, reading)
    recordings, files = reader.read(work)
    sides = _divide(recordings, files, split)
    _check_no_class_empty(sides.training, tables, split.validation)

    assert recordings.boxes is not None
    shares = recordings.boxes["size"].max(axis=1) / min(camera)
    least, most = np.minimum(np.percentile(shares, SIZES), 1).tolist()
    if "grid" in choice.fitted and not config.slides:
        config = config.replace(grid=Scales(least, most).grid(camera))
    if "bins" in choice.fitted:
        config = with_bins(config, sides.training.events_a_pixel(config.window_us))

    record = _description(reader, sides)
    record["sizes"] = [round(least, 5), round(most, 5)]
    return TrainingData(
        config,
        tables.classes,
        sides.training,
        sides.validation,
        record,
        held_out=sides.held_out,
        left_out=tuple(tables.left_out),
        notes=_notes(record, sides),
        scenes=config,
    )


def _check_no_class_folders(folder: Path) -> None:
    """Refuse a folder that has tables, and folders of recordings or pictures, too."""
    for path in sorted(folder.iterdir()):
        is_other = path.name.startswith(".") or path.name.lower() in OTHER_PARTS
        is_sequence = (path / TRACKS).is_file()
        if is_other or is_sequence or not path.is_dir():
            continue
        for file in sorted(path.iterdir()):
            if is_recording(file) or file.suffix.lower() in SUFFIXES:
                raise ValueError(
                    f"{folder}: expected recordings with tables of boxes, or class folders, got "
                    f"both: {file.relative_to(folder)}"
                )


@dataclass(frozen=True)
class _Sides:
    """Windows to learn from, and windows held out.

    Parameters
    ----------
    training, validation : the windows.
    n_files : number of recordings from which the windows were made.
    held_out : names of the recordings that are held out.
    held_out_by : the rule that divided them, as text for the model's record.
    """

    training: Windows
    validation: Windows
    n_files: int
    held_out: tuple[str, ...]
    held_out_by: str

    @property
    def in_time(self) -> bool:
        """Whether the last moments of the only recording, or group of them, are held out."""
        return self.held_out_by == IN_TIME and len(self.validation) > 0


IN_TIME = "time"
"""The value of `_Sides.held_out_by` of a single recording or group."""


def _divide(recordings: Recordings, files: np.ndarray, split: Split) -> _Sides:
    """Hold out whole files, or groups of them, until the share of each class's files is held out.

    files : int64, (R,), the file of each recording.
    """
    windows = Windows(recordings, np.arange(len(recordings)), np.zeros(len(recordings), np.int64))
    names = [name.rpartition(" at ")[0] for name in recordings.names]
    groups = names
    held_out_by = "recording"
    if split.groups is not None:
        groups = groups_by_pattern(names, split.groups)
        held_out_by = f"group ({split.groups})"
    n_files = len(set(names))
    if len(set(groups)) == 1:
        learned, held_out = hold_out_end(len(windows), split.validation)
        return _Sides(windows[learned], windows[held_out], n_files, (), IN_TIME)

    # one entry for each class that a file has
    which, boxes = recordings.boxes_of(windows.recording)
    of_boxes = np.stack([files[which], boxes["label"]], axis=1)
    entries, first = np.unique(of_boxes, axis=0, return_index=True)
    entry_groups = [groups[r] for r in which[first]]
    rng = np.random.default_rng(split.seed)
    _, chosen = hold_out_groups(entries[:, 1], entry_groups, split.validation, rng)
    is_held_out = np.isin(files, entries[chosen, 0])
    return _Sides(
        windows[np.flatnonzero(~is_held_out)],
        windows[np.flatnonzero(is_held_out)],
        n_files,
        tuple(sorted({names[r] for r in np.flatnonzero(is_held_out)})),
        held_out_by,
    )


def _boxes_of_classes(windows: Windows, n_classes: int) -> np.ndarray:
    """How many boxes of each class windows have: int64, (n_classes,)."""
    _, boxes = windows.recordings.boxes_of(windows.recording)
    return np.bincount(boxes["label"], minlength=n_classes)


def _check_no_class_empty(training: Windows, tables: Tables, share: float) -> None:
    """Refuse a class of which no box is left to learn from.

    share : the share of each class to hold out.
    """
    n_classes = len(tables.classes)
    learned = _boxes_of_classes(training, n_classes)
    if learned.all():
        return
    assert training.recordings.boxes is not None
    read = np.bincount(training.recordings.boxes["label"], minlength=n_classes)
    gone = [tables.classes[k] for k in np.flatnonzero(read == 0)]
    if gone:
        raise ValueError(
            f"no box of class {', '.join(gone)} is left to learn from: none has enough events in "
            f"a recording that can be read{tables.why_left_out()}; record more, or remove its "
            "rows from the tables"
        )
    late = [tables.classes[k] for k in np.flatnonzero(learned == 0)]
    raise ParameterValueError(
        "validation",
        "must leave boxes of each class to learn from: all boxes of class "
        f"{', '.join(late)} are in the last moments of the only recording or group; hold out less, "
        "or 0",
        share,
    )


def _description(reader: WindowReader, sides: _Sides) -> dict[str, Any]:
    """A description of the recordings, for the model's record."""
    classes = reader.tables.classes
    learned = _boxes_of_classes(sides.training, len(classes))
    held_out = _boxes_of_classes(sides.validation, len(classes))
    record: dict[str, Any] = {
        "source": f"recordings with tables of boxes, held out by {sides.held_out_by}",
        "classes": dict(zip(classes, (learned + held_out).tolist(), strict=True)),
        "sensor": list(reader.camera),
        "real_recordings": sides.n_files - len(sides.held_out),
        "held_out_recordings": len(sides.held_out),
        "moments": len(sides.training),
        "held_out_moments": len(sides.validation),
        "boxes": int(learned.sum()),
        "held_out_boxes": int(held_out.sum()),
        "boxes_left_out": {why: n for why, n in reader.boxes_left_out.items() if n},
        "moments_left_out": {why: n for why, n in reader.moments_left_out.items() if n},
        "left_out": reader.tables.left_out,
    }
    if reader.n_off_sensor:
        record["left_out_off_sensor"] = reader.n_off_sensor
    if reader.n_late:
        record["late_events"] = reader.n_late
    if sides.in_time:
        record["held_out_in_time"] = list(classes)
    return record


def _notes(record: dict[str, Any], sides: _Sides) -> tuple[str, ...]:
    """Lines that tell how many boxes there are, what is left out, and how they are divided."""
    counts = ", ".join(f"{name} {n}" for name, n in record["classes"].items())
    least, most = record["sizes"]
    notes = [
        f"boxes: {counts}; most of their longer sides are {least:.3g} to {most:.3g} of the "
        "sensor's shorter side"
    ]
    for what in ("boxes", "moments"):
        reasons = record[f"{what}_left_out"]
        if reasons:
            text = ", ".join(f"{n} {why}" for why, n in reasons.items())
            notes.append(f"{what} left out: {text}")
    if "left_out_off_sensor" in record:
        notes.append(f"events left out: {record['left_out_off_sensor']:,} off the sensor")
    if "late_events" in record:
        notes.append(
            f"events more than a window later than newer ones: {record['late_events']:,}; they may "
            "be missing, so sort the recordings by time"
        )
    if sides.in_time:
        notes.append(
            "held out in time, as there is only one recording, or one group of them: its last "
            "moments; only another recording tells more"
        )
    else:
        notes.append(
            f"held out by {sides.held_out_by}: {len(sides.held_out)} of {sides.n_files} recordings"
        )
    return tuple(notes)
