"""A training ends early where nothing that is held out can improve.

This is checked by hand, and in the loop, interrupted or not.
"""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from training.test_training_loop import CONFIG, assert_equal, bars, train  # noqa: E402

from async_tnt.training import early_end, loop  # noqa: E402
from async_tnt.training.early_end import COOLING, GAIN, PATIENCE, settled_at  # noqa: E402
from async_tnt.training.run_folder import load_checkpoint  # noqa: E402
from async_tnt.training.settings import TrainSettings, settings_for  # noqa: E402


def row(loss=0.1, share=1.0, **more):
    return {
        "epoch": 0,
        "loss": 0.5,
        "per_window": share,
        "per_recording": 1.0,
        "validation_loss": loss,
        **more,
    }


RIGHT = [row()] * 30


@pytest.mark.parametrize(
    ("history", "expected"),
    {
        "the first epoch sets the loss, ten follow without a gain": (RIGHT, 1 + PATIENCE),
        "not yet": (RIGHT[:PATIENCE], None),
        "nothing": ([], None),
        "nothing is held out": ([{"epoch": 0, "loss": 0.1, "training": 1.0}] * 99, None),
        "a window is wrong": ([row(share=0.99)] * 99, None),
        "a recording is wrong": ([row(per_recording=0.5)] * 99, None),
        "a window in another motion is wrong": ([row(motions_per_window=0.9)] * 99, None),
        "all right, in other motions, too": ([row(motions_per_window=1.0)] * 30, 1 + PATIENCE),
        "wrong at first": ([row(share=0.5)] * 7 + RIGHT, 7 + PATIENCE),
        "once wrong": ([*RIGHT[:PATIENCE], row(share=0.5), *RIGHT], 2 * PATIENCE + 1),
        "the loss falls by more than a tenth every ninth epoch": (
            [row(0.85 ** (k // 9)) for k in range(99)],
            None,
        ),
        "by a seventieth in each": ([row(0.985**k) for k in range(99)], None),
        "by less": ([row(0.999**k) for k in range(99)], 1 + PATIENCE),
        "that in other motions falls": (
            [row(motions_validation_loss=0.8**k) for k in range(99)],
            None,
        ),
        "it is 0": ([row(0.0)] * 30, 1 + PATIENCE),
        "it is below 0 by rounding": ([row(-1e-12)] * 30, 1 + PATIENCE),
        "it rises": ([row(1.1**k) for k in range(99)], 1 + PATIENCE),
        "objects in scenes": ([{"epoch": 0, "loss": 0.5, "f1": 1.0}] * 30, PATIENCE),
        "objects that are not all found": ([{"epoch": 0, "loss": 0.5, "f1": 0.999}] * 30, None),
    }.values(),
)
def test_when_nothing_can_improve_by_hand(history, expected, monkeypatch):
    monkeypatch.setattr(early_end, "PATIENCE", PATIENCE)  # whatever other tests have set
    monkeypatch.setattr(early_end, "GAIN", GAIN)
    assert settled_at(history) == expected
    assert settled_at(history + [row(share=0.0)] * 3) == expected  # once settled, it stays


@pytest.fixture(scope="module")
def windows():
    return bars()


SETTINGS = TrainSettings(epochs=40, batch=24, seed=5, ends_early=True, averaging=0.5)


@pytest.fixture(scope="module")
def soon():
    """Settled after three epochs in which all is right, whatever the loss does; two more follow."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(early_end, "PATIENCE", 3)
        patch.setattr(early_end, "GAIN", 1.0)
        patch.setattr(loop, "COOLING", 2)
        yield


@pytest.fixture(scope="module")
def held_out():
    return bars(8, seed=1)


@pytest.fixture(scope="module")
def ended(windows, held_out, soon, tmp_path_factory):
    """A training that has ended early, and its run folder."""
    folder = tmp_path_factory.mktemp("ended")
    return train(CONFIG, windows, held_out, SETTINGS, folder), folder


def test_the_rate_falls_to_nothing_and_the_last_weights_are_kept(windows, held_out, ended):
    result, folder = ended
    settled = early_end.settled_at(result.history)
    assert 3 <= settled < 35 and len(result.history) == settled + 2
    steps = SETTINGS.n_steps(len(windows))
    checkpoint = torch.load(folder / "checkpoint.pt", weights_only=True)
    rate, *others = [group["lr"] for group in checkpoint["optimizer"]["param_groups"]]
    share = loop._share_of_rate(SETTINGS, settled * steps, SETTINGS.n_iterations(len(windows)))
    assert rate == pytest.approx(SETTINGS.learning_rate * share / (2 * steps))
    assert set(others) == {rate}
    again = train(
        CONFIG, windows, held_out, SETTINGS, folder, report=lambda row: pytest.fail("trained on")
    )
    assert_equal(again.model, result.model)
    assert again.history == result.history


def test_interrupted_after_any_epoch_it_ends_in_the_same_with_the_same_weights(
    windows, held_out, ended, tmp_path
):
    whole = ended[0]
    settled = early_end.settled_at(whole.history)

    def stop(row):
        raise KeyboardInterrupt

    for _ in range(settled + 2):  # after each epoch
        with pytest.raises(KeyboardInterrupt):
            train(CONFIG, windows, held_out, SETTINGS, tmp_path / "cut", report=stop)
    # nothing is left to do
    resumed = train(CONFIG, windows, held_out, SETTINGS, tmp_path / "cut", report=stop)
    assert resumed.history == whole.history
    assert_equal(resumed.model, whole.model)


def test_all_epochs_are_made_where_nothing_is_held_out_or_they_were_asked_for(
    windows, held_out, soon, tmp_path
):
    settings = replace(SETTINGS, epochs=12)
    nothing = train(CONFIG, windows, windows[:0], settings, tmp_path / "nothing")
    asked = train(
        CONFIG, windows, held_out, replace(settings, ends_early=False), tmp_path / "asked"
    )
    assert len(nothing.history) == len(asked.history) == 12
    assert early_end.settled_at(asked.history) is not None
    for a, b in zip(asked.history, asked.history[1:], strict=False):
        assert a["epoch"] + 1 == b["epoch"]
    # and it is another run
    with pytest.raises(ValueError, match="holds a run with other ends_early"):
        train(CONFIG, windows, held_out, settings, tmp_path / "asked")


def test_a_default_training_may_end_early_one_of_stated_epochs_may_not():
    assert settings_for(CONFIG, 96).ends_early and settings_for(CONFIG, 96).epochs > 40
    assert not settings_for(CONFIG, 96, epochs=5).ends_early and not TrainSettings().ends_early
    assert settings_for(CONFIG, 96, epochs=5, ends_early=True).ends_early
    assert not settings_for(CONFIG, 96, ends_early=False).ends_early


def test_the_command_tells_it(gestures, few_steps, program, monkeypatch, tmp_path):
    """And its model's record says how many epochs there were."""
    monkeypatch.setattr("async_tnt.training.settings.MIN_STEPS", 20)
    monkeypatch.setattr("async_tnt.training.settings.MIN_EPOCHS", 10)
    monkeypatch.setattr(loop, "settled_at", lambda history: 1 if history else None)
    monkeypatch.setattr(loop, "COOLING", COOLING)
    words = (
        "train",
        gestures,
        "--out",
        tmp_path / "m.safetensors",
        "--grid",
        "34x34",
        "--network",
        "conv4",
    )
    code, _, err = program(*words)
    assert (
        code == 0
        and f"ended after {1 + COOLING} of 10 epochs: all that is held out was right" in err
    )
    assert load_checkpoint(tmp_path / "runs" / "m", {})["history"][-1]["epoch"] == 1 + COOLING
    code, _, err = program(*words[:3], tmp_path / "n.safetensors", *words[4:], "--epochs", 7)
    assert code == 0 and "ended after" not in err
    assert len(load_checkpoint(tmp_path / "runs" / "n", {})["history"]) == 7
    assert np.isfinite(load_checkpoint(tmp_path / "runs" / "n", {})["history"][-1]["loss"])
