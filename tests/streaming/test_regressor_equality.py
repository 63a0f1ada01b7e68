"""`check_recording` and `async-tnt check` with a model whose landmark is a network's."""

import json

import numpy as np
import pytest
from made import random_events, random_model, random_regressor_model

from async_tnt import TNTConfig
from async_tnt.checking.equality import check_recording, configurations
from async_tnt.deferred_landmark import ReplayBuffer
from async_tnt.networks.compiled import CompiledRegressor
from async_tnt.sources.files.recording import sample_recordings

MODEL = random_regressor_model(regressor_widths=(9, 20, 8), sharpness=5.0)
EVENTS = random_events(400, seed=1, duration_us=200_000, sensor=(20, 25))


def failing(model=MODEL):
    comparisons = check_recording(EVENTS, model, prefixes=5)
    assert {c.config for c in comparisons} == {*configurations(model.config), "the model"}
    assert all(c.n > 0 for c in comparisons)
    return {(c.what, c.config) for c in comparisons if not c.holds}


def test_every_comparison_holds():
    comparisons = check_recording(EVENTS, MODEL, prefixes=5)
    assert all(c.holds for c in comparisons)
    regressor = {c.what: c for c in comparisons if c.config == "regressor"}
    assert {what: c.bound for what, c in regressor.items()} == {
        "bits that depend on packets": 0.0,
        "landmark against reference, px": 1e-4,
        "volume against reference, of the largest cell": 1e-6,
        "volume against reference, its own landmark": 1e-2,
    }
    assert regressor["landmark against reference, px"].worst > 0  # two ways of rounding were compared


@pytest.mark.parametrize(
    "model",
    [
        random_model(TNTConfig(landmark="regressor", transform="none")),
        random_regressor_model(
            TNTConfig(grid=(17, 23), bins=4, window_us=50_000, t_max=3.0, polarity="split"), sharpness=5.0
        ),
    ],
    ids=["no transform", "split, another grid"],
)
def test_it_holds_for_other_models(model):
    assert ("regressor" in configurations(model.config)) == model.config.needs_regressor
    assert failing(model) == set()


@pytest.mark.parametrize(
    ("offset", "more"),
    [
        (2e-4, set()),
        (1.0, {("volume against reference, its own landmark", "regressor"), ("logits against reference", "the model")}),
    ],
)
def test_a_regressor_that_is_off_fails(monkeypatch, offset, more):
    right = CompiledRegressor.__call__
    monkeypatch.setattr(CompiledRegressor, "__call__", lambda self, raw: tuple(np.add(right(self, raw), offset)))
    assert failing() == {("landmark against reference, px", "regressor")} | more


def test_a_replay_about_another_landmark_fails(monkeypatch):
    right = TNTConfig.to_sensor  # the replay's way from the landmark to the kernel
    monkeypatch.setattr(TNTConfig, "to_sensor", lambda self, x, y: right(self, x + 1e-4, y))
    what = "volume against reference, of the largest cell"
    assert {(what, "window"), (what, "regressor")} <= failing()


def test_a_raw_volume_that_lacks_one_event_fails(monkeypatch):
    right = ReplayBuffer._show_raw
    monkeypatch.setattr(ReplayBuffer, "_show_raw", lambda self, first: right(self, max(first, 1)))
    assert ("landmark against reference, px", "regressor") in failing()


def test_the_command(tmp_path, program):
    path = MODEL.save(tmp_path / "model.safetensors")
    recording = sample_recordings()[3]
    code, out, _ = program("check", recording, "--model", path, "--prefixes", 1)
    assert code == 0 and "volume against reference, its own landmark" in out and "stream and batch are equal" in out
    code, out, _ = program("check", recording, "--model", path, "--prefixes", 1, "--json")
    rows = json.loads(out)["recordings"][str(recording)]
    assert code == 0 and {row["config"] for row in rows} == {*configurations(MODEL.config), "the model"}
