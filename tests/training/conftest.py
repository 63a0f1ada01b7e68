"""Small data sets in the layouts of N-MNIST and MNIST, and what is trained on them once for all tests."""

import pytest
from small_sets import write_small_mnist, write_small_nmnist


@pytest.fixture(scope="session")
def nmnist(tmp_path_factory):
    """4 recordings of each digit in Train (by their names, of MNIST's test images 5 to 44), 1 in Test."""
    return write_small_nmnist(tmp_path_factory.mktemp("N-MNIST"), n_train=4, first_number=60_006)


@pytest.fixture(scope="session")
def mnist(tmp_path_factory):
    """45 images."""
    return write_small_mnist(tmp_path_factory.mktemp("MNIST"), 45)
