"""From the options of `async-tnt train` to the windows to train on, the settings, and what a run is compared by."""

from __future__ import annotations

import argparse
import zlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from async_tnt.cli.data_options import data_folder
from async_tnt.cli.options import size_of
from async_tnt.cli.output import note
from async_tnt.cli.pixel_options import selection_of
from async_tnt.cli.train_choice import Choice, questions_of
from async_tnt.cli.train_options import LANDMARK, NETWORK, T_MAX
from async_tnt.config import TNTConfig
from async_tnt.networks.model import Model
from async_tnt.progress import progress
from async_tnt.sources.labelled_recordings import has_part
from async_tnt.sources.pixel_selection import PixelSelection, PixelSelector
from async_tnt.sources.sensor import format_size
from async_tnt.training.augment import Augmentation
from async_tnt.training.choice import Candidate
from async_tnt.training.data import TrainingData, dataset_data, nmnist_data, sample_data
from async_tnt.training.dataset import file_sizes
from async_tnt.training.groups import GROUPS_FILE, check_share, groups_by_pattern, groups_table
from async_tnt.training.run_folder import check_run, has_checkpoint, network_checksum, other_run
from async_tnt.training.settings import TrainSettings, settings_for


def config_of(args: argparse.Namespace) -> TNTConfig:
    """The volume that the options describe; its sensor is replaced by that of the recordings."""
    names = ("bins", "polarity", "transform", "remove_flow")
    config = TNTConfig(
        **{name: getattr(args, name) for name in names},
        landmark=args.landmark or LANDMARK,
        t_max=T_MAX if args.t_max is None else args.t_max,
        representation=args.representation or "volume",
    )
    grid = size_of(args.grid) if args.grid else config.grid
    return config.replace(grid=grid, window_us=args.window_us or config.window_us)


def of_dataset(
    args: argparse.Namespace, config: TNTConfig, start: Model | None, run_folder: Path
) -> tuple[TrainingData, TrainSettings, dict[str, Any]]:
    """DATASET, how to train on it, and what `check_run` compares; checks the run folder before reading the data."""
    if args.test and not has_part(args.dataset, "Test"):
        raise FileNotFoundError(f"--test needs {args.dataset}/Test, or a list trials_to_test.txt; found neither")
    parts = [args.dataset / part for part in ("Train", "Test") if (args.dataset / part).is_dir()] or [args.dataset]
    if any(run_folder.resolve().is_relative_to(part.resolve()) for part in parts):
        raise ValueError(f"--run must lie outside of {parts[0]}, in which a folder is a class; got {run_folder}")
    pixels = _pixels_of(args, start)
    validation = 0.2 if args.validation is None else args.validation
    augmentation = _augmentation(args)
    given = {"seed": args.seed, "learning_rate": args.rate, "precision": args.precision}
    given |= {"iterations": args.iterations, "network": args.network or NETWORK}
    questions = questions_of(args)
    known = given | {name: getattr(args, name) for name in ("epochs", "batch") if getattr(args, name) is not None}
    if args.patience is not None:
        known["patience"] = args.patience or None
    TrainSettings(**known), Augmentation(**augmentation or {})  # these refuse what cannot be before the data is read
    check_share(validation)
    groups_by_pattern((), args.groups or "")
    sources: dict[str, Any] = {
        "recordings": file_sizes(args.dataset, "Train"),
        "validation": validation,
        "groups": args.groups or _groups_file(args.dataset),
        "pixels": pixels.about,
    }
    choice = None
    if questions:
        depends_on: dict[str, Any] = {"settings": known, "volume": config.to_dict(), "augmentation": augmentation}
        depends_on |= {"questions": asdict(questions), "window_us": args.window_us, "sensor": args.sensor}
        depends_on |= {**sources, "recordings": None}
        if ":" in given["network"]:
            depends_on["network_file"] = network_checksum(given["network"])
        choice = Choice(run_folder, depends_on, sources["recordings"])
        if choice.chosen is not None:
            config, known["network"] = choice.chosen.config, choice.chosen.network
        elif has_checkpoint(run_folder):
            check_run(run_folder, {}, {}, sources)  # names recordings that differ
            raise other_run(run_folder, "options")
    volume = {name: value for name, value in config.to_dict().items() if name != "sensor"}
    if pixels.sensor is not None and not pixels.crop:
        volume["sensor"] = pixels.sensor
    if args.window_us is None and start is None:
        del volume["window_us"]
    check_run(run_folder, volume, known, sources)
    data = dataset_data(
        args.dataset,
        config,
        pixels=pixels,
        sensor_source="`sensor`" if args.sensor else "--mask" if args.mask else "--start-from",
        classes=None if start is None else start.classes,
        validation=validation,
        groups=args.groups,
        fit_window=args.window_us is None and start is None,
        test=args.test,
        seed=args.seed,
        store=run_folder,
        progress=progress,
    )
    for line in (*(f"left out: {line}" for line in data.left_out), *data.notes):
        note(line)

    def settings_of(candidate: Candidate, steps: int | None = None) -> TrainSettings:
        return settings_for(
            candidate.config,
            len(data.training),
            len(data.validation),
            epochs=args.epochs,
            batch=args.batch,
            patience=args.patience if steps is None else 0,
            augmentation=None if augmentation is None else {**augmentation, "mirror": candidate.mirror},
            resynthesized=args.motions == "resynthesized",
            **given | {"iterations": steps or args.iterations, "network": candidate.network},
        )

    candidate = Candidate(data.config, given["network"], bool(args.mirror))
    if choice is not None:
        candidate = choice.chosen or choice.make(data, candidate, questions, settings_of)
        data = replace(data, config=candidate.config, record={**data.record, "choice": choice.trials})
    return data, settings_of(candidate), {**sources, "used": list(data.training.recordings.names)}


def of_digits(
    args: argparse.Namespace, config: TNTConfig, start: Model | None, run_folder: Path
) -> tuple[TrainingData, TrainSettings, dict[str, Any]]:
    """N-MNIST or the bundled samples, in the same way."""
    epochs = 20 if args.epochs is None else args.epochs
    changes = _augmentation(args)
    settings = TrainSettings(
        epochs=min(epochs, 2) if args.smoke else epochs,
        iterations=None if args.smoke else args.iterations,
        batch=64 if args.batch is None else args.batch,
        learning_rate=args.rate,
        seed=args.seed,
        augmentation=None if changes is None else Augmentation(**changes),
        precision=args.precision,
        patience=args.patience or None,
        network=args.network or NETWORK,
    )
    check_run(run_folder, config.to_dict(), asdict(settings))
    if args.smoke:
        return sample_data(config), settings, {}
    alternative = "DATASET, a folder with a folder of recordings for each class, or "
    nmnist = data_folder(args.nmnist, "nmnist", "--nmnist", alternative=alternative)
    data = nmnist_data(
        nmnist,
        config,
        mnist=data_folder(args.mnist, "mnist", "--mnist") if args.simulated else None,
        simulated=args.simulated,
        saccades=args.saccades,
        validation=0.1 if args.validation is None else args.validation,
        test=args.test,
        seed=args.seed,
        skip_damaged=args.skip_damaged,
        progress=progress,
    )
    return data, settings, {}


def _groups_file(dataset: Path) -> str | None:
    """The data set's table of groups, by its checksum."""
    table = groups_table(dataset)
    return None if table is None else f"{GROUPS_FILE} {zlib.crc32(table.read_bytes()):08x}"


def _augmentation(args: argparse.Namespace) -> dict[str, Any] | None:
    """The options' fields of `Augmentation`."""
    if args.no_augmentation:
        return None
    given = {"translate_px": args.translate, "partial": args.partial, "nothing": args.nothing, "mirror": args.mirror}
    return {name: value for name, value in given.items() if value is not None}


def _pixels_of(args: argparse.Namespace, start: Model | None) -> PixelSelection:
    """Which pixels of DATASET to train on; refuses others than those of `start`, a model to continue from."""
    pixels = selection_of(args)
    if pixels.region is not None and min(pixels.region) < 2:
        raise ValueError(
            "--roi with --crop: the region is the model's sensor and must have sides of at least 2 pixels, "
            f"got {format_size(pixels.region)}"
        )
    if start is None:
        return pixels
    sensor = start.config.sensor
    if not pixels.crop and pixels.sensor not in (None, sensor):
        raise ValueError(
            f"--sensor must be that of --start-from, {format_size(sensor)}, got {format_size(pixels.sensor)}"
        )
    PixelSelector(pixels, sensor)  # refuses a region or a mask that does not fit the model
    return pixels if pixels.crop else replace(pixels, sensor=sensor)
