"""Small data sets in the layouts of N-MNIST and MNIST: made in a second, to try commands with."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np

from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.sources.files.recording import sample_recordings
from experiments.digit_data.nmnist_files import write_nmnist


def write_small_nmnist(folder: Path, *, n_train: int, first_number: int) -> Path:
    """Write the ten bundled samples, each moved by 0, 1, ... pixels.

    `n_train` of each digit are in Train, and 1 is in Test.
    """
    for digit, path in sample_recordings().items():
        events = read_nmnist(path)
        for split, n in (("Train", n_train), ("Test", 1)):
            (folder / split / str(digit)).mkdir(parents=True)
            for k in range(n):
                moved = events.copy()
                moved["x"] = np.minimum(moved["x"] + k, 33)
                write_nmnist(
                    folder / split / str(digit) / f"{first_number + 10 * k + digit:05d}.bin", moved
                )
    return folder


def write_small_mnist(folder: Path, n: int) -> Path:
    """Write `n` images of thick bars, whose slope and place follow their label.

    Both splits have the same images. Their labels are 0, 1, ... 9, 0, ..., so that image n shows
    the digit of the recording with this number of `write_small_nmnist`.
    """
    rng = np.random.default_rng(0)
    labels = (np.arange(n) % 10).astype(np.uint8)
    rows, columns = np.mgrid[:28, :28] - 13.5
    images = np.zeros((n, 28, 28), np.uint8)
    for image, label in zip(images, labels, strict=True):
        angle = np.pi * label / 10
        across = rows * np.cos(angle) - columns * np.sin(angle) + rng.normal()
        image[(np.abs(across) < 2) & (rows**2 + columns**2 < 81)] = 255
    for prefix in ("train", "t10k"):
        (folder / f"{prefix}-images-idx3-ubyte.gz").write_bytes(gzip.compress(idx_bytes(images), 1))
        (folder / f"{prefix}-labels-idx1-ubyte.gz").write_bytes(gzip.compress(idx_bytes(labels), 1))
    return folder


def idx_bytes(array: np.ndarray) -> bytes:
    """A uint8 array as the content of an IDX file."""
    sizes = b"".join(n.to_bytes(4, "big") for n in array.shape)
    return bytes([0, 0, 8, array.ndim]) + sizes + array.astype(np.uint8).tobytes()
