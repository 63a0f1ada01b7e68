"""What `async-tnt train DATASET` does otherwise than with N-MNIST: its data, its settings, and what it writes."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.archive.scores import Scores
from async_tnt.cli.output import one_line
from async_tnt.cli.pixel_options import selection_of
from async_tnt.config import TNTConfig
from async_tnt.files import write_text
from async_tnt.networks.model import Model
from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.sources.pixel_selector import check_region
from async_tnt.sources.sizes import by, parse_size
from async_tnt.training.augment import Augmentation
from async_tnt.training.dataset import OwnClasses, read_classes
from async_tnt.training.run_folder import check_recordings, note_recordings, other_pixels, other_run, sizes_of
from async_tnt.training.settings import TrainSettings
from async_tnt.training.windows import Progress, Windows, lay_windows, split_recordings

FEWEST_STEPS = 1_500  # of the optimizer, of which patience may leave some undone
NUMBERS, PICTURES = ".json", (".curves.png", ".confusion.png")
BESIDE = (NUMBERS, *PICTURES)
"""Suffixes of the files that are written beside the model."""
NMNIST_ONLY = {
    "nmnist": "--nmnist",
    "mnist": "--mnist",
    "simulated": "--simulated",
    "smoke": "--smoke",
}


@dataclass(frozen=True)
class OwnData:
    """Windows to train on and windows held out, of one's own classes; and the data in words and numbers."""

    config: TNTConfig
    classes: tuple[str, ...]
    training: Windows
    validation: Windows
    words: dict[str, Any]
    held_out: tuple[str, ...]
    pixels: PixelSelection
    """With the camera's sensor as the recordings say it."""


def check_options(args: argparse.Namespace) -> None:
    """Refuse options that do not go together.

    Raises
    ------
    ValueError : names them.
    """
    if args.dataset is None:
        names = ("sensor", "grid", "window_us", "roi", "crop", "mask")
        given = [f"--{name.replace('_', '-')}" for name in names if getattr(args, name)]
        if given:
            raise ValueError(f"{', '.join(given)} must come with DATASET, a folder of class folders")
        return
    given = [option for name, option in NMNIST_ONLY.items() if getattr(args, name)]
    given += ["--saccades"] if args.saccades != [1, 2, 3] else []
    if given:
        raise ValueError(f"{', '.join(given)} must come without DATASET: one trains on the one or on the other")
    if args.start_from and (args.grid or args.window_us):
        raise ValueError("--grid and --window-us must come without --start-from: the volume is that model's")


def load(
    args: argparse.Namespace, config: TNTConfig, start: Model | None, progress: Progress, run_folder: Path
) -> OwnData:
    """Read DATASET, and split it by recording; refuse the run folder before that where it holds another run.

    Parameters
    ----------
    config : without sensor, grid and window, which are the options' or the recordings'; of `start`, as it is.
    """
    classes = None if start is None else start.classes
    pixels = selection_of(args)
    if start is not None:
        pixels = _of_start(pixels, start)
    else:
        config = config.replace(
            grid=parse_size(args.grid) if args.grid else config.grid, window_us=args.window_us or config.window_us
        )
        _check_grid(config)
        if pixels.region is not None and min(pixels.region) < 2:  # now, before the data is read
            raise ValueError(
                "--roi with --crop: the region is the model's sensor and must have sides of at least 2 pixels, "
                f"got {by(pixels.region)}"
            )
    share = 0.2 if args.validation is None else args.validation
    sizes = sizes_of(args.dataset)
    goes_on = _check_run(args, config, pixels, run_folder)
    if goes_on:
        check_recordings(run_folder, sizes, share)
    own = read_classes(
        args.dataset,
        pixels=pixels,
        classes=classes,
        skip_damaged=True,
        progress=progress,
        said_by=None if start is None or pixels.crop else "--start-from is for",
    )
    _say_left_out(own)
    config = config.replace(sensor=own.sensor)
    learned, held_out = split_recordings(own.recordings, share, np.random.default_rng(args.seed), at_least=1)
    if not goes_on:
        note_recordings(run_folder, sizes, share, own.recordings.names, pixels.record)
    labels = own.recordings.labels
    counts = {name: int((labels == k).sum()) for k, name in enumerate(own.classes)}
    found = ", ".join(f"{name} {n}" for name, n in counts.items())
    print(f"recordings: {one_line(found)}", file=sys.stderr)
    unseen = [name for k, name in enumerate(own.classes) if counts[name] and k not in labels[held_out]]
    if unseen and share:
        print(f"not held out, for want of a second recording: {one_line(', '.join(unseen))}", file=sys.stderr)
    words = {
        "source": "recordings of own classes, held out by recording",
        "classes": counts,
        "sensor": list(own.sensor),
        "real_recordings": len(learned),
        "held_out_recordings": len(held_out),
        "left_out": list(own.left_out),
    }
    if pixels.leaves_out:
        words["pixels"] = {**pixels.record, "camera": list(own.camera), **own.left_out_events}

    def windows_of(which: np.ndarray) -> Windows:
        return lay_windows(own.recordings, config.window_us, which=which, first_event=True, duration_us=None)

    names = tuple(own.recordings.names[r] for r in held_out)
    seen = replace(pixels, sensor=own.camera)
    return OwnData(config, own.classes, windows_of(learned), windows_of(held_out), words, names, seen)


def _of_start(pixels: PixelSelection, start: Model) -> PixelSelection:
    """The selection with the sensor that the model to train on from is for."""
    check_region(pixels, start.config.sensor)
    if pixels.crop:
        return pixels
    if pixels.sensor not in (None, start.config.sensor):
        raise ValueError(f"--sensor must be the one of --start-from, {start.config.sensor}, got {pixels.sensor}")
    if pixels.mask is not None:
        pixels.mask.pixels(start.config.sensor)  # refuses a mask of another sensor
    return replace(pixels, sensor=start.config.sensor)


def _check_run(args: argparse.Namespace, config: TNTConfig, pixels: PixelSelection, run_folder: Path) -> bool:
    """Whether the folder holds this run; compared are the settings that are known before the data is."""
    from async_tnt.training.checkpoint import differing_settings

    volume = config.to_dict()
    del volume["sensor"]
    if pixels.region or pixels.camera:
        volume["sensor"] = pixels.region or pixels.camera
    settings = {
        "seed": args.seed,
        "learning_rate": args.rate,
        "precision": args.precision,
        "iterations": args.iterations,
    }
    settings |= {name: getattr(args, name) for name in ("epochs", "batch") if getattr(args, name) is not None}
    if args.patience is not None:
        settings["patience"] = args.patience or None
    differ = differing_settings(run_folder, volume, settings)
    if differ is None:
        return False
    others = other_pixels(run_folder, pixels.record)
    if others:  # the sensor is another because region or mask is: nobody gave a --sensor that could be mended
        differ = others + [name for name in differ if name != "sensor" or args.sensor]
    if differ:
        raise other_run(run_folder, ", ".join(differ))
    return True


def load_test(dataset: Path, own: OwnData, progress: Progress) -> tuple[Windows, tuple[str, ...]]:
    """The windows of DATASET/Test, of the pixels that are trained on; and what was left out of it, one line each."""
    test = read_classes(
        dataset / "Test",
        part="Test",
        pixels=own.pixels,
        classes=own.classes,
        skip_damaged=True,
        progress=progress,
        said_by="the recordings trained on are of",
    )
    _say_left_out(test, "Test/")
    windows = lay_windows(test.recordings, own.config.window_us, first_event=True, duration_us=None)
    return windows, test.left_out


def settings_of(args: argparse.Namespace, config: TNTConfig, n_windows: int, n_held_out: int) -> TrainSettings:
    """As the options say; where they are silent, enough small steps even for few windows."""
    batch = args.batch if args.batch is not None else min(64, max(8, n_windows // 32))
    steps = math.ceil(n_windows / batch) if batch > 0 else 1  # a batch of 0 is refused below
    epochs = args.epochs if args.epochs is not None else max(20, math.ceil(FEWEST_STEPS / max(steps, 1)))
    patience = args.patience
    if patience is None:
        patience = max(5, epochs // 5) if n_held_out else 0
    return TrainSettings(
        epochs=epochs,
        iterations=args.iterations,
        batch=batch,
        learning_rate=args.rate,
        seed=args.seed,
        augmentation=None if args.no_augmentation else Augmentation.for_sensor(config, translate_px=args.translate),
        precision=args.precision,
        balance=True,
        patience=patience or None,
    )


def write_beside(
    out: Path,
    scores: Scores | None,
    history: Sequence[dict[str, float]],
    summary: Mapping[str, Any],
    held_out: Sequence[str],
) -> list[Path]:
    """Write <out>.json, and <out>.confusion.png and <out>.curves.png where matplotlib is installed.

    Returns
    -------
    The files written.
    """
    from async_tnt.training.curves import plot_curves

    written = [write_numbers(out, scores, history, summary, held_out)]
    curves, confusion = (out.with_suffix(suffix) for suffix in PICTURES)
    if not plot_curves(history, curves):
        print("no pictures: matplotlib is not installed (pip install '.[plot]')", file=sys.stderr)
        return written
    written.append(curves)
    if scores is not None:
        from async_tnt.views.figure_confusion import write_confusion

        title = f"{out.stem}: {scores.accuracy:.1%} of {scores.confusion.sum()} held-out recordings right"
        written.append(write_confusion(scores.confusion, scores.classes, confusion, title))
    return written


def write_numbers(
    out: Path,
    scores: Scores | None,
    history: Sequence[dict[str, float]],
    summary: Mapping[str, Any],
    held_out: Sequence[str],
) -> Path:
    """Write <out>.json, over an older one."""
    report = {} if scores is None else scores.to_dict()
    content = {**report, "held_out": list(held_out), "summary": dict(summary), "history": list(history)}
    path = out.with_suffix(NUMBERS)
    write_text(path, json.dumps(content, indent=1))
    return path


def say_left_out(summary: Mapping[str, Any]) -> None:
    """Name the recordings that were left out once more, last of all: hours may lie between."""
    _say_lines(summary["data"]["left_out"])
    _say_lines([f"Test/{line}" for line in summary.get("test", {}).get("left_out", ())])


def _check_grid(config: TNTConfig) -> None:
    if min(config.grid) < 4:
        raise ValueError(f"--grid must be at least 4x4 for the network's two poolings, got {config.grid}")


def _say_left_out(own: OwnClasses, where: str = "") -> None:
    _say_lines([f"{where}{line}" for line in own.left_out])
    told = [
        f"{own.left_out_events[name]:,} {where}"
        for name, where in (("left_out_outside", "outside of the region"), ("left_out_masked", "of masked pixels"))
        if name in own.left_out_events
    ]
    if told:
        print(f"left out of {where.rstrip('/') or 'the recordings'}: {', '.join(told)}", file=sys.stderr)


def _say_lines(lines: Sequence[str]) -> None:
    for line in lines:
        print(f"left out: {one_line(line)}", file=sys.stderr)
