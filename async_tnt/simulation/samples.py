"""Make the bundled sample recordings: one simulated recording of each digit.

    python -m async_tnt.simulation.samples MNIST_FOLDER OUT_FOLDER --seed 0

The image of a digit is the first of its kind in MNIST's training set from index 2,000 on: clear of the images
that the first recordings of N-MNIST show. The same images, seed and version give the same bytes.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from async_tnt.simulation.digits import simulate_digit
from async_tnt.simulation.mnist import load_mnist
from async_tnt.sources.files.nmnist import write_nmnist

FIRST_INDEX = 2_000


def sample_indices(labels: np.ndarray, first_index: int = FIRST_INDEX) -> dict[int, int]:
    """Digit -> index of its first image at `first_index` or later.

    Raises
    ------
    ValueError : a digit does not occur there.
    """
    indices = {}
    for digit in range(10):
        found = np.flatnonzero(labels[first_index:] == digit)
        if len(found) == 0:
            raise ValueError(f"no image of a {digit} from index {first_index} on, in {len(labels)} images")
        indices[digit] = first_index + int(found[0])
    return indices


def write_samples(mnist_folder: str | os.PathLike[str], out_folder: str | os.PathLike[str], seed: int) -> list[Path]:
    """Simulate and write `<out_folder>/<digit>.bin` for the ten digits; returns their paths.

    Each digit has a random generator of its own, seeded by (seed, digit).

    Raises
    ------
    ValueError : damaged MNIST files.
    OSError : MNIST files missing, or the folder cannot be written.
    """
    images, labels = load_mnist(mnist_folder, "train")
    indices = sample_indices(labels)
    out_folder = Path(out_folder)
    out_folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for digit, index in indices.items():
        events = simulate_digit(images[index], np.random.default_rng((seed, digit)))
        paths.append(out_folder / f"{digit}.bin")
        write_nmnist(paths[-1], events)
    return paths


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns its exit code: 0, or 2 for bad usage or input."""
    parser = argparse.ArgumentParser(
        prog="python -m async_tnt.simulation.samples",
        description="Simulate one N-MNIST-like recording of each digit and write <digit>.bin files.",
    )
    parser.add_argument("mnist_folder", type=Path, help="folder with MNIST's IDX files, gzipped or not")
    parser.add_argument("out_folder", type=Path, help="folder to write the recordings to; made if missing")
    parser.add_argument("--seed", type=int, default=0, help="seed of all randomness, at least 0 (default: 0)")
    options = parser.parse_args(arguments)
    if options.seed < 0:
        parser.error(f"--seed must be at least 0, got {options.seed}")
    try:
        paths = write_samples(options.mnist_folder, options.out_folder, options.seed)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for path in paths:
        print(f"{path}  {path.stat().st_size} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
