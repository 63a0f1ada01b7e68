"""`async-tnt train`: train a classifier on one's own classes, or on N-MNIST's recordings, simulated ones, or both."""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numba
import numpy as np

from async_tnt.archive.scores import Scores
from async_tnt.cli.output import complain, one_line
from async_tnt.cli.record import command_words, data_folder
from async_tnt.cli.train_options import add_arguments
from async_tnt.config import TNTConfig
from async_tnt.files import check_folder, check_writable
from async_tnt.networks.model import load_model
from async_tnt.training import dataset_run as own_run
from async_tnt.training.augment import Augmentation
from async_tnt.training.run_folder import BEST, CURVES, LAST, RUN_FILES
from async_tnt.training.settings import TrainSettings
from async_tnt.training.simulated import read_samples, simulate_recordings
from async_tnt.training.windows import (
    CLASSES,
    Recordings,
    Windows,
    lay_windows,
    no_progress,
    read_folder,
    split_recordings,
)

__all__ = ["add_arguments", "main"]

TIMES_MS = tuple(float(ms) for ms in range(10, 101, 10))


def main(args: argparse.Namespace) -> int:
    """Train as `args` say. Returns the exit code: 0, 2 for bad usage or input, 130 when interrupted."""
    try:
        import torch  # noqa: F401
        from tnt_reference import Classifier  # noqa: F401
    except ImportError as error:
        return _fail(f"training needs torch ({error}); install it with: pip install '.[train]'")
    args.out = args.out or Path("smoke.safetensors" if args.smoke else "model.safetensors")
    run_folder = args.run_folder or Path("runs") / args.out.stem
    try:
        check_writable(args.out, (".safetensors",))  # q.pt beside q.safetensors would share its run folder, its q.json
        for suffix in own_run.BESIDE if args.dataset is not None else ():
            check_writable(args.out.with_suffix(suffix))
        check_folder(run_folder, RUN_FILES)
        return _train(args, run_folder)
    except KeyboardInterrupt:
        complain(f"interrupted; the finished epochs are kept in {run_folder}. Give the same command again to go on.")
        return 130
    except (ValueError, TypeError, OSError) as error:
        return _fail(error)


def _train(args: argparse.Namespace, run_folder: Path) -> int:
    import torch

    from async_tnt.training.checkpoint import check_run
    from async_tnt.training.curves import plot_curves
    from async_tnt.training.evaluate import evaluate
    from async_tnt.training.networks import pipeline_of
    from async_tnt.training.train import train

    own_run.check_options(args)
    if args.threads is not None:
        torch.set_num_threads(args.threads)
    start = load_model(args.start_from) if args.start_from else None
    config = (
        start.config
        if start is not None
        else TNTConfig(
            bins=args.bins,
            t_max=args.t_max,
            landmark=args.landmark,
            polarity=args.polarity,
            transform=args.transform,
            remove_flow=args.remove_flow,
        )
    )
    own: own_run.OwnData | None = None
    test_folder = None
    if args.dataset is not None:
        if args.test and not (args.dataset / "Test").is_dir():
            raise FileNotFoundError(f"--test needs a folder Test, not found in {args.dataset}")
        own = own_run.load(args, config, start, show_progress, run_folder)
        config, training, validation, data = own.config, own.training, own.validation, own.words
        settings = own_run.settings_of(args, config, len(training), len(validation))
        if args.test:  # read now: what is wrong with it must not show after hours
            test, test_left_out = own_run.load_test(args.dataset, own, show_progress)
    else:
        settings = _settings(args)
        check_run(run_folder, config.to_dict(), asdict(settings))
        rather = "DATASET, a folder with a folder of recordings for each class, or "
        nmnist = None if args.smoke else data_folder(args.nmnist, "nmnist", "--nmnist", rather=rather)
        if args.test:
            if nmnist is None or not (nmnist / "Test").is_dir():
                raise FileNotFoundError(f"--test needs N-MNIST's folder Test, not found in {nmnist}")
            test_folder = nmnist / "Test"
        training, validation, data = _load(args, nmnist, config)
    classes = CLASSES if own is None else own.classes
    print(f"{len(training)} windows to train on, {len(validation)} held out", file=sys.stderr)

    n_epochs = settings.n_epochs(len(training))
    warm: tuple[float, float] | None = None  # the first epoch here, which waits for the compiler, and its end
    said_at = -1.0

    def report(row: dict[str, float]) -> None:
        nonlocal said_at, warm
        warm = warm or (row["epoch"], time.monotonic())
        if row["epoch"] < n_epochs and 0 <= said_at > time.monotonic() - 1.0:
            return  # hundreds of short epochs need no line each
        said_at = time.monotonic()
        done = row["epoch"] - warm[0]
        text = f"epoch {row['epoch']:.0f}/{n_epochs}  loss {row['loss']:.4f}"
        if "per_window" in row:
            text += f"  held out: {row['per_window']:.4f} by window, {row['per_recording']:.4f} by recording"
        if done:
            left_s = (time.monotonic() - warm[1]) / done * (n_epochs - row["epoch"])
            text += f"  ({_minutes(left_s)} left)"
        print(text, file=sys.stderr)

    result = train(
        config,
        training,
        validation,
        settings,
        run_folder,
        classes=classes,
        start=start,
        progress=show_progress,
        report=report,
    )
    keep = args.keep or ("last" if settings.patience is None else "best")
    model = result.best if keep == "best" else result.last
    n_trained = len(result.history)
    if n_trained < n_epochs:
        print(
            f"stopped: no lower validation loss for {settings.patience} epochs; the best was epoch {result.best_epoch}",
            file=sys.stderr,
        )
    summary: dict[str, Any] = {
        "data": data,
        "command": _command(args),
        "seed": args.seed,
        "epochs": n_trained,
        "iterations": int(result.history[-1]["iterations"]),
        "kept": f"epoch {result.best_epoch if keep == 'best' else n_trained}",
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "numba": numba.__version__,
            "torch": torch.__version__,
        },
    }
    if start is not None:
        summary["started_from"] = {
            name: start.record[name]
            for name in ("command", "data", "epochs", "seed", "validation", "test", "started_from")
            if name in start.record
        }
    pipeline = pipeline_of(model)
    scores = None
    times_ms = TIMES_MS if own is None else tuple(config.window_us * k / 1e4 for k in range(1, 11))
    if len(validation):
        print("evaluating on the held-out recordings", file=sys.stderr)
        found = evaluate(pipeline, validation, times_ms=times_ms)
        summary["validation"] = found.to_dict()
        scores = Scores(classes, found.recording_confusion, found.confusion)
    result.last.save(run_folder / LAST)
    result.best.save(run_folder / BEST)
    plot_curves(result.history, run_folder / CURVES)

    def save() -> None:
        type(model)(config, model.weights, model.classes, summary).save(args.out)

    save()  # and once more with the accuracy on Test, which may take long, or fail
    written = [args.out]
    if own is not None:
        written += own_run.write_beside(args.out, scores, result.history, summary, own.held_out)
        if args.test:
            print("evaluating on Test", file=sys.stderr)
            found = evaluate(pipeline, test, times_ms=times_ms)
            summary["test"] = {**found.to_dict(), "left_out": list(test_left_out)}
            own_run.write_numbers(args.out, scores, result.history, summary, own.held_out)
            save()
        own_run.say_left_out(summary)
    if test_folder is not None:
        recordings = read_folder(test_folder, skip_damaged=args.skip_damaged, progress=show_progress)
        print("evaluating on Test", file=sys.stderr)
        for name, first_event in (("test", False), ("test_windows_from_first_event", True)):
            windows = lay_windows(recordings, config.window_us, first_event=first_event)
            summary[name] = evaluate(pipeline, windows, times_ms=TIMES_MS).to_dict()
        save()
    _print_summary(summary, args, written)
    return 0


def _command(args: argparse.Namespace) -> str:
    """As it was given, without paths; a mask decides what is learned, so it is told that there was one."""
    words = command_words("async-tnt train", args, add_arguments, leave_out=("json", "skip_damaged"))
    return words if args.mask is None else f"{words} --mask MASK"


def _settings(args: argparse.Namespace) -> TrainSettings:
    epochs = 20 if args.epochs is None else args.epochs
    return TrainSettings(
        epochs=min(epochs, 2) if args.smoke else epochs,
        iterations=None if args.smoke else args.iterations,
        batch=64 if args.batch is None else args.batch,
        learning_rate=args.rate,
        seed=args.seed,
        augmentation=None if args.no_augmentation else Augmentation(translate_px=args.translate),
        precision=args.precision,
        patience=args.patience or None,
    )


def _load(args: argparse.Namespace, nmnist: Path | None, config: TNTConfig) -> tuple[Windows, Windows, dict[str, Any]]:
    """Windows to train on, windows held out, and the data in words."""
    if nmnist is None:
        windows = lay_windows(read_samples(), config.window_us)
        return windows, windows, {"source": "the ten bundled samples, for training and validation (smoke)"}
    mnist = data_folder(args.mnist, "mnist", "--mnist") if args.simulated else None
    train_folder = nmnist / "Train"
    if not train_folder.is_dir():
        raise FileNotFoundError(
            f"no folder Train in {nmnist}; --nmnist must be the folder with N-MNIST's Train/<digit>/*.bin"
        )
    real = read_folder(train_folder, skip_damaged=args.skip_damaged, progress=show_progress)
    share = 0.1 if args.validation is None else args.validation
    learned, held_out = split_recordings(real, share, np.random.default_rng(args.seed))
    recordings: Recordings = real
    if mnist is not None:
        recordings = real + simulate_recordings(mnist, args.simulated, args.seed, progress=show_progress)
        learned = np.concatenate([learned, np.arange(len(real), len(recordings))])
    data = {
        "source": "N-MNIST recordings (Train), held out by recording"
        + (" and simulated recordings of MNIST training images" if mnist else ""),
        "real_recordings": len(real) - len(held_out),
        "simulated_recordings": len(recordings) - len(real),
        "held_out_recordings": len(held_out),
    }
    if args.saccades != [1, 2, 3]:
        data["saccades"] = args.saccades

    def windows_of(which: np.ndarray) -> Windows:
        windows = lay_windows(recordings, config.window_us, which=which)
        return windows[np.isin(windows.start_us // config.window_us + 1, args.saccades)]

    return windows_of(learned), windows_of(held_out), data


def _print_summary(summary: dict[str, Any], args: argparse.Namespace, written: list[Path]) -> None:
    if args.json:
        print(json.dumps({"out": str(args.out), **summary}))
        return
    for name, title in (
        ("validation", "held out"),
        ("test", "Test"),
        ("test_windows_from_first_event", "Test, windows from the first event"),
    ):
        if name in summary:
            found = summary[name]
            print(
                f"{title}: {found['per_window']:.4f} of {found['windows']} windows, "
                f"{found['per_recording']:.4f} of {found['recordings']} recordings right"
            )
    print(one_line(f"wrote {', '.join(map(str, written))}"))


def show_progress(items: Iterable[Any], title: str, total: int) -> Iterator[Any]:
    """A progress bar with the time left, on stderr where that is a terminal and tqdm is installed."""
    try:
        from tqdm import tqdm
    except ImportError:
        return no_progress(items, title, total)
    return iter(tqdm(items, desc=title, total=total, disable=None, leave=False, file=sys.stderr))


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def _fail(error: Exception | str) -> int:
    complain(error)
    return 2
