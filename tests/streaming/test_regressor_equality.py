"""`check_recording` and `async-tnt check` with a model whose landmark is a network's."""

import json

import numpy as np
import pytest
from made import random_events, random_model, random_regressor_model

from async_tnt import TNTConfig
from async_tnt.checking.equality import check_recording, configurations
from async_tnt.cli import main
from async_tnt.deferred_landmark import ReplayBuffer
from async_tnt.networks.compiled import CompiledRegressor
from async_tnt.sources.files.recording import sample_recordings

MODEL = random_regressor_model(regressor_widths=(9, 20, 8), sharpness=5.0)
EVENTS = random_events(400, seed=1, duration_us=200_000, sensor=(20, 25))


def failing(model=MODEL, events=EVENTS):
    comparisons = check_recording(events, model, prefixes=5)
    assert {c.config for c in comparisons} == {*configurations(model.config), "the model"}
    assert all(c.n > 0 for c in comparisons)
    return {(c.what, c.config) for c in comparisons if not c.holds}


def test_all_of_it_holds():
    assert failing() == set()
    comparisons = {c.what: c for c in check_recording(EVENTS, MODEL, prefixes=5) if c.config == "regressor"}
    assert {what: c.bound for what, c in comparisons.items()} == {
        "bits that depend on packets": 0.0,
        "landmark against reference, px": 1e-4,
        "volume against reference, of the largest cell": 1e-6,
        "volume against reference, its own landmark": 1e-2,
    }
    assert comparisons["landmark against reference, px"].worst > 0  # two ways of rounding were compared


def test_a_configuration_without_the_landmark_leaves_it_out():
    for settings in ({}, {"landmark": "regressor", "transform": "none"}):
        model = random_model(TNTConfig(**settings))
        assert "regressor" not in configurations(model.config)
        assert failing(model) == set()


@pytest.mark.parametrize("polarity", ["unsigned", "split"])
def test_it_holds_for_other_polarities_and_grids(polarity):
    config = TNTConfig(sensor=(34, 34), grid=(17, 23), bins=4, window_us=50_000, t_max=3.0, polarity=polarity)
    assert failing(random_regressor_model(config, sharpness=5.0)) == set()


def test_a_regressor_that_is_a_little_off_fails(monkeypatch):
    right = CompiledRegressor.__call__
    monkeypatch.setattr(CompiledRegressor, "__call__", lambda self, raw: tuple(np.add(right(self, raw), 2e-4)))
    assert failing() == {("landmark against reference, px", "regressor")}


def test_a_regressor_that_is_off_by_a_pixel_fails_in_volume_and_logits_too(monkeypatch):
    right = CompiledRegressor.__call__
    monkeypatch.setattr(CompiledRegressor, "__call__", lambda self, raw: tuple(np.add(right(self, raw), 1.0)))
    assert failing() == {
        ("landmark against reference, px", "regressor"),
        ("volume against reference, its own landmark", "regressor"),
        ("logits against reference", "the model"),
    }


def test_a_replay_about_another_landmark_than_told_fails(monkeypatch):
    right = TNTConfig.to_sensor  # the replay's way from the landmark to the kernel
    monkeypatch.setattr(TNTConfig, "to_sensor", lambda self, x, y: right(self, x + 1e-4, y))
    what = "volume against reference, of the largest cell"
    assert {(what, "window"), (what, "regressor")} <= failing()


def test_a_raw_volume_that_lacks_one_event_fails(monkeypatch):
    right = ReplayBuffer._show_raw
    monkeypatch.setattr(ReplayBuffer, "_show_raw", lambda self, first: right(self, max(first, 1)))
    assert ("landmark against reference, px", "regressor") in failing()


def test_the_command(tmp_path, capsys):
    path = MODEL.save(tmp_path / "model.safetensors")
    recording = str(sample_recordings()[3])
    assert main(["check", recording, "--model", str(path), "--prefixes", "2"]) == 0
    out = capsys.readouterr().out
    assert "volume against reference, its own landmark" in out and "stream and batch are equal" in out
    assert main(["check", recording, "--model", str(path), "--prefixes", "2", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["recordings"][recording]
    assert {row["config"] for row in rows} == {
        "center",
        "running",
        "line",
        "window",
        "regressor",
        "line, flow removed",
        "no transform",
        "the model",
    }
    assert main(["run", recording, "--model", str(path), "--every-us", "20000"]) == 0
    assert len(capsys.readouterr().out.splitlines()) > 10
