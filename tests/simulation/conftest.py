"""A small MNIST of made images, shared by the tests of N-MOVING-MNIST."""

import gzip

import numpy as np
import pytest

N_IMAGES = 24


def idx_bytes(array):
    return bytes([0, 0, 8, array.ndim]) + b"".join(n.to_bytes(4, "big") for n in array.shape) + array.tobytes()


@pytest.fixture(scope="session")
def mnist(tmp_path_factory):
    """A folder like MNIST's: 24 images of thick bars, whose slope and place follow their label."""
    folder = tmp_path_factory.mktemp("mnist")
    rng = np.random.default_rng(0)
    labels = (np.arange(N_IMAGES) * 7 % 10).astype(np.uint8)
    rows, columns = np.mgrid[:28, :28] - 13.5
    images = np.zeros((N_IMAGES, 28, 28), np.uint8)
    for image, label in zip(images, labels, strict=True):
        angle = np.pi * label / 10
        across = rows * np.cos(angle) - columns * np.sin(angle) + rng.normal()
        image[(np.abs(across) < 2) & (rows**2 + columns**2 < 81)] = 255
    for prefix in ("train", "t10k"):
        (folder / f"{prefix}-images-idx3-ubyte.gz").write_bytes(gzip.compress(idx_bytes(images), 1))
        (folder / f"{prefix}-labels-idx1-ubyte.gz").write_bytes(gzip.compress(idx_bytes(labels), 1))
    return folder
