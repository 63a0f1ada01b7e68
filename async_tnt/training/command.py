"""`async-tnt train`: train a classifier on N-MNIST's recordings, simulated ones, or both."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np

from async_tnt.config import LANDMARKS, POLARITIES, TRANSFORMS, TNTConfig
from async_tnt.model import load_model

from .augment import Augmentation
from .simulated import read_samples, simulate_recordings
from .windows import Recordings, Windows, lay_windows, no_progress, read_folder, split_recordings

TIMES_MS = tuple(float(ms) for ms in range(10, 101, 10))

DESCRIPTION = """\
Train the thesis' classifier (two convolutions, two fully connected layers) on volumes of events.

Recordings are read from the folder of N-MNIST and, with --simulated, made from MNIST's images. Each epoch
sees every window a little moved, turned and thinned, so that no two epochs are alike. A share of the real
recordings is held out and only looked at, after each epoch. Checkpoints go into the run folder: stop with
Ctrl-C, give the same command again, and the training goes on to the very same weights.
"""
EPILOG = """\
examples:
  async-tnt train --smoke                          does everything work here? seconds, no data needed
  async-tnt train --nmnist N-MNIST --out mine.safetensors
  async-tnt train --nmnist N-MNIST --mnist MNIST --simulated 20000 --landmark line --t-max 2 --epochs 40
  async-tnt run --model mine.safetensors my.bin     use it
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `async-tnt train` to its parser."""
    parser.description, parser.epilog = DESCRIPTION, EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    data = parser.add_argument_group("data")
    data.add_argument(
        "--nmnist",
        type=Path,
        metavar="FOLDER",
        help="N-MNIST: the folder with Train/<digit>/*.bin (default: $TNT_DATA/nmnist)",
    )
    data.add_argument(
        "--mnist",
        type=Path,
        metavar="FOLDER",
        help="MNIST's IDX files, gzipped or not, for --simulated (default: $TNT_DATA/mnist)",
    )
    data.add_argument(
        "--simulated",
        type=int,
        default=0,
        metavar="N",
        help="add N simulated recordings of other MNIST images (default: 0; about 5 ms each)",
    )
    data.add_argument(
        "--validation",
        type=float,
        default=0.1,
        metavar="SHARE",
        help="share of the real recordings held out to watch the training (default: 0.1)",
    )
    data.add_argument(
        "--skip-damaged",
        action="store_true",
        help="leave damaged recordings out, with a warning each, instead of stopping",
    )
    data.add_argument(
        "--test",
        action="store_true",
        help="at the end, also classify N-MNIST's Test folder and write the accuracy into the "
        "model's record; do this once, after all choices are made",
    )
    volume = parser.add_argument_group("volume (what the network sees)")
    volume.add_argument(
        "--transform", choices=TRANSFORMS, default="tnt", help="tnt, or none: the plain event volume (default: tnt)"
    )
    volume.add_argument(
        "--landmark",
        choices=LANDMARKS,
        default="running",
        help="the point events are normalized about; `window` costs a replay at each decision (default: running)",
    )
    volume.add_argument(
        "--t-max",
        type=float,
        default=3.0,
        metavar="T",
        help="TNT time at the window's end: smaller shrinks late events less, but loses more "
        "of the early ones over the border (default: 3)",
    )
    volume.add_argument(
        "--polarity",
        choices=POLARITIES,
        default="signed",
        help="ON minus OFF events, both alike, or in bins of their own (default: signed)",
    )
    volume.add_argument("--remove-flow", action="store_true", help="subtract the fitted flow (with --landmark line)")
    volume.add_argument("--bins", type=int, default=9, metavar="B", help="time bins (default: 9)")
    learning = parser.add_argument_group("training")
    learning.add_argument(
        "--epochs", type=int, default=20, metavar="N", help="passes over the training windows (default: 20)"
    )
    learning.add_argument("--batch", type=int, default=64, metavar="N", help="windows per step (default: 64)")
    learning.add_argument(
        "--rate",
        type=float,
        default=2e-3,
        metavar="R",
        help="highest learning rate of AdamW; it falls along a cosine (default: 0.002)",
    )
    learning.add_argument(
        "--seed",
        type=int,
        default=0,
        metavar="N",
        help="of weights, order, augmentation, split and simulation (default: 0)",
    )
    learning.add_argument("--no-augmentation", action="store_true", help="train on the windows as they are")
    learning.add_argument(
        "--keep",
        choices=("last", "best"),
        default="last",
        help="the weights to write: after the last epoch, or after the one that validates "
        "best (default: last; both are in the run folder)",
    )
    learning.add_argument(
        "--threads", type=int, metavar="N", help="torch's threads; another number gives slightly other weights"
    )
    learning.add_argument(
        "--smoke", action="store_true", help="try the whole way in seconds: two epochs on the ten bundled samples"
    )
    files = parser.add_argument_group("files")
    files.add_argument(
        "--start-from",
        metavar="MODEL",
        help="train on from a model file, or a bundled model's name, instead of random weights; "
        "the volume's options are then that model's. Keep --seed, and with it the recordings "
        "that are held out",
    )
    files.add_argument(
        "--out",
        type=Path,
        default=Path("model.safetensors"),
        metavar="FILE",
        help="the trained model (default: model.safetensors)",
    )
    files.add_argument(
        "--run",
        type=Path,
        metavar="FOLDER",
        dest="run_folder",
        help="checkpoints and learning curves (default: runs/<name of --out>)",
    )
    files.add_argument("--json", action="store_true", help="print the results as JSON on stdout")


def main(args: argparse.Namespace) -> int:
    """Train as `args` say. Returns the exit code: 0, 2 for bad usage or input, 130 when interrupted."""
    try:
        import torch  # noqa: F401
        from tnt_reference import Classifier  # noqa: F401
    except ImportError as error:
        return _fail(f"training needs torch ({error}); install it with: pip install 'async-tnt[train]'")
    run_folder = args.run_folder or Path("runs") / args.out.stem
    try:
        return _train(args, run_folder)
    except KeyboardInterrupt:
        print(
            f"\ninterrupted; the finished epochs are kept in {run_folder}. Give the same command again to go on.",
            file=sys.stderr,
        )
        return 130
    except (ValueError, TypeError, OSError) as error:
        return _fail(str(error))


def _train(args: argparse.Namespace, run_folder: Path) -> int:
    import torch

    from .curves import plot_curves
    from .evaluate import evaluate
    from .networks import network_of
    from .train import TrainSettings, train

    if args.threads is not None:
        torch.set_num_threads(args.threads)
    start = load_model(args.start_from) if args.start_from else None
    config = start.config if start is not None else TNTConfig(
        bins=args.bins, t_max=args.t_max, landmark=args.landmark, polarity=args.polarity,
        transform=args.transform, remove_flow=args.remove_flow,
    )  # fmt: skip
    settings = TrainSettings(
        epochs=min(args.epochs, 2) if args.smoke else args.epochs,
        batch=args.batch,
        learning_rate=args.rate,
        seed=args.seed,
        augmentation=None if args.no_augmentation else Augmentation(),
    )
    if not args.out.parent.is_dir():
        raise FileNotFoundError(f"no folder {args.out.parent} to write {args.out.name} to")
    nmnist = None if args.smoke else _folder(args.nmnist, "nmnist", "--nmnist")
    test_folder = None
    if args.test:
        if nmnist is None or not (nmnist / "Test").is_dir():
            raise FileNotFoundError(f"--test needs N-MNIST's folder Test, not found in {nmnist}")
        test_folder = nmnist / "Test"
    training, validation, data = _load(args, nmnist, config)
    print(f"{len(training)} windows to train on, {len(validation)} held out", file=sys.stderr)

    started = time.monotonic()
    first_epoch: list[float] = []

    def report(row: dict[str, float]) -> None:
        if not first_epoch:
            first_epoch.append(row["epoch"])
        done = row["epoch"] - first_epoch[0] + 1
        left_s = (time.monotonic() - started) / done * (settings.epochs - row["epoch"])
        text = f"epoch {row['epoch']:.0f}/{settings.epochs}  loss {row['loss']:.4f}"
        if "per_window" in row:
            text += f"  held out: {row['per_window']:.4f} by window, {row['per_recording']:.4f} by recording"
        print(f"{text}  ({_minutes(left_s)} left)", file=sys.stderr)

    result = train(
        config, training, validation, settings, run_folder, start=start, progress=show_progress, report=report
    )
    model = result.best if args.keep == "best" else result.last
    summary: dict[str, Any] = {
        "data": data,
        "command": _command(args),
        "seed": args.seed,
        "epochs": settings.epochs,
        "kept": f"epoch {result.best_epoch if args.keep == 'best' else settings.epochs}",
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "numba": numba.__version__,
            "torch": torch.__version__,
        },
    }
    if start is not None:
        summary["started_from"] = {
            name: start.record[name] for name in ("command", "data", "epochs", "seed", "validation", "test",
                                                  "started_from") if name in start.record
        }  # fmt: skip
    network = network_of(model)
    if len(validation):
        print("evaluating on the held-out recordings", file=sys.stderr)
        summary["validation"] = evaluate(network, config, validation, times_ms=TIMES_MS).to_dict()
    if test_folder is not None:
        recordings = read_folder(test_folder, skip_damaged=args.skip_damaged, progress=show_progress)
        print("evaluating on Test", file=sys.stderr)
        for name, first_event in (("test", False), ("test_windows_from_first_event", True)):
            windows = lay_windows(recordings, config.window_us, first_event=first_event)
            summary[name] = evaluate(network, config, windows, times_ms=TIMES_MS).to_dict()
    for name, one in (("last", result.last), ("best", result.best)):
        one.save(run_folder / f"{name}.safetensors")
    type(model)(config, model.weights, model.classes, summary).save(args.out)
    plot_curves(result.history, run_folder / "curves.png")
    _print_summary(summary, args)
    return 0


def _load(args: argparse.Namespace, nmnist: Path | None, config: TNTConfig) -> tuple[Windows, Windows, dict[str, Any]]:
    """Windows to train on, windows held out, and the data in words."""
    if nmnist is None:
        windows = lay_windows(read_samples(), config.window_us)
        return windows, windows, {"source": "the ten bundled samples, for training and validation (smoke)"}
    mnist = _folder(args.mnist, "mnist", "--mnist") if args.simulated else None
    train_folder = nmnist / "Train"
    if not train_folder.is_dir():
        raise FileNotFoundError(
            f"no folder Train in {nmnist}; --nmnist must be the folder with N-MNIST's Train/<digit>/*.bin"
        )
    real = read_folder(train_folder, skip_damaged=args.skip_damaged, progress=show_progress)
    learned, held_out = split_recordings(real, args.validation, np.random.default_rng(args.seed))
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
    return (
        lay_windows(recordings, config.window_us, which=learned),
        lay_windows(recordings, config.window_us, which=held_out),
        data,
    )


def _folder(given: Path | None, name: str, option: str) -> Path:
    """A data folder: as given, or in $TNT_DATA."""
    folder = given
    if folder is None:
        root = os.environ.get("TNT_DATA")
        if not root:
            raise FileNotFoundError(f"no data: give {option} FOLDER, or set TNT_DATA to the folder with {name}/")
        folder = Path(root) / name
    if not folder.is_dir():
        raise FileNotFoundError(f"no folder {folder}; give {option} FOLDER, or set TNT_DATA")
    return folder


def _command(args: argparse.Namespace) -> str:
    """The command that trains this again, without the folders, which differ from machine to machine."""
    parser = argparse.ArgumentParser(add_help=False)
    add_arguments(parser)
    words = ["async-tnt train"]
    for action in parser._actions:
        value = getattr(args, action.dest)
        if action.type is Path or value == action.default or action.dest in ("json", "skip_damaged"):
            continue
        if action.dest == "start_from":
            value = Path(value).name
        words.append(action.option_strings[0] if value is True else f"{action.option_strings[0]} {value}")
    return " ".join(words)


def _print_summary(summary: dict[str, Any], args: argparse.Namespace) -> None:
    if args.json:
        print(json.dumps({"out": str(args.out), **summary}))
        return
    for name, title in (("validation", "held out"), ("test", "Test"),
                        ("test_windows_from_first_event", "Test, windows from the first event")):  # fmt: skip
        if name in summary:
            found = summary[name]
            print(
                f"{title}: {found['per_window']:.4f} of {found['windows']} windows, "
                f"{found['per_recording']:.4f} of {found['recordings']} recordings right"
            )
    print(f"wrote {args.out}")


def show_progress(items: Iterable[Any], title: str, total: int) -> Iterator[Any]:
    """A progress bar with the time left, on stderr where that is a terminal and tqdm is installed."""
    try:
        from tqdm import tqdm
    except ImportError:
        return no_progress(items, title, total)
    return iter(tqdm(items, desc=title, total=total, disable=None, leave=False, file=sys.stderr))


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def _fail(text: str) -> int:
    print(f"async-tnt train: {text}", file=sys.stderr)
    return 2
