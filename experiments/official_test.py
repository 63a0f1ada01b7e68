"""Accuracy of a model on N-MNIST's official test: all of its 10,000 recordings.

    python -m experiments.official_test [--nmnist N-MNIST] [--model MODEL] [--at-hand]
                                        [--workers N] [--json FILE]

N-MNIST is the folder as it was published, with Test/<digit>/00001.bin to 10000.bin and Train. A
folder with other parts is taken as well, if the official test recording n has the number 60,000 + n
there, in Train or in Test.

If a recording is missing or cannot be read, there is no result, because an accuracy on a part is
not that of the official test. With --at-hand the recordings that are there are evaluated, and the
output and FILE say how many these are.

The model must not have seen a test recording, nor a test image of MNIST. The command cannot know
that. It says on how many recordings the model was trained. (The training of `digits` used 7,000
official test recordings, so its accuracy here would mean nothing.)

Windows and decisions are those of `async-tnt evaluate`. All recordings take a core some four
minutes.

examples:
  the official test of the bundled model that was trained on pictures alone:
    python -m experiments.official_test --nmnist N-MNIST --json official.json
  a part of it, by a model of your own, on four cores:
    python -m experiments.official_test --nmnist N-MNIST --model mine.safetensors --at-hand \\
        --workers 4
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from async_tnt import Model, load_model
from async_tnt.evaluation.job import sha256_of
from experiments.digit_data.official import N_TEST, link_recordings, missing_numbers, official_test
from experiments.digit_data.recordings import CLASSES
from experiments.scripts.options import (
    add_count,
    add_folder,
    data_folder,
    exit_with,
    script_parser,
    write_outputs,
)
from experiments.scripts.processes import command
from experiments.speed.timing import machine

N_QUICK = 20
"""Number of recordings that --quick evaluates."""

TESTED = ("accuracy", "recordings", "window_accuracy", "windows", "confusion", "window_confusion")
"""Numbers of the output of `async-tnt evaluate` that the report keeps."""


def chosen_recordings(nmnist: Path, *, at_hand: bool, quick: bool) -> dict[int, Path]:
    """The recordings to evaluate: official number -> file.

    Parameters
    ----------
    at_hand : whether some of the official test recordings may be missing.
    quick : whether the first `N_QUICK` are enough.

    Raises
    ------
    ValueError, OSError : see `official_test`; a recording is missing.
    """
    files = official_test(nmnist)
    if quick:
        return {number: files[number] for number in sorted(files)[:N_QUICK]}
    missing = missing_numbers(files)
    if missing and not at_hand:
        raise FileNotFoundError(
            f"{nmnist}: {len(missing):,} of the {N_TEST:,} official test recordings are missing "
            f"(the first is number {missing[0]}), so this is not the official test; to evaluate "
            f"the {len(files):,} at hand, give --at-hand"
        )
    return files


def measure(
    name_or_path: str, model: Model, files: dict[int, Path], workers: int
) -> dict[str, Any]:
    """The report: accuracies on these recordings, and how many of the official test they are.

    Parameters
    ----------
    name_or_path, model : the model, and where `load_model` found it.
    files : official number -> recording.
    workers : number of processes.

    Raises
    ------
    ValueError : a recording cannot be evaluated.
    """
    with TemporaryDirectory() as folder:
        link_recordings(files, Path(folder))
        report = command("evaluate", name_or_path, folder, "--workers", workers, "--json")
    if report["skipped"] or report["recordings"] != len(files):
        reason = report["skipped"][0] if report["skipped"] else "recordings are missing"
        raise ValueError(
            f"{report['recordings']:,} of {len(files):,} recordings were evaluated: {reason}"
        )
    return {
        "model": Path(name_or_path).name,
        "model_sha256": sha256_of(model),
        "trained_on_recordings": trained_on_recordings(model),
        "official_test_recordings": len(files),
        "of": N_TEST,
        **{name: report[name] for name in TESTED},
        "machine": machine("torch"),
    }


def trained_on_recordings(model: Model) -> int | None:
    """The number of real recordings that the model was trained on; None if it does not say it."""
    data = model.record.get("data", {})
    number = data.get("real_recordings") if isinstance(data, dict) else None
    return number if isinstance(number, int) else None


def lines_of(report: dict[str, Any]) -> list[str]:
    """The report as lines of text."""
    n = report["official_test_recordings"]
    is_whole = n == report["of"]
    part = "N-MNIST's official test" if is_whole else "NOT the official test, but a part of it"
    lines = [
        f"{part}: {n:,} of {report['of']:,} recordings",
        f"{report['model']}: {report['accuracy']:.4f} of the recordings are right, and "
        f"{report['window_accuracy']:.4f} of their {report['windows']:,} windows",
    ]
    n_trained = report["trained_on_recordings"]
    if n_trained is None:
        lines.append("The model does not say what it was trained on.")
    elif n_trained:
        lines.append(
            f"It was trained on {n_trained:,} recordings, which must not be among those tested."
        )
    else:
        lines.append("It was trained on no recording.")
    return lines


def main(argv: list[str] | None = None) -> int:
    """Evaluate the model, write the report, and print it."""
    parser = script_parser("official_test", __doc__, f"{N_QUICK} of the recordings at hand")
    add_folder(parser, "--nmnist", "N-MNIST (default: $TNT_DATA/nmnist)")
    parser.add_argument(
        "--model",
        default="digits-from-pictures",
        help="a bundled model, or a file (default: %(default)s)",
    )
    parser.add_argument(
        "--at-hand",
        action="store_true",
        help="evaluate the official test recordings that are there, if some are missing",
    )
    add_count(parser, "--workers", 1, "processes")
    args = parser.parse_args(argv)
    files = chosen_recordings(
        data_folder(args.nmnist, "nmnist", "--nmnist"), at_hand=args.at_hand, quick=args.quick
    )
    model = load_model(args.model)
    if model.classes != CLASSES or model.places is not None:
        raise ValueError(f"{args.model}: not a classifier of the digits 0 to 9")
    report = measure(args.model, model, files, args.workers)
    write_outputs(args, report)
    print(*lines_of(report), sep="\n")
    return 0


if __name__ == "__main__":
    exit_with(main)
