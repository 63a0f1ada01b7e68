"""Shared by the tests of the simulator."""

import pytest


@pytest.fixture(scope="session")
def real_mnist(data):
    """MNIST itself, or skip."""
    if not (data / "mnist").is_dir():
        pytest.skip(f"no mnist in {data}")
    return data / "mnist"
