"""A set and a model that several tests share."""

import pytest
from training.gestures import write_set

from async_tnt.cli import main

ACCEPTED = set()
"""Networks and volumes that `check_network_once` has accepted."""


@pytest.fixture(scope="session")
def gestures(tmp_path_factory):
    """Two classes at 128x128, 24 recordings to train on, and 16 in `Test`."""
    folder = tmp_path_factory.mktemp("gestures")
    write_set(folder / "Train", {"upright": 12, "flat": 12})
    write_set(folder / "Test", {"upright": 8, "flat": 8}, seed=1)
    return folder


@pytest.fixture(scope="session")
def trained(gestures, tmp_path_factory):
    """A model trained on `gestures`."""
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    folder = tmp_path_factory.mktemp("trained")
    out = folder / "gestures.safetensors"
    words = [
        "train",
        str(gestures),
        "--out",
        str(out),
        "--grid",
        "34x34",
        "--epochs",
        "3",
        "--test",
    ]
    assert main(words) == 0
    return out


@pytest.fixture
def few_steps(monkeypatch):
    """A fixture for tests whose model need not learn: two steps an epoch instead of fifty.

    Most of the time that is left goes into checks of the same network for the same volume, into the
    picture of the curves, and into starts of processes. So a network is checked once, `trained`
    alone draws a picture, and one process does all.
    """
    monkeypatch.setattr("async_tnt.cli.train.available_cores", lambda: 1)
    monkeypatch.setattr("async_tnt.training.settings.STEPS_AN_EPOCH", 2)
    monkeypatch.setattr("async_tnt.training.plan.check_network", check_network_once)
    monkeypatch.setattr("async_tnt.training.run_folder.plot_curves", write_no_curves)


def check_network_once(name, *volume, **how):
    """`check_network`, which says nothing new of a network of the package that it accepted."""
    from async_tnt.training.pipeline import check_network

    key = (name, volume, tuple(how.items()))
    if key not in ACCEPTED:
        check_network(name, *volume, **how)
        if ":" not in name:  # a file may change
            ACCEPTED.add(key)


def write_no_curves(history, path):
    path.write_bytes(b"no picture")
    return True


@pytest.fixture
def train(program, tmp_path, few_steps):
    """Train on a set for one short epoch, by the program.

    Returns exit code, stderr and the model's file.
    """
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")

    def run(dataset, *words):
        out = tmp_path / "m.safetensors"
        code, _, err = program(
            "train", dataset, "--out", out, "--grid", "34x34", "--epochs", 1, *words
        )
        return code, err, out

    return run
