"""Accuracies of published weights are recorded by name, on the official test recordings there."""

import json
import runpy

import pytest

pytest.importorskip("torch", reason="networks are read with torch (extra `reference`)")

import torch

from async_tnt.sources import sample_recordings
from experiments import published_weights


@pytest.fixture
def samples(tmp_path):
    """The ten bundled samples as official test recordings 1 to 10."""
    for digit, path in sample_recordings().items():
        copy = tmp_path / "N-MNIST" / "Test" / str(digit) / f"{digit + 1:05}.bin"
        copy.parent.mkdir(parents=True)
        copy.write_bytes(path.read_bytes())
    return tmp_path / "N-MNIST"


def test_each_network_has_a_result_of_its_name(experiment, samples, tmp_path):
    example = runpy.run_path(str(published_weights.EXAMPLE))
    report = tmp_path / "report.json"
    for name, make in (("a.pth", "paper_network"), ("b.ckpt", "checkpoint_network")):
        torch.save(example[make]().state_dict(), tmp_path / name)
        words = (tmp_path / name, "--nmnist", samples, "--json", report)
        code, out, _ = experiment("published_weights", *words)
        assert code == 0 and out.startswith(f"{name}: 0.")
        assert "of 30 windows and " in out and "of 10 recordings are right, of 10,000 offi" in out
    results = json.loads(report.read_text())
    assert list(results) == ["a.pth", "b.ckpt"]
    for result in results.values():
        numbers = result["numbers"]
        assert (numbers["official_test_recordings"], numbers["of"]) == (10, 10_000)
        assert (numbers["recordings"], numbers["windows"]) == (10, 30)
        assert numbers["window_accuracy"] == numbers["windows_right"] / 30
        assert numbers["accuracy"] == numbers["recordings_right"] / 10


def test_weights_of_another_network_are_refused(experiment, samples, tmp_path):
    torch.save({"0.weight": torch.zeros(3, 2)}, tmp_path / "other.pth")
    words = (tmp_path / "other.pth", "--nmnist", samples)
    code, _, err = experiment("published_weights", *words)
    assert code == 2 and "other.pth: weights of another network, 1 tensors" in err
