"""Make the ten bundled sample recordings: simulated digits in N-MNIST's format.

python -m experiments.samples --mnist MNIST --out FOLDER
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments.digit_data.mnist import load_mnist
from experiments.digit_data.nmnist_files import write_nmnist
from experiments.motions.simulated_digits import simulate_digit
from experiments.scripts.options import add_folder, data_folder, exit_with, plain_parser

FIRST_SAMPLE = 2_000
"""Index of the first MNIST training image for samples. N-MNIST's first recordings show earlier
images."""


def sample_indices(labels: np.ndarray) -> dict[int, int]:
    """The index of each digit's first image at `FIRST_SAMPLE` or later.

    Raises
    ------
    ValueError : a digit does not occur there.
    """
    indices = {}
    for digit in range(10):
        places = np.flatnonzero(labels[FIRST_SAMPLE:] == digit)
        if len(places) == 0:
            raise ValueError(
                f"no image of a {digit} from index {FIRST_SAMPLE} on, in {len(labels)} images"
            )
        indices[digit] = FIRST_SAMPLE + int(places[0])
    return indices


def write_samples(mnist_folder: Path, out_folder: Path) -> list[Path]:
    """Simulate and write `<out_folder>/<digit>.bin` for the ten digits, and return the paths.

    Each digit has its own random generator, seeded by (0, digit).

    Raises
    ------
    ValueError : damaged MNIST files.
    OSError : MNIST files missing, or the folder cannot be written.
    """
    images, labels = load_mnist(mnist_folder, "train")
    indices = sample_indices(labels)
    out_folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for digit, index in indices.items():
        events = simulate_digit(images[index], np.random.default_rng((0, digit)))
        paths.append(out_folder / f"{digit}.bin")
        write_nmnist(paths[-1], events)
    return paths


def main(argv: list[str] | None = None) -> int:
    """Simulate and write the samples."""
    parser = plain_parser("samples", __doc__)
    add_folder(parser, "--mnist", "MNIST's IDX files, gzipped or not (default: $TNT_DATA/mnist)")
    parser.add_argument("--out", type=Path, metavar="FOLDER", required=True, help="for <digit>.bin")
    args = parser.parse_args(argv)
    paths = write_samples(data_folder(args.mnist, "mnist", "--mnist"), args.out)
    print(f"{args.out}: {len(paths)} recordings")
    return 0


if __name__ == "__main__":
    exit_with(main)
