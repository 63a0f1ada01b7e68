"""Folders like MNIST's, shared by the tests of the simulator."""

import pytest
from small_sets import write_small_mnist


@pytest.fixture(scope="session")
def mnist(tmp_path_factory):
    """24 made images."""
    return write_small_mnist(tmp_path_factory.mktemp("mnist"), 24)


@pytest.fixture(scope="session")
def real_mnist(data):
    """MNIST itself, or skip."""
    if not (data / "mnist").is_dir():
        pytest.skip(f"no mnist in {data}")
    return data / "mnist"
