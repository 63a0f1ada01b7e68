"""A set and a model that several tests share."""

import pytest
from dataset.gestures import write_set

from async_tnt.cli import main

QUICK = ("--epochs", "6", "--batch", "8", "--patience", "0")


@pytest.fixture(scope="session")
def gestures(tmp_path_factory):
    """Two classes at 128x128, 24 recordings to train on."""
    return write_set(tmp_path_factory.mktemp("gestures"), {"upright": 12, "flat": 12})


@pytest.fixture(scope="session")
def held_out(tmp_path_factory):
    """The same classes, 16 other recordings."""
    return write_set(tmp_path_factory.mktemp("held_out"), {"upright": 8, "flat": 8}, seed=1)


@pytest.fixture(scope="session")
def trained(gestures, tmp_path_factory):
    """A model trained on `gestures`, by the program."""
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    folder = tmp_path_factory.mktemp("trained")
    out = folder / "gestures.safetensors"
    assert main(["train", str(gestures), "--out", str(out), "--run", str(folder / "run"), *QUICK]) == 0
    return out


@pytest.fixture
def train(program, tmp_path):
    """Train on a set for two epochs, by the program; returns exit code, stdout, stderr and the model's file."""
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")

    def run(dataset, *words, name="m", quick=("--epochs", "2", "--batch", "8", "--patience", "0")):
        out = tmp_path / f"{name}.safetensors"
        return *program("train", dataset, "--out", out, "--run", tmp_path / f"run {name}", *quick, *words), out

    return run
