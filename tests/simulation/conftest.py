"""A small MNIST of made images, shared by the tests of N-MOVING-MNIST."""

import pytest
from small_sets import write_small_mnist


@pytest.fixture(scope="session")
def mnist(tmp_path_factory):
    """A folder like MNIST's: 24 images."""
    return write_small_mnist(tmp_path_factory.mktemp("mnist"), 24)
