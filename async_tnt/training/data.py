"""Read a data set into windows to train, validate and test on.

It is a folder of class folders, or of recordings with tables of boxes (`table_data`).

A description of the recordings goes into the model's record.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.evaluation.object_tables import has_tables
from async_tnt.simulation.picture_scene import SceneSettings
from async_tnt.sources.files.source import ReadOptions
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.streaming.windows import N_JUDGED, TimeUnitCheck
from async_tnt.training.dataset import Dataset, Reading, read_part
from async_tnt.training.held_out import BY_NUMBER, Division, Split, divide, hold_out_ends
from async_tnt.training.recordings import Recordings
from async_tnt.training.scenes import Scales
from async_tnt.training.settings import duration_us, with_bins
from async_tnt.training.simulated_pictures import (
    LabelledPicture,
    check_pictures,
    find_pictures,
    with_pictures,
)
from async_tnt.training.table_data import table_data
from async_tnt.training.table_windows import PART
from async_tnt.training.training_data import TrainingData
from async_tnt.training.volume_choice import VolumeChoice
from async_tnt.training.windows import Windows, windows_of
from async_tnt.training.work import Work
from async_tnt.volume.config import TNTConfig

MOMENTS = 4
"""How many held-out windows that slide end within the length of one window."""


def dataset_data(
    folder: Path,
    volume: TNTConfig | VolumeChoice,
    *,
    pixels: Pixels | None = None,
    reading: ReadOptions | None = None,
    split: Split = Split(),  # noqa: B008  (frozen)
    scenes: Mapping[str, Any] | None = None,
    scales: tuple[float, float] | None = None,
    work: Work = Work(),  # noqa: B008  (frozen)
) -> TrainingData:
    """Read a data set into windows to train, validate and test on.

    It is a folder of class folders, or of recordings whose tables say what stands where, for a map
    model. For the latter see `table_data`; what follows is about class folders.

    Whole groups of recordings are held out for validation. The first window of a recording starts
    at the recording's first event. Class folders may hold pictures, too. Pictures are split like
    recordings. Then simulated cameras record them, see `simulated_pictures`.

    Parameters
    ----------
    folder : the data set; it has a folder for each class, or recordings with tables of boxes.
    volume : how events become volumes. The data set replaces only the sensor of a `TNTConfig`. If
        `volume` is a `VolumeChoice`, it also decides the fields that the choice leaves open.
    pixels : selects the events to learn from by their pixels; by default all.
    reading : facts about files that do not state them.
    split : what is held out, and whether the part `Test` is read.
    scenes : how pictures are recorded: name of a field of `SceneSettings` -> value, for the fields
        that differ from the default.
    scales : the least and the largest longer side of objects, as shares of the sensor's shorter
        side, for a map model that learns from scenes of a sensor of the data set's size, see
        `scenes`. Then the data set holds pictures only. None: each recording shows an object at the
        size that it has there. With tables, sizes come from them.
    work : where events are kept, and how many processes record pictures.

    Raises
    ------
    ValueError, OSError : as `read_part`; the same picture is in two classes; a class has no window;
        `split.groups` is not found in a recording's name; there are `scales` for recordings; or
        as `table_data`.
    """
    choice = VolumeChoice(volume) if isinstance(volume, TNTConfig) else volume
    if has_tables(Path(folder), PART):
        if scales is not None:
            rule = "must not be given with tables of boxes, which have sizes"
            raise ParameterValueError("scales", rule, scales)
        return table_data(
            Path(folder),
            choice,
            pixels=pixels or Pixels(),
            reading=reading or ReadOptions(),
            split=split,
            work=work,
        )
    how = Reading(pixels or Pixels(), reading or ReadOptions(), work)
    picture_files = find_pictures(folder)
    dataset = read_part(folder, how, with_pictures=picture_files)
    config = choice.for_recordings(dataset.sensor, _longest_us(dataset.recordings))
    fields = dict(scenes or {})
    whole = None
    if scales is not None:
        whole = _whole_scenes(Scales(*scales), choice, config, dataset)
        config = Scales(*scales).cut_out(whole)
        fields |= {"size": Scales(*scales).on_cut_out(whole), "cut_out": True}
    pictures, bad_pictures = check_pictures(
        picture_files, dataset.classes, dataset.recordings.labels, work.progress
    )
    examples = _Examples(dataset, tuple(pictures))
    division = divide(examples.names, examples.kinds, split)

    scene = SceneSettings(config.sensor, duration_us(config), **fields)
    recorded = _record(examples, division, scene, split.seed, work)
    windows, labels_in_time = _windows(recorded, config, examples.n_recordings, split)
    _check_windows(windows.training, config, examples.counts)
    events_a_pixel = None
    if "bins" in choice.fitted:
        events_a_pixel = windows.training.events_a_pixel(config.window_us)
        config = with_bins(config, events_a_pixel)

    record = _description(examples, division, recorded, bad_pictures, how.pixels)
    notes = [
        *_notes_on_events(dataset, "the recordings"),
        *_notes_on_volume(choice, config, recorded, events_a_pixel),
        *_notes_on_split(examples, division, record, windows.validation, split),
    ]
    if labels_in_time:
        names = [dataset.classes[k] for k in labels_in_time]
        notes.append(_note_on_ends(names))
        record["held_out_in_time"] = names
    left_out = [*dataset.left_out, *bad_pictures]
    tests = {}
    if split.test:
        test_part = _read_test(folder, how, dataset)
        test_windows = windows_of(test_part.recordings, config, moments=MOMENTS)
        tests["test"] = (test_windows, {"left_out": list(test_part.left_out)})
        left_out += [f"Test/{line}" for line in test_part.left_out]
        notes += _notes_on_events(test_part, "Test")
    return TrainingData(
        config,
        dataset.classes,
        windows.training,
        windows.validation,
        record,
        tests,
        held_out=tuple(examples.names[r] for r in division.held_out),
        masked=_masked(how.pixels, dataset),
        left_out=tuple(left_out),
        notes=tuple(notes),
        scenes=None if whole is None else config.replace(sensor=whole.sensor, grid=whole.grid),
    )


# -- the steps, in their order ---------------------------------------------------------------------


def _whole_scenes(
    scales: Scales, choice: VolumeChoice, config: TNTConfig, dataset: Dataset
) -> TNTConfig:
    """How the events of scenes of objects of many sizes become volumes.

    config : as for a recording of the whole sensor.
    """
    if len(dataset.recordings):
        raise ParameterValueError(
            "scales",
            "is for pictures, which are recorded at any size; recordings keep theirs",
            f"{len(dataset.recordings)} recordings",
        )
    if "grid" in choice.fitted and not config.slides:
        return config.replace(grid=scales.grid(config.sensor))
    return config


@dataclass(frozen=True)
class _Examples:
    """The content of a data set: recordings of a camera, followed by pictures."""

    dataset: Dataset
    pictures: tuple[LabelledPicture, ...]

    @property
    def n_recordings(self) -> int:
        return len(self.dataset.recordings)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of recordings and pictures, `class/file`."""
        return (*self.dataset.recordings.names, *(picture.name for picture in self.pictures))

    @property
    def labels(self) -> np.ndarray:
        """int64, (n,): the labels of recordings and pictures."""
        picture_labels = np.array([picture.label for picture in self.pictures], np.int64)
        return np.concatenate([self.dataset.recordings.labels, picture_labels])

    @property
    def kinds(self) -> np.ndarray:
        """int64, (n,): 2 * label for a recording, and 2 * label + 1 for a picture.

        The split holds out the same share of each number. So it holds out the same share of a
        class's recordings and of the class's pictures.
        """
        labels = self.labels
        is_picture = np.arange(len(labels)) >= self.n_recordings
        return 2 * labels + is_picture

    @property
    def counts(self) -> dict[str, int]:
        """The number of recordings and pictures of each class."""
        labels = self.labels
        return {name: int((labels == k).sum()) for k, name in enumerate(self.dataset.classes)}


@dataclass(frozen=True)
class _Recorded:
    """All recordings: first those of a camera, then the simulated ones of pictures.

    Parameters
    ----------
    recordings : all recordings.
    learned, held_out : indices of the recordings to learn from, and of those that are held out.
    picture_record : what the model's record says of the pictures; empty without pictures.
    seconds : how long the simulation took.
    """

    recordings: Recordings
    learned: np.ndarray
    held_out: np.ndarray
    picture_record: dict[str, Any]
    seconds: float


def _record(
    examples: _Examples, division: Division, scene: SceneSettings, seed: int, work: Work
) -> _Recorded:
    """Simulate recordings of the pictures, and append them to the recordings of the camera."""
    recordings = examples.dataset.recordings
    learned = division.learned
    held_out = division.held_out
    if not examples.pictures:
        return _Recorded(recordings, learned, held_out, {}, 0.0)
    start_s = time.monotonic()
    recordings, learned, held_out, picture_record = with_pictures(
        recordings,
        examples.pictures,
        (learned, held_out),
        scene,
        seed,
        work,
    )
    return _Recorded(recordings, learned, held_out, picture_record, time.monotonic() - start_s)


@dataclass(frozen=True)
class _Sides:
    """Windows to learn from, and windows held out."""

    training: Windows
    validation: Windows


def _windows(
    recorded: _Recorded, config: TNTConfig, n_real: int, split: Split
) -> tuple[_Sides, list[int]]:
    """The windows of both sides, and the labels of the classes whose last windows are held out.

    n_real : number of recordings of a camera, which come before those of pictures.
    """
    training = windows_of(recorded.recordings, config, which=recorded.learned)
    validation = windows_of(recorded.recordings, config, which=recorded.held_out, moments=MOMENTS)
    training, validation, labels_in_time = hold_out_ends(
        training, validation, split.validation, n_real, config.window_us
    )
    return _Sides(training, validation), labels_in_time


def _longest_us(recordings: Recordings) -> int | None:
    """The length of the longest recording, in microseconds; None without recordings."""
    if not len(recordings):
        return None
    last = recordings.offsets[1:] - 1
    return int(recordings.t[last].max()) + 1


def _check_windows(training: Windows, config: TNTConfig, counts: Mapping[str, int]) -> None:
    """Refuse a class without a window. Warn if the times seem to be in another unit.

    counts : class -> the number of its recordings and pictures.
    """
    has_windows = set(training.labels.tolist())  # empty windows are not among the windows
    empty = [name for k, name in enumerate(counts) if counts[name] > 0 and k not in has_windows]
    if empty:
        raise ValueError(
            f"no window of class {', '.join(empty)} has an event (windows of {config.window_us} us)"
        )
    check = TimeUnitCheck(config)
    for i in range(len(training[:N_JUDGED])):
        t, _, _, _ = training.events(i, config.window_us)
        check.add(len(t))


def _read_test(folder: Path, how: Reading, dataset: Dataset) -> Dataset:
    """Read the part `Test`: the folder `Test`, or the sessions that the list for `Test` names."""
    test = folder / "Test"
    return read_part(test if test.is_dir() else folder, how, part="Test", train_part=dataset)


def _masked(pixels: Pixels, dataset: Dataset) -> np.ndarray | None:
    """bool, (H, W): pixels of the sensor whose events were left out; None if there are none."""
    mask = pixels.mask_of(dataset.camera)
    if mask is None:
        return None
    if pixels.crop and pixels.roi is not None:  # the sensor is the region, not the whole camera
        x, y, width, height = pixels.roi
        mask = mask[y : y + height, x : x + width]
    return np.asarray(mask, bool)


# -- what the record and the notes say of a data set -----------------------------------------------


def _description(
    examples: _Examples,
    division: Division,
    recorded: _Recorded,
    bad_pictures: list[str],
    pixels: Pixels,
) -> dict[str, Any]:
    """A description of the recordings, for the model's record."""
    dataset = examples.dataset
    n_real = examples.n_recordings
    record: dict[str, Any] = {
        "source": f"recordings of own classes, held out by {division.held_out_by}",
        "classes": examples.counts,
        "sensor": list(dataset.sensor),
        "real_recordings": int((recorded.learned < n_real).sum()),
        "held_out_recordings": int((recorded.held_out < n_real).sum()),
        "left_out": [*dataset.left_out, *bad_pictures],
    }
    if recorded.picture_record:
        record["pictures"] = recorded.picture_record
    if pixels.leaves_out:
        camera = list(dataset.camera)
        record["pixels"] = {**pixels.about, "camera": camera, **dataset.left_out_events}
    if dataset.n_late:
        record["left_out_late"] = dataset.n_late
    if dataset.n_off_sensor:
        record["left_out_off_sensor"] = dataset.n_off_sensor
    return record


def _notes_on_events(dataset: Dataset, place: str) -> list[str]:
    """A line that tells how many events of `place` were left out, and why; no line if all stay."""
    reasons = {"left_out_outside": "outside of the region", "left_out_masked": "of masked pixels"}
    counts = [f"{n:,} {reasons[name]}" for name, n in dataset.left_out_events.items()]
    if dataset.n_late:
        counts.append(f"{dataset.n_late:,} older than the first one of their recording")
    if dataset.n_off_sensor:
        counts.append(f"{dataset.n_off_sensor:,} off the sensor")
    return [f"events left out of {place}: {', '.join(counts)}"] if counts else []


def _notes_on_volume(
    choice: VolumeChoice, config: TNTConfig, recorded: _Recorded, events_a_pixel: float | None
) -> list[str]:
    """Lines that tell how the data set changed the volume, and how often pictures were recorded.

    The data set may have shortened the windows, or have decided that there are time bins.

    Parameters
    ----------
    choice : the volume that the user asked for.
    config : the volume that was decided.
    recorded : all recordings.
    events_a_pixel : number of events of one polarity that an active pixel has in a window, see
        `Windows.events_a_pixel`. None: the data set did not decide on time bins.
    """
    notes = []
    if config.window_us != choice.config.window_us:
        notes.append(f"windows of {config.window_us} us, as no recording is longer")
    pictures = recorded.picture_record
    if pictures:
        notes.append(
            f"pictures: {pictures['pictures']}, those to learn from recorded "
            f"{pictures['takes']} times each (took {recorded.seconds:.0f} s)"
        )
    if events_a_pixel is not None and config.representation == "volume":
        notes.append(
            f"{config.bins} time bins, as an active pixel fires {events_a_pixel:.1f} times in a "
            "window"
        )
    return notes


def _notes_on_split(
    examples: _Examples,
    division: Division,
    record: dict[str, Any],
    validation: Windows,
    split: Split,
) -> list[str]:
    """Lines that tell how many recordings there are, how they are divided, and what is missing.

    Parameters
    ----------
    examples : the content of the data set.
    division : which recordings and pictures are held out.
    record : the description of the recordings.
    validation : the held-out windows. A line names the classes that have none.
    split : how the data set was to be divided.
    """
    counts = examples.counts
    noun = "recordings and pictures" if examples.pictures else "recordings"
    count_of_each = ", ".join(f"{name} {n}" for name, n in counts.items())
    notes = [
        f"{noun}: {count_of_each}",
        f"held out by {division.held_out_by}: {division.count_text}",
    ]
    if division.held_out_by == BY_NUMBER and record["held_out_recordings"]:
        notes.append(
            "the first of them may follow the last learned ones within seconds: such recordings "
            "need groups"
        )
    held_out_labels = set(validation.labels.tolist())
    single = [
        name for k, name in enumerate(counts) if counts[name] > 0 and k not in held_out_labels
    ]
    if single and split.validation:
        notes.append(
            "not held out, as there is only one short recording, picture or group: "
            f"{', '.join(single)}"
        )
    return notes


def _note_on_ends(names: list[str]) -> str:
    """A line that explains what it means to hold out the last windows of these classes."""
    return (
        "held out in time, as there is only one recording, or one group of them: the last windows "
        f"of {', '.join(names)}; they are of the day, place and person that was learned from: only "
        "another session tells more"
    )
