"""The list of published networks, and that its small ones are built and tried."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from experiments import zoo  # noqa: E402
from experiments.published.build import build, sparse_inputs  # noqa: E402
from experiments.published.zoo_list import EVENTS, entries  # noqa: E402

ENTRIES = {entry.name: entry for entry in entries()}


def test_the_list_has_more_than_a_hundred_networks_each_once():
    assert len(ENTRIES) == len(entries()) >= 100


@pytest.mark.parametrize("name", EVENTS)
def test_networks_of_event_cameras_compute_something_of_usual_size(name):
    entry = ENTRIES[name]
    with torch.no_grad():
        outputs = build(entry)(sparse_inputs(1, entry.shape, torch.Generator().manual_seed(1)))
    for output in outputs if isinstance(outputs, tuple) else (outputs,):
        assert torch.isfinite(output).all() and output.std() > 1e-4
        assert output.abs().max() < 1e4


@pytest.mark.parametrize("name", ["nir_nmnist", "roshambo", "eye_tracker"])
def test_small_networks_are_accepted_from_torch_and_onnx(name):
    pytest.importorskip("onnx")
    numbers = zoo.tried(ENTRIES[name])
    assert (numbers["torch"], numbers["onnx"], numbers["wrong_bits"]) == ("", "", 0)
    assert numbers["deviation"] <= max(1e-4, 4 * numbers["own_deviation"])
    if "speed" in numbers:
        assert 0 < numbers["speed"]["share"] < 1 and numbers["speed"]["ratio"] > 0


def test_a_refused_network_has_its_reason_in_one_line():
    reason = zoo.tried(ENTRIES["firenet"])["torch"]
    assert reason and "\n" not in reason and len(reason) < 400


def test_a_run_goes_on_where_it_was_interrupted(monkeypatch, tmp_path, capsys):
    tried = []

    def counted(entry):
        tried.append(entry.name)
        if len(tried) == 3:
            raise KeyboardInterrupt
        exact = {"wrong_bits": 0, "deviation": 1e-7, "own_deviation": 1e-7}
        return {"torch": "", "onnx": "no such operator", **exact}

    monkeypatch.setattr(zoo, "tried", counted)
    monkeypatch.setattr(zoo, "entries", lambda: tuple(ENTRIES.values())[:4])
    words = ["--json", str(tmp_path / "zoo.json")]
    with pytest.raises(KeyboardInterrupt):
        zoo.main(words)
    assert zoo.main(words) == 0
    assert tried == [*list(EVENTS)[:3], *list(EVENTS)[2:4]]
    assert "4 networks: 4 accepted from torch, 0 from ONNX, 0 from both" in capsys.readouterr().out
