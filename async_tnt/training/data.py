"""What a model is trained, validated and tested on: windows of class folders, and their record."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.progress import Bar
from async_tnt.simulation.picture_scene import SceneSettings
from async_tnt.sources.files.labelled_recordings import file_of
from async_tnt.sources.files.source import ReadOptions
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.streaming.windows import N_JUDGED, TimeUnitCheck
from async_tnt.training.dataset import Dataset, read_dataset
from async_tnt.training.groups import (
    groups_by_pattern,
    hold_out_end,
    hold_out_groups,
    hold_out_last,
)
from async_tnt.training.recordings import Recordings
from async_tnt.training.settings import default_grid, with_bins
from async_tnt.training.simulated_pictures import check_pictures, find_pictures, with_pictures
from async_tnt.training.windows import Windows, make_windows
from async_tnt.volume.config import TNTConfig

BY_NUMBER = "number, the last ones"


@dataclass(frozen=True)
class TrainingData:
    """Windows to train on, to validate on and to test on.

    Parameters
    ----------
    config : of the volumes, with the sensor of the events.
    classes : names, one for each label.
    training, validation : windows to learn from, and windows held out.
    record : the recordings, for the model's record.
    tests : name in the model's record -> windows, and more for that entry of the record.
    held_out : names of the recordings to validate on.
    masked : bool, (H, W): pixels of the sensor whose events were left out; None: no pixel.
    left_out : which recordings were left out and why, one line each.
    notes : what else a user should know, one line each.
    """

    config: TNTConfig
    classes: tuple[str, ...]
    training: Windows
    validation: Windows
    record: dict[str, Any]
    tests: Mapping[str, tuple[Windows, dict[str, Any]]] = field(default_factory=dict)
    held_out: tuple[str, ...] = ()
    masked: np.ndarray | None = None
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def dataset_data(
    folder: Path,
    config: TNTConfig,
    *,
    pixels: Pixels,
    reading: ReadOptions | None = None,
    sensor_source: str = "`sensor`",
    classes: tuple[str, ...] | None = None,
    validation: float = 0.2,
    groups: str | None = None,
    fitted: Collection[str] = (),
    test: bool = False,
    seed: int = 0,
    store: Path | None = None,
    begin: Callable[[], None] = lambda: None,
    scenes: Mapping[str, Any] | None = None,
    workers: int = 1,
    progress: Callable[..., Bar] = Bar,
) -> TrainingData:
    """A folder of class folders, split by groups of recordings. Windows start at each recording's
    first event.

    Class folders may hold pictures, too, which are split like recordings and then recorded by
    `simulate_pictures`.

    Parameters
    ----------
    folder : has a folder for each class.
    config : its sensor is replaced by that of the events.
    pixels, reading, sensor_source, classes : as for `read_dataset`.
    validation : share of each class's recordings to hold out; at least one, if there are two
        groups.
    groups : a regular expression, see `groups_by_pattern`; by default the last recordings of each
        class by number, or some at random.
    fitted : what of `config` becomes the default of this data set. "grid": that of the sensor, see
        `default_grid`; "window_us": where no recording is as long as a window, windows become as
        long as the longest one; "bins": time bins where pixels fire often, see `with_bins`.
    test : also read the recordings for `Test`, through the same pixels.
    seed : of the split.
    store : a folder for the events, see `read_dataset`; without it, pictures are recorded in a
        temporary one.
    begin : called before pictures are recorded, when what is learned from has been read and split.
    scenes : of `SceneSettings`, what differs from its defaults.
    workers : processes that record pictures.
    progress : makes the progress bar, which counts recordings.
    """
    pictures = find_pictures(folder)
    dataset = read_dataset(
        folder,
        pixels=pixels,
        reading=reading,
        sensor_source=sensor_source,
        classes=classes,
        with_pictures=pictures,
        store=store,
        progress=progress,
    )
    grid = default_grid(dataset.sensor) if "grid" in fitted else config.grid
    config = config.replace(sensor=dataset.sensor, grid=grid)
    recordings, n_real, classes = dataset.recordings, len(dataset.recordings), dataset.classes
    notes = _notes(dataset, "the recordings")
    longest_us = (
        int(recordings.t[recordings.offsets[1:] - 1].max()) + 1 if n_real else config.window_us
    )
    if "window_us" in fitted and longest_us < config.window_us:
        config = config.replace(window_us=-(-longest_us // 1000) * 1000)
        notes.append(f"windows of {config.window_us} us, as no recording is longer")
    of_pictures, bad_pictures = check_pictures(pictures, classes, recordings.labels, progress)
    names = (*recordings.names, *(picture.name for picture in of_pictures))
    labels = np.concatenate(
        [recordings.labels, np.array([one.label for one in of_pictures], np.int64)]
    )
    # of pictures as large a share as of recordings
    kinds = 2 * labels + (np.arange(len(labels)) >= n_real)
    learned, held_out, how, counted = _split(names, kinds, groups, validation, seed)
    held_out_names = tuple(names[r] for r in held_out)
    about: dict[str, Any] = {}
    begin()
    if of_pictures:
        began = time.monotonic()
        recordings, learned, held_out, about = with_pictures(
            recordings,
            of_pictures,
            (learned, held_out),
            SceneSettings(config.sensor, config.window_us, **(scenes or {})),
            store,
            seed=seed,
            workers=workers,
            progress=progress,
        )
        seconds = time.monotonic() - began
        words = (
            "pictures: {pictures}, those to learn from recorded {takes} times each (took {:.0f} s)"
        )
        notes.append(words.format(seconds, **about))

    def windows_of(of: Recordings, which: np.ndarray | None = None) -> Windows:
        return make_windows(of, config.window_us, which=which, first_event=True, duration_us=None)

    windows = windows_of(recordings, learned), windows_of(recordings, held_out)
    training, validating, ended = _with_ends(*windows, validation, n_real, config.window_us)
    counts = {name: int((labels == k).sum()) for k, name in enumerate(classes)}
    _check_windows(training, config, counts)
    if "bins" in fitted:
        events_a_pixel = training.events_a_pixel(config.window_us)
        config = with_bins(config, events_a_pixel)
        if config.representation == "volume":
            notes.append(
                f"{config.bins} time bins, as an active pixel fires {events_a_pixel:.1f} times in "
                "a window"
            )
    record: dict[str, Any] = {
        "source": f"recordings of own classes, held out by {how}",
        "classes": counts,
        "sensor": list(dataset.sensor),
        "real_recordings": int((learned < n_real).sum()),
        "held_out_recordings": int((held_out < n_real).sum()),
        "left_out": [*dataset.left_out, *bad_pictures],
        **({"pictures": about} if about else {}),
    }
    if pixels.leaves_out:
        record["pixels"] = {
            **pixels.about,
            "camera": list(dataset.camera),
            **dataset.left_out_events,
        }
    of_events = {"left_out_late": dataset.n_late, "left_out_off_sensor": dataset.n_off_sensor}
    record |= {name: n for name, n in of_events.items() if n}
    of_each = ", ".join(f"{name} {n}" for name, n in counts.items())
    notes.append(f"recordings{' and pictures' if about else ''}: {of_each}")
    notes.append(f"held out by {how}: {counted}")
    if how == BY_NUMBER and record["held_out_recordings"]:
        notes.append(
            "the first of them may follow the last learned ones within seconds: such recordings "
            "need groups"
        )
    single = [one for k, one in enumerate(classes) if counts[one] and k not in validating.labels]
    if single and validation:
        notes.append(
            f"not held out, as there is only one short recording, picture or group: "
            f"{', '.join(single)}"
        )
    if ended:
        alone = ", ".join(classes[k] for k in ended)
        notes.append(
            f"held out in time, as there is only one recording, or one group of them: the last "
            f"windows of {alone}; "
            "they are of the day, place and person that was learned from: only another session "
            "tells more"
        )
        record["held_out_in_time"] = [classes[k] for k in ended]
    left_out, tests, mask = [*dataset.left_out, *bad_pictures], {}, _masked(pixels, dataset)
    if test:
        testing = read_dataset(
            folder / "Test" if (folder / "Test").is_dir() else folder,
            part="Test",
            pixels=replace(pixels, sensor=dataset.camera),
            reading=reading,
            sensor_source="the recordings to train on",
            classes=classes,
            known=dataset.known,
            store=store,
            progress=progress,
        )
        tests["test"] = (windows_of(testing.recordings), {"left_out": list(testing.left_out)})
        left_out += [f"Test/{line}" for line in testing.left_out]
        notes += _notes(testing, "Test")
    return TrainingData(
        config,
        classes,
        training,
        validating,
        record,
        tests,
        held_out_names,
        mask,
        tuple(left_out),
        tuple(notes),
    )


def _check_windows(training: Windows, config: TNTConfig, counts: Mapping[str, int]) -> None:
    """Refuse a class of which there are recordings or pictures, but no window; warn of times in
    another unit."""
    if silent := [
        name for k, name in enumerate(counts) if counts[name] and k not in training.labels
    ]:
        raise ValueError(
            f"no window of class {', '.join(silent)} has an event; `window_us` = {config.window_us}"
        )
    check = TimeUnitCheck(config)
    for i in range(len(training[:N_JUDGED])):
        check.add(len(training.events(i, config.window_us)[0]))


def _with_ends(
    training: Windows, validation: Windows, share: float, n_real: int, window_us: int
) -> tuple[Windows, Windows, list[int]]:
    """Hold out the last windows of each class whose recordings are all learned from, as there is
    only one group.

    Parameters
    ----------
    n_real : recordings; those after them are of pictures.

    Returns
    -------
    training, validation, and these classes.
    """
    names = training.recordings.names
    session_us = np.array(
        [
            int(name.rpartition("[")[2].partition(":")[0]) if file_of(name) != name else 0
            for name in names
        ]
    )
    times_us = training.start_us + session_us[training.recording]
    numbered = [
        re.sub(r"\d+", lambda n: n[0].zfill(20), file_of(name)) + " " + file_of(name)
        for name in names
    ]
    files = np.unique(numbered, return_inverse=True)[1][training.recording]
    keep, ended, ends = np.ones(len(training), bool), [], []
    for label in np.setdiff1d(training.labels, validation.labels) if share else ():
        mine = np.flatnonzero((training.labels == label) & (training.recording < n_real))
        mine = mine[np.lexsort((times_us[mine], files[mine]))]  # one file after the other
        learned, held_out = hold_out_end(len(mine), share)
        if len(held_out):
            first = mine[held_out[0]]
            # parts of a session may overlap: nor is what reaches beyond the first one's start kept
            keep[mine] = False
            keep[mine[learned]] = (
                (files != files[first]) | (times_us + window_us <= times_us[first])
            )[mine[learned]]
            ended.append(int(label))
            ends.append(mine[held_out])
    if not ended:
        return training, validation, ended
    more = training[np.concatenate(ends)]
    columns = (
        np.concatenate([getattr(w, name) for w in (validation, more)])
        for name in ("recording", "start_us")
    )
    return training[np.flatnonzero(keep)], Windows(training.recordings, *columns), ended


def _split(
    names: tuple[str, ...], labels: np.ndarray, pattern: str | None, share: float, seed: int
) -> tuple[np.ndarray, np.ndarray, str, str]:
    """Which recordings and pictures to train on and which to hold out; by what, and how many."""
    if not 0 <= share < 1:
        raise ValueError(f"`validation` must be in [0, 1), got {share}")
    files = [file_of(name) for name in names]
    if pattern is not None:
        together, how = groups_by_pattern(files, pattern), f"group ({pattern})"
    else:
        last = hold_out_last(names, labels, share)
        if last is not None:
            return *last, BY_NUMBER, f"{len(last[1])} of {len(labels)} recordings"
        together, how = files, "recording" if files == list(names) else "session"
    learned, held_out = hold_out_groups(labels, together, share, np.random.default_rng(seed))
    return learned, held_out, how, f"{len({together[r] for r in held_out})} of {len(set(together))}"


def _masked(pixels: Pixels, dataset: Dataset) -> np.ndarray | None:
    mask = pixels.mask_of(dataset.camera)
    if mask is None:
        return None
    if pixels.crop and pixels.roi is not None:
        x, y, width, height = pixels.roi
        mask = mask[y : y + height, x : x + width]
    return np.asarray(mask, bool)


def _notes(dataset: Dataset, where: str) -> list[str]:
    """How many events were left out, and why."""
    words = {"left_out_outside": "outside of the region", "left_out_masked": "of masked pixels"}
    counts = [f"{n:,} {words[name]}" for name, n in dataset.left_out_events.items()]
    if dataset.n_late:
        counts.append(f"{dataset.n_late:,} older than the first one of their recording")
    if dataset.n_off_sensor:
        counts.append(f"{dataset.n_off_sensor:,} off the sensor")
    return [f"events left out of {where}: {', '.join(counts)}"] if counts else []
