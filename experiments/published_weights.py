"""Accuracy of the NIR paper's CNNs for N-MNIST, from their weights, beside the published numbers.

    python -m experiments.published_weights WEIGHTS ... [--nmnist N-MNIST] [--quick] [--json FILE]

WEIGHTS are files that `examples/nir_cnn.py` converts, which also says what windows are, and how
recordings are decided. N-MNIST is a folder of either layout that `experiments.official_test` takes.
Evaluated are the official test recordings that are there, and the output says how many these are.

FILE keeps the results of other files of weights. All recordings take a core some 20 seconds a file.
"""

from __future__ import annotations

import hashlib
import runpy
from pathlib import Path
from typing import Any

from experiments.digit_data.official import N_TEST, official_test
from experiments.records.run import ROOT
from experiments.scripts.options import (
    add_folder,
    data_folder,
    exit_with,
    script_parser,
    write_part,
)
from experiments.speed.timing import machine

N_QUICK = 20
"""Number of recordings that --quick evaluates."""

EXAMPLE = ROOT / "examples" / "nir_cnn.py"
"""The program whose functions are called here."""


def measure(weights: Path, files: dict[int, Path]) -> dict[str, Any]:
    """The report of one file of weights.

    files : official number -> recording.
    """
    example = runpy.run_path(str(EXAMPLE))
    model, published = example["convert"](weights)
    counts = example["count_right"](model, files.values())
    return {
        "weights_sha256": hashlib.sha256(weights.read_bytes()).hexdigest(),
        "published": published,
        "official_test_recordings": len(files),
        "of": N_TEST,
        **counts,
        "window_accuracy": counts["windows_right"] / counts["windows"],
        "accuracy": counts["recordings_right"] / counts["recordings"],
    }


def main(argv: list[str] | None = None) -> int:
    """Evaluate the networks, and write and print what is right of each."""
    parser = script_parser("published_weights", __doc__, f"{N_QUICK} recordings")
    parser.add_argument("weights", nargs="+", type=Path, metavar="WEIGHTS")
    add_folder(parser, "--nmnist", "N-MNIST (default: $TNT_DATA/nmnist)")
    args = parser.parse_args(argv)
    files = official_test(data_folder(args.nmnist, "nmnist", "--nmnist"))
    if args.quick:
        files = {number: files[number] for number in sorted(files)[:N_QUICK]}
    for weights in args.weights:
        report = measure(weights, files)
        write_part(args, weights.name, {**report, "machine": machine("torch")})
        print(
            f"{weights.name}: {report['window_accuracy']:.4f} of {report['windows']:,} windows and "
            f"{report['accuracy']:.4f} of {report['recordings']:,} recordings are right, of "
            f"{N_TEST:,} official test recordings; published: {report['published']}"
        )
    return 0


if __name__ == "__main__":
    exit_with(main)
