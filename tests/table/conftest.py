"""A small N-MNIST, a small MNIST and its moving digits for the table."""

import pytest
from small_sets import write_small_mnist, write_small_nmnist


@pytest.fixture(scope="session")
def small_nmnist(tmp_path_factory):
    """4 recordings of each digit to train on: by their names, of MNIST's test images 5 to 44."""
    return write_small_nmnist(tmp_path_factory.mktemp("nmnist"), n_train=4, first_number=60_006)


@pytest.fixture(scope="session")
def small_mnist(tmp_path_factory):
    """45 images."""
    return write_small_mnist(tmp_path_factory.mktemp("mnist"), 45)


@pytest.fixture(scope="session")
def small_set(small_mnist, tmp_path_factory):
    """45 images under 30 motions; the small N-MNIST's Train shows all but the first 5."""
    from async_tnt.simulation.moving_mnist import build

    folder = tmp_path_factory.mktemp("moving")
    build(small_mnist, folder, workers=1)
    return folder
