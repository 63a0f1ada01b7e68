"""A small N-MNIST and a small MNIST for the table."""

import gzip

import numpy as np
import pytest

from async_tnt.recordings import read_nmnist, sample_recordings, write_nmnist


def idx_bytes(array):
    return bytes([0, 0, 8, array.ndim]) + b"".join(n.to_bytes(4, "big") for n in array.shape) + array.tobytes()


@pytest.fixture(scope="session")
def small_nmnist(tmp_path_factory):
    """The ten bundled samples in N-MNIST's layout, moved a little: 4 of each digit in Train, 1 in Test."""
    folder = tmp_path_factory.mktemp("nmnist")
    for digit, path in sample_recordings().items():
        events = read_nmnist(path)
        for split, n in (("Train", 4), ("Test", 1)):
            (folder / split / str(digit)).mkdir(parents=True)
            for k in range(n):
                moved = events.copy()
                moved["x"] = np.minimum(moved["x"] + k, 33)
                write_nmnist(folder / split / str(digit) / f"{60_006 + 10 * k + digit}.bin", moved)
    return folder


@pytest.fixture(scope="session")
def small_mnist(tmp_path_factory):
    """A folder like MNIST's test set: 45 images of bars, whose slope follows their label."""
    folder = tmp_path_factory.mktemp("mnist")
    labels = (np.arange(45) % 10).astype(np.uint8)
    rows, columns = np.mgrid[:28, :28] - 13.5
    images = np.zeros((45, 28, 28), np.uint8)
    for image, label in zip(images, labels, strict=True):
        across = rows * np.cos(np.pi * label / 10) - columns * np.sin(np.pi * label / 10)
        image[(np.abs(across) < 2) & (rows**2 + columns**2 < 81)] = 255
    (folder / "t10k-images-idx3-ubyte.gz").write_bytes(gzip.compress(idx_bytes(images), 1))
    (folder / "t10k-labels-idx1-ubyte.gz").write_bytes(gzip.compress(idx_bytes(labels), 1))
    return folder


@pytest.fixture(scope="session")
def small_set(small_mnist, tmp_path_factory):
    """45 images under 30 motions; the small N-MNIST's Train shows all but the first 5."""
    from async_tnt.simulation.moving_mnist import build

    folder = tmp_path_factory.mktemp("moving")
    build(small_mnist, folder, workers=1)
    return folder
