"""Small data sets in the layouts of N-MNIST and MNIST, and MNIST itself.

A fixture runs the laboratory's commands as a function.
"""

import importlib

import pytest

from experiments.digit_data.small_sets import write_small_mnist, write_small_nmnist
from experiments.scripts.options import exit_with


@pytest.fixture(scope="session")
def nmnist(tmp_path_factory):
    """A folder with 4 recordings of each digit in Train, and 1 in Test.

    By their names, those in Train show MNIST's test images 5 to 44.
    """
    return write_small_nmnist(tmp_path_factory.mktemp("N-MNIST"), n_train=4, first_number=60_006)


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


@pytest.fixture
def experiment(capsys, monkeypatch):
    """Run `python -m experiments.NAME` with words; returns exit code, stdout and stderr."""

    def run(name, *words):
        monkeypatch.setattr("sys.argv", [f"/checkout/experiments/{name}.py"])
        main = importlib.import_module(f"experiments.{name}").main
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            exit_with(lambda: main([str(word) for word in words]))
        return ended.value.code, *capsys.readouterr()

    return run
