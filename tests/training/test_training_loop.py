"""The loop learns, records what it did, and an interruption leaves no trace in the weights."""

import copy
import json
import os
from dataclasses import replace

import numpy as np
import pytest
from damage import damaged_bytes
from made import events_of

torch = pytest.importorskip("torch")

from async_tnt.base.files import locked_folder  # noqa: E402
from async_tnt.base.progress import Bar  # noqa: E402
from async_tnt.networks.models.model import Model  # noqa: E402
from async_tnt.training import loop, run_folder  # noqa: E402
from async_tnt.training.augment import Augmentation  # noqa: E402
from async_tnt.training.evaluation import evaluate  # noqa: E402
from async_tnt.training.loop import _optimizer, balanced_order, batches_of  # noqa: E402
from async_tnt.training.networks import build_network  # noqa: E402
from async_tnt.training.objectives import ClassOfWindows, ObjectsInScenes  # noqa: E402
from async_tnt.training.pipeline import Pipeline, new_pipeline, pipeline_of  # noqa: E402
from async_tnt.training.recordings import Recordings  # noqa: E402
from async_tnt.training.run_folder import (  # noqa: E402
    CHECKPOINT,
    FORMAT,
    identity_of,
    load_checkpoint,
    save_checkpoint,
    windows_checksum,
)
from async_tnt.training.settings import TrainSettings, settings_for  # noqa: E402
from async_tnt.training.training_data import TrainingData  # noqa: E402
from async_tnt.training.windows import make_windows  # noqa: E402
from async_tnt.volume.config import TNTConfig  # noqa: E402

CONFIG = TNTConfig(landmark="running", t_max=2.0)
CLASSES = ("across", "down")
ONE_EPOCH = TrainSettings(epochs=1, batch=16)


def train(config, training, validation, settings, run_folder, *, classes=CLASSES, **more):
    data = TrainingData(config, classes, training, validation)
    return loop.train(data, settings, run_folder, **more)


def bars(n=24, seed=0):
    """Windows of two classes that anyone can tell apart: bars along x, and along y."""
    rng = np.random.default_rng(seed)
    recordings = []
    for k in range(n):
        t = np.sort(rng.integers(0, 315_000, 600))
        along = rng.integers(8, 26, 600)
        across = rng.integers(15, 19, 600)
        x, y = (along, across) if k % 2 else (across, along)
        recordings.append(events_of(t, x, y, rng.integers(0, 2, 600)))
    return make_windows(Recordings.from_events(recordings, np.arange(n) % 2), CONFIG.window_us)


def assert_equal(a, b):
    for name, weights in a.weights.items():
        np.testing.assert_array_equal(weights, b.weights[name])


@pytest.fixture(scope="module")
def windows():
    return bars()


@pytest.fixture(scope="module")
def trained(windows, tmp_path_factory):
    """A run of one epoch: its result and its folder."""
    folder = tmp_path_factory.mktemp("run")
    return train(CONFIG, windows, windows[:0], ONE_EPOCH, folder), folder


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_it_learns_what_is_easy(precision, windows, tmp_path):
    settings = TrainSettings(
        epochs=4, batch=8, augmentation=Augmentation(rotation_deg=5.0), precision=precision
    )
    result = train(CONFIG, windows, bars(8, seed=1), settings, tmp_path)
    assert result.history[-1]["loss"] < 0.5 * result.history[0]["loss"]
    assert result.history[-1]["per_window"] == 1.0
    assert json.loads((tmp_path / "history.json").read_text())["history"] == result.history
    assert all(w.dtype == np.float32 for w in result.model.weights.values())


OWN = """
from __future__ import annotations

from dataclasses import dataclass

from torch import nn

@dataclass
class Settings:
    width: int = 4

def build(channels, grid, n_classes):
    assert Settings().width == 4
    return nn.Sequential(
        nn.Conv2d(channels, 4, 3),
        nn.AdaptiveAvgPool2d(1),
        nn.BatchNorm2d(4),
        nn.Dropout(0.5),
        nn.Flatten(),
        nn.Linear(4, n_classes),
    )
"""


class DecidesByTheSum(torch.nn.Module):
    """Class 1 where the volume's sum is positive."""

    def __init__(self):
        super().__init__()
        self.unused = torch.nn.Parameter(torch.zeros(1))

    def forward(self, volume):
        total = volume.sum((1, 2, 3))
        return torch.stack([torch.zeros_like(total), total], dim=1)


def test_evaluation_by_hand():
    """Recording 0: two saccades ON, weakly, one OFF, strongly; recording 1: OFF throughout."""

    def recording(*saccades):
        rows = [
            (105_000 * k + 1_000 * (i + 40), 16, 16, p)
            for k, (n, p) in enumerate(saccades)
            for i in range(n)
        ]
        return events_of(*np.array(rows).T)

    recordings = Recordings.from_events(
        [recording((1, 1), (1, 1), (9, 0)), recording((3, 0), (3, 0), (3, 0))], [1, 0]
    )
    pipeline = Pipeline(TNTConfig(transform="none"), DecidesByTheSum())
    # the end counts once
    found = evaluate(pipeline, make_windows(recordings, 105_000), times_ms=(10, 100, 105, 400))
    assert found.times_ms == (10, 100, 105)
    assert found.per_window == pytest.approx(5 / 6)
    np.testing.assert_array_equal(found.confusion, [[3, 0], [1, 2]])
    assert (found.to_dict()["windows"], found.to_dict()["recordings"]) == (6, 2)
    assert found.per_recording == 0.5  # mean of .731, .731, .0001 for class 1 is below a half
    np.testing.assert_array_equal(found.recording_confusion, [[1, 0], [1, 0]])
    # nothing yet: 0
    assert found.against_time == {
        10.0: 0.5,
        100.0: pytest.approx(5 / 6),
        105.0: pytest.approx(5 / 6),
    }
    assert found.to_dict()["against_time_ms"] == {"10": 0.5, "100": 0.83333, "105": 0.83333}
    # three of one class, with a mean loss of 3.2089, one of the other
    some = make_windows(recordings, 105_000)[:4]
    objectives = [
        ClassOfWindows(CONFIG, some, TrainSettings(balance=balance), 2) for balance in (True, False)
    ]
    losses = [objective.validate(pipeline)["validation_loss"] for objective in objectives]
    assert losses == pytest.approx([(3.2089 + 0.0486) / 2, (3 * 3.2089 + 0.0486) / 4], abs=1e-3)


def test_every_parameter_is_trained_and_an_infinite_loss_ends_the_training(windows, tmp_path):
    module = torch.nn.BatchNorm1d(2)
    module.scale = torch.nn.Parameter(torch.tensor(1.0))
    groups = _optimizer(module, TrainSettings()).param_groups
    assert {id(w) for group in groups for w in group["params"]} == {
        id(w) for w in module.parameters()
    }
    with pytest.raises(ValueError, match=r"^the loss of epoch 1 is not finite"):
        settings = TrainSettings(epochs=1, batch=8, learning_rate=1e30)
        train(CONFIG, windows, windows[:0], settings, tmp_path)


def test_continued_training_starts_where_the_model_ended(windows, trained, tmp_path):
    """With a rate of next to nothing, the weights stay those of the model."""
    first = trained[0].model
    still = TrainSettings(epochs=1, batch=16, learning_rate=1e-12, weight_decay=0.0)
    on = train(CONFIG, windows, windows[:0], still, tmp_path, start=first).model
    for name, weights in first.weights.items():
        np.testing.assert_allclose(on.weights[name], weights, rtol=1e-5, atol=1e-7)
    with pytest.raises(ValueError, match="holds a run with other start"):
        train(CONFIG, windows, windows[:0], still, tmp_path)
    with pytest.raises(
        ValueError, match="`start` must have the configuration and classes of this training"
    ):
        train(
            CONFIG.replace(t_max=8.0), windows, windows[:0], still, tmp_path / "other", start=first
        )


@pytest.mark.parametrize("landmark", ["running", "regressor"])
def test_interrupted_and_resumed_equals_uninterrupted(landmark, windows, tmp_path):
    """Both are equal bit for bit.

    72 windows, 32 at a time, are 3 steps; 8 steps are two epochs and 2 steps of the next.
    """
    config = CONFIG.replace(landmark=landmark)
    settings = TrainSettings(epochs=50, iterations=8, batch=32, seed=5)
    whole = train(config, windows, windows[:6], settings, tmp_path / "whole")

    class InterruptedInEpoch2(Bar):
        def update(self, n=1, title=None):
            super().update(n, title)
            if self.done == 5:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(
            config, windows, windows[:6], settings, tmp_path / "cut", progress=InterruptedInEpoch2
        )
    steps = []
    resumed = train(
        config,
        windows,
        windows[:6],
        settings,
        tmp_path / "cut",
        report=lambda row: steps.append(row["iterations"]),
    )
    assert steps == [6, 8] and resumed.history == whole.history
    assert_equal(resumed.model, whole.model)
    if config.needs_regressor:
        # it starts from zero
        assert np.abs(whole.model.weights["regressor.heatmap.weight"]).max() > 0


def test_dropout_is_drawn_from_the_seed_and_an_epoch_may_end_in_a_single_window(windows, tmp_path):
    (tmp_path / "mine.py").write_text(OWN)
    settings = TrainSettings(epochs=2, batch=23, network=f"{tmp_path / 'mine.py'}:build")
    assert [settings.n_steps(n) for n in (24, 25, 1)] == [1, 2, 1]
    state = torch.get_rng_state()
    one = train(CONFIG, windows[:24], windows[:6], settings, tmp_path / "one")
    assert torch.equal(torch.get_rng_state(), state)
    torch.rand(3)
    assert_equal(
        train(CONFIG, windows[:24], windows[:6], settings, tmp_path / "two").model, one.model
    )


@pytest.fixture
def own(tmp_path):
    (tmp_path / "mine.py").write_text(OWN)
    return f"{tmp_path / 'mine.py'}:build"


def test_measuring_leaves_no_trace_in_a_network_and_drops_nothing_out(own, windows):
    """Statistics stay those of the training windows, and it goes on training. Scenes, too."""
    plain = CONFIG.replace(transform="none", polarity="split", landmark="center", bins=2)
    of_scenes = TrainSettings(network="map")
    cases = [
        (
            CONFIG,
            own,
            lambda pipeline: evaluate(pipeline, windows[:9], times_ms=(20,)).probabilities.tolist(),
        ),
        (CONFIG, own, ClassOfWindows(CONFIG, windows[:9], ONE_EPOCH, 2).validate),
        (plain, "map", ObjectsInScenes(plain, windows[:9], of_scenes, CLASSES).validate),
    ]
    for config, network, measure in cases:
        pipeline = new_pipeline(config, 2, 0, windows, network)
        with torch.no_grad():
            for module in pipeline.modules():
                if isinstance(module, torch.nn.BatchNorm2d):
                    module.running_mean.uniform_(-1, 1)
        pipeline.train()
        before = copy.deepcopy(pipeline.state_dict())
        found = measure(pipeline)
        assert measure(pipeline) == found and pipeline.training
        torch.testing.assert_close(dict(pipeline.state_dict()), dict(before), rtol=0, atol=0)
        assert measure(pipeline.eval()) == found and not pipeline.training


@pytest.mark.parametrize("averaging", [0.0, 0.6])
def test_what_is_held_out_is_measured_on_the_finished_model_and_changes_no_weight(
    averaging, own, windows, tmp_path
):
    settings = TrainSettings(epochs=2, batch=16, network=own, averaging=averaging, balance=True)
    seen = windows[:50]
    held_out = windows[50:]
    with_them = train(CONFIG, seen, held_out, settings, tmp_path / "with")
    without = train(CONFIG, seen, held_out[:0], settings, tmp_path / "without")
    assert_equal(with_them.model, without.model)
    finished = evaluate(pipeline_of(with_them.model), held_out)
    last = with_them.history[-1]
    assert (last["per_window"], last["per_recording"]) == (
        finished.per_window,
        finished.per_recording,
    )
    losses = -np.log(finished.complete[np.arange(len(held_out)), held_out.labels])
    of_classes = [losses[held_out.labels == label].mean() for label in (0, 1)]
    assert last["validation_loss"] == pytest.approx(np.mean(of_classes), abs=1e-5)


DEAD = """
from torch import nn

def build(channels, grid, n_classes):
    conv, last = nn.Conv2d(channels, 4, 3), nn.Linear(4, n_classes)
    nn.init.constant_(conv.bias, -1e3)
    return nn.Sequential(conv, nn.ReLU(), nn.AdaptiveAvgPool2d(1), nn.Flatten(), last)

def normed(channels, grid, n_classes):
    layers = [nn.BatchNorm2d(channels), nn.AdaptiveAvgPool2d(1), nn.Flatten()]
    return nn.Sequential(*layers, nn.Linear(channels, n_classes))
"""
"""Two networks. No gradient reaches a weight of the first: its logits are its last bias, whatever
is shown."""
SHARES = [0.25, 0.5, 0.75, 1, 1, 0.8535534, 0.5, 0.1464466]
"""Shares of the highest rate: 4 of 8 steps up, 4 along a cosine, 1/2 (1 + cos(pi k / 4))."""


def averages(values, share):
    """a <- k a + (1 - k) v; k is `share`, but at first only 2/11, 3/12, 4/13 ..."""
    average = values[0]
    for n, value in enumerate(values[1:], start=1):
        kept = min(share, (n + 1) / (n + 10))
        average = kept * average + (1 - kept) * value
    return average


def test_rates_decay_and_averages_are_those_of_their_equations(windows, tmp_path):
    """A weight without gradient only decays: w <- w (1 - rate decay); a bias does not."""
    (tmp_path / "dead.py").write_text(DEAD)
    settings = TrainSettings(epochs=4, batch=36, learning_rate=0.5, weight_decay=0.2, warm_up=0.5)
    settings = replace(settings, network=f"{tmp_path / 'dead.py'}:build")
    assert settings.n_iterations(len(windows)) == len(SHARES)

    def weights_after(name, **changes):
        run = train(CONFIG, windows, windows[:0], replace(settings, **changes), tmp_path / name)
        return {(w.ndim > 1, w.shape): w for w in run.model.weights.values()}

    first = weights_after("first", weight_decay=0.0)
    decay = np.cumprod([1 - 0.5 * 0.2 * share for share in SHARES])
    for name, changes, expected in (
        ("decayed", {}, decay[-1]),
        ("low average", {"averaging": 0.2}, averages(decay, 0.2)),
        ("high average", {"averaging": 0.99}, averages(decay, 0.99)),
        (
            "no warm-up",
            {"iterations": 3, "warm_up": 0.0},
            0.9 * 0.9 * (1 - 0.1 * 0.5),
        ),  # cos(0), cos(pi / 2)
    ):
        decayed = weights_after(name, **changes)
        for (is_weight, shape), w in first.items():
            if is_weight:
                np.testing.assert_allclose(decayed[is_weight, shape], expected * w, rtol=2e-6)
            elif shape == (4,):
                np.testing.assert_allclose(decayed[is_weight, shape], w, rtol=2e-6)


def test_batch_norms_have_the_average_of_their_statistics(windows, tmp_path):
    """With all windows in each batch, the average after k steps is m (1 - .9^k).

    Here m is the statistic of the batch.
    """
    (tmp_path / "dead.py").write_text(DEAD)
    network = f"{tmp_path / 'dead.py'}:normed"
    settings = TrainSettings(epochs=5, batch=len(windows), augmentation=None, network=network)
    means = {}
    for averaging in (0.0, 0.7):
        folder = tmp_path / str(averaging)
        changed = replace(settings, averaging=averaging)
        model = train(CONFIG, windows, windows[:0], changed, folder).model
        found = [w for name, w in model.weights.items() if name.endswith("running_mean")]
        assert len(found) == 1
        means[averaging] = found[0]
    shares = 1 - 0.9 ** np.arange(1, 6)
    assert np.abs(means[0.0]).max() > 0
    np.testing.assert_allclose(
        means[0.7], means[0.0] * averages(shares, 0.7) / shares[-1], rtol=1e-5, atol=1e-9
    )


@pytest.mark.parametrize("smoothing", [0.0, 0.2])
def test_loss_and_accuracy_of_an_epoch_are_means_over_its_windows(smoothing, windows, tmp_path):
    """This also holds where the last batch of the epoch is smaller.

    The logits are the same for all windows, so only the classes count.
    """
    (tmp_path / "dead.py").write_text(DEAD)
    labels = np.array([0] * 18 + [1] * 6)
    uneven = replace(windows, recordings=replace(windows.recordings, labels=labels))
    settings = TrainSettings(epochs=1, batch=50, learning_rate=1e-12, label_smoothing=smoothing)
    settings = replace(settings, network=f"{tmp_path / 'dead.py'}:build")
    run = train(CONFIG, uneven, uneven[:0], settings, tmp_path / "run")
    (logits,) = [w for w in run.model.weights.values() if w.shape == (2,)]
    told = logits - np.log(np.exp(logits).sum())
    target = np.eye(2) * (1 - smoothing) + smoothing / 2
    expected = 0.75 * -(target[0] @ told) + 0.25 * -(target[1] @ told)
    assert run.history[0]["loss"] == pytest.approx(expected, rel=1e-5)
    assert run.history[0]["training"] == pytest.approx((0.75, 0.25)[logits.argmax()])


def test_the_accuracy_of_an_epoch_is_of_the_windows_that_show_something(windows, tmp_path):
    """With the same answer to all: every window of one class is right, or every one of the other.
    Those that show nothing are neither."""
    (tmp_path / "dead.py").write_text(DEAD)
    settings = TrainSettings(epochs=1, batch=36, learning_rate=1e-12)
    settings = replace(settings, network=f"{tmp_path / 'dead.py'}:build")
    settings = replace(settings, augmentation=Augmentation(nothing=0.5))
    found = []
    for label in (0, 1):
        labels = np.full(24, label)
        of_one = replace(windows, recordings=replace(windows.recordings, labels=labels))
        run = train(CONFIG, of_one, of_one[:0], settings, tmp_path / str(label))
        found.append(run.history[0]["training"])
    assert sorted(found) == [0.0, 1.0]


def test_a_resumed_training_shows_what_was_done_before(windows, tmp_path):
    began = []

    class Noted(Bar):
        def __init__(self, total, title, *, done):
            super().__init__(total, title, done=done)
            began.append((done, total))

    settings = TrainSettings(epochs=2, batch=32)
    with pytest.raises(KeyboardInterrupt):
        train(CONFIG, windows, windows[:0], settings, tmp_path, progress=Noted, report=interrupt)
    train(CONFIG, windows, windows[:0], settings, tmp_path, progress=Noted)
    assert began == [(0, 6), (3, 6)]


def interrupt(row):
    raise KeyboardInterrupt


def test_a_run_with_other_settings_or_data_is_not_continued(windows, trained):
    moved = windows.recordings.x.copy()
    moved[7] ^= 1
    other = replace(windows, recordings=replace(windows.recordings, x=moved))
    for training, settings, classes, message in (
        (
            windows,
            replace(ONE_EPOCH, batch=8, seed=1),
            CLASSES,
            "holds a run with other batch, seed; remove it",
        ),
        (other, ONE_EPOCH, CLASSES, "holds a run with other data"),
        (windows, ONE_EPOCH, CLASSES[::-1], "holds a run with other classes; remove it"),
        (windows[:0], ONE_EPOCH, CLASSES, "`training` must hold at least one window"),
        (windows, ONE_EPOCH, ("a",), r"labels must be in \[0, 1\), one for each class, got 1"),
    ):
        with pytest.raises(ValueError, match=message):
            train(CONFIG, training, training[:0], settings, trained[1], classes=classes)


@pytest.mark.parametrize("side", ["training", "validation"])
@pytest.mark.parametrize("wrong", [-1, 2])
def test_a_label_of_no_class_is_named(side, wrong, windows, tmp_path):
    labels = windows.recordings.labels.copy()
    labels[5] = wrong
    other = replace(windows, recordings=replace(windows.recordings, labels=labels))
    sides = {"training": windows, "validation": windows, side: other}
    with pytest.raises(ValueError, match=rf"^labels must be in \[0, 2\), .*, got {wrong}$"):
        train(CONFIG, sides["training"], sides["validation"], ONE_EPOCH, tmp_path)


def test_a_start_or_a_teacher_of_other_windows_or_classes_is_refused(windows, trained, tmp_path):
    model = trained[0].model
    renamed = replace(model, classes=("a", "b"))
    small = model.config.replace(sensor=(20, 34))
    for more, message in (
        ({"start": renamed}, "`start` must have the configuration and classes .* classes a, b$"),
        ({"teachers": [model, renamed]}, "each `teacher` must have .* and classes a, b$"),
        (
            {"teachers": [replace(model, config=small)]},
            r"each `teacher` must have the sensor \(34, 34\) .*, got \(20, 34\) and classes",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            train(CONFIG, windows, windows[:0], ONE_EPOCH, tmp_path, **more)
    assert not list(tmp_path.iterdir())


def test_two_trainings_do_not_write_into_one_run_folder(windows, tmp_path):
    with (
        locked_folder(tmp_path / "run", "training.lock"),
        pytest.raises(BlockingIOError, match="at work there"),
    ):
        train(CONFIG, windows, windows[:0], ONE_EPOCH, tmp_path / "run")
    assert not (tmp_path / "run" / CHECKPOINT).exists()


@pytest.mark.parametrize("is_fast", [True, False])
@pytest.mark.parametrize("precision", ["float32", "bfloat16", "auto"])
def test_networks_multiply_in_16_bits_if_asked_or_where_it_is_fast(
    precision, is_fast, windows, tmp_path, monkeypatch
):
    class Stop(Exception):
        pass

    def loss_of(*_):
        seen.append(torch.is_autocast_enabled("cpu"))
        raise Stop

    seen = []
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(loop, "_is_fast_at_bfloat16", lambda device: is_fast)
    monkeypatch.setattr(ClassOfWindows, "loss", loss_of)
    with pytest.raises(Stop):
        settings = replace(ONE_EPOCH, precision=precision)
        train(CONFIG, windows, windows[:0], settings, tmp_path)
    assert seen == [precision == "bfloat16" or (precision == "auto" and is_fast)]


def test_what_decides_the_scenes_is_part_of_the_run(windows):
    data = TrainingData(CONFIG, CLASSES, windows, windows[:0])
    found = [
        identity_of(replace(data, scenes=scenes), ONE_EPOCH)["scenes"]
        for scenes in (None, CONFIG, CONFIG.replace(grid=(20, 20)))
    ]
    assert found[0] is None and found[1] is not None and found[1] != found[2]


def test_all_that_windows_show_is_in_their_checksum(windows, monkeypatch):
    """Also the last event of recordings that are read in several parts, those that are only held
    out, and the outlines of objects."""
    monkeypatch.setattr(run_folder, "CHUNK", 1_000)
    made = windows.recordings
    outlines = np.zeros((len(made), 2, 4, 2), np.float32)
    outlined_us = np.full(len(made), 9)

    def changed(name, array):
        other = array.copy()
        other[-1] += 1
        return replace(windows, recordings=replace(made, **{name: other}))

    with_outlines = replace(
        windows, recordings=replace(made, outlines=outlines, outlined_us=outlined_us)
    )
    moved = replace(
        windows, recordings=replace(made, outlines=outlines + 1, outlined_us=outlined_us)
    )
    others = [changed("t", made.t), with_outlines, moved]
    checksums = [windows_checksum(one, one[:0]) for one in (windows, *others)]
    checksums.append(windows_checksum(windows[:3], windows[3:5]))
    checksums.append(windows_checksum(windows[:3], others[0][3:5]))
    assert len(set(checksums)) == len(checksums)
    assert windows_checksum(windows, windows[:0]) == checksums[0]


def test_other_windows_to_validate_on_are_another_run(windows, tmp_path):
    """Though all recordings are the same, and as many windows are held out."""
    train(CONFIG, windows[:40], windows[40:50], ONE_EPOCH, tmp_path)
    with pytest.raises(ValueError, match="holds a run with other data; remove it"):
        train(CONFIG, windows[:40], windows[50:60], ONE_EPOCH, tmp_path)


@pytest.mark.parametrize("more", ["start", "teachers", "motions"])
def test_what_is_for_classes_of_windows_is_refused_for_scenes(more, windows, tmp_path):
    plain = CONFIG.replace(transform="none", polarity="split", landmark="center", bins=2)
    settings = TrainSettings(network="map", everywhere=True)
    network = build_network("conv4", plain.channels, plain.grid, 2)
    model = Model.from_torch(network, plain, CLASSES)
    given = {"start": model, "teachers": [model], "motions": object()}[more]
    with pytest.raises(ValueError, match="are for classes of windows; `everywhere` trains on"):
        train(plain, windows, windows[:0], settings, tmp_path, **{more: given})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("column", ["t", "x", "y", "p", "labels", "recording", "start_us"])
def test_whatever_differs_in_the_data_is_another_run(column, windows, trained):
    """The data differ in one number."""
    columns = {name: getattr(windows, name).copy() for name in ("recording", "start_us")}
    of_recordings = {
        name: getattr(windows.recordings, name).copy() for name in ("t", "x", "y", "p", "labels")
    }
    (columns | of_recordings)[column][9] ^= 1
    other = replace(windows, **columns, recordings=replace(windows.recordings, **of_recordings))
    with pytest.raises(ValueError, match="holds a run with other data"):
        train(CONFIG, other, other[:0], ONE_EPOCH, trained[1])


def test_a_damaged_checkpoint_or_one_of_another_release_is_refused(tmp_path):
    """Any bit: `torch.load` alone does not compare checksums."""
    path = tmp_path / CHECKPOINT
    identity = {"seed": 0, "format": FORMAT}
    save_checkpoint(tmp_path, {"identity": identity, "history": [], "weights": torch.ones(500)})
    content = path.read_bytes()
    at = content.index(torch.ones(500).numpy().tobytes()) + 1_000
    for damage in (content[:-9], content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]):
        path.write_bytes(damage)
        with pytest.raises(
            ValueError, match=r"not a readable checkpoint.*remove it to start again"
        ):
            load_checkpoint(tmp_path, identity)
    for damage in damaged_bytes(content, 100, seed=0):
        path.write_bytes(damage)
        with pytest.raises(ValueError, match=rf"^{path} is not a readable checkpoint[^\n]*$"):
            load_checkpoint(tmp_path, identity)
    path.unlink()
    os.mkfifo(path)  # a link to one, too: nothing is waited for
    with pytest.raises(OSError, match="a pipe or a device, expected a regular file"):
        load_checkpoint(tmp_path, identity)
    path.unlink()
    save_checkpoint(tmp_path, {"identity": identity | {"format": 2}, "history": []})
    with pytest.raises(
        ValueError,
        match=r"checkpoint.pt was written by another release .* remove it to start again",
    ):
        load_checkpoint(tmp_path, identity)


def test_the_fewer_windows_the_more_epochs():
    """A training has 4,000 steps, or 20 epochs if these are more steps.

    An epoch of few windows shows them several times, so that it has fifty steps.
    """
    assert [settings_for(CONFIG, n).epochs for n in (100_000, 1_000, 9)] == [20, 122, 80]
    assert [settings_for(CONFIG, n).passes for n in (100_000, 1_000, 9)] == [1, 1, 44]
    assert settings_for(CONFIG, 9, epochs=3).epochs == 3


@pytest.mark.parametrize(("balance", "expected"), [(True, [36, 36]), (False, [54, 18])])
def test_each_epoch_shows_all_windows_in_an_order_and_with_augmentation_of_its_own(
    balance, expected, windows
):
    labels = np.array([0] * 18 + [1] * 6)
    windows = replace(windows, recordings=replace(windows.recordings, labels=labels))
    settings = TrainSettings(batch=8, balance=balance)
    first = list(batches_of(CONFIG, windows, settings, 0))
    twice = batches_of(CONFIG, windows, replace(settings, passes=2), 0)
    shown = np.concatenate([some.labels for some, _ in twice])
    assert np.bincount(shown).tolist() == [2 * n for n in expected]
    again = list(batches_of(CONFIG, windows, settings, 0))
    second = list(batches_of(CONFIG, windows, settings, 1))
    assert np.bincount(np.concatenate([some.labels for some, _ in first])).tolist() == expected
    orders = [
        np.concatenate([some.recording for some, _ in epoch]).tolist()
        for epoch in (first, again, second)
    ]
    seeds = [
        np.concatenate([draws.seed for _, draws in epoch]).tolist()
        for epoch in (first, again, second)
    ]
    assert orders[0] == orders[1] != orders[2] and seeds[0] == seeds[1] != seeds[2]


def test_a_balanced_epoch_shows_of_a_class_all_or_another_part():
    """A rare class in rounds, all of it in each; of a frequent one, not always the same.

    Which class is shown once more differs, too.
    """
    labels = np.array([0] * 50 + [1] * 6 + [2] * 5)
    counts = []
    once_more = set()
    for epoch in range(12):
        order = balanced_order(labels, np.random.default_rng(epoch))
        counts.append(np.bincount(order, minlength=len(labels)))
        of_classes = [counts[-1][labels == label] for label in range(3)]
        shown = [int(some.sum()) for some in of_classes]
        assert sorted(shown) == [20, 20, 21]
        once_more.add(shown.index(21))
        assert max(np.ptp(some) for some in of_classes) <= 1
    assert once_more == {0, 1, 2}
    # .6^12 of 50 are never shown: 1 in 9 times one
    assert (np.sum(counts, axis=0) > 0).sum() >= len(labels) - 2


class Teacher:
    """Says the same of all windows, and keeps how they were augmented."""

    def __init__(self, config, row):
        self.config = config
        self._row = row

    def __call__(self, windows, draws):
        self.draws = draws
        return torch.tensor([self._row] * len(windows))


def test_a_teacher_of_images_of_times_is_shown_events_in_one_pixel_each(windows):
    """The teacher was trained so. Its student's events may lie between pixels."""
    images = TNTConfig(
        sensor=CONFIG.sensor, window_us=CONFIG.window_us, representation="count_time"
    )
    draws = Augmentation().draw(windows[:4], CONFIG, np.random.default_rng(1))
    own = Augmentation().draw(windows[:4], images, np.random.default_rng(1))
    objective = ClassOfWindows(CONFIG, windows[:0], ONE_EPOCH, 2)
    teacher_of_images = Teacher(images, [0.0, 0.0])
    teacher = Teacher(CONFIG, [0.0, 0.0])
    objective._teachers = [teacher_of_images, teacher]
    objective._targets(windows[:4], draws)
    shown = teacher_of_images.draws
    assert teacher.draws is draws and shown.sensor == own.sensor == CONFIG.sensor != draws.sensor
    np.testing.assert_allclose(shown.matrix, own.matrix)


def test_half_of_the_target_is_what_the_teachers_say_on_average(windows, trained, tmp_path):
    """Where nothing is shown, the target stays.

    A run with a teacher is another run than one without.
    """
    draws = Augmentation(nothing=0.5).draw(windows[:4], CONFIG, np.random.default_rng(1))
    draws.content[:] = 0, 1, 0, 2
    some = windows[
        np.concatenate([np.flatnonzero(windows.labels == label)[:2] for label in (0, 1)])
    ]
    objective = ClassOfWindows(CONFIG, windows[:0], ONE_EPOCH, 2)
    objective._teachers = [Teacher(CONFIG, [0.0, 0.0]), Teacher(CONFIG, [np.log(3), 0.0])]
    found = objective._targets(some, draws)
    np.testing.assert_allclose(
        found, [[0.8125, 0.1875], [0.5, 0.5], [0.3125, 0.6875], [0.5, 0.5]], atol=1e-6
    )
    model = trained[0].model
    taught = train(CONFIG, windows, windows[:0], ONE_EPOCH, tmp_path, teachers=[model]).model
    with pytest.raises(AssertionError):
        assert_equal(taught, model)
    for teachers in ([], [replace(model, config=CONFIG.replace(t_max=3.0))]):
        with pytest.raises(ValueError, match="other teachers; remove it"):
            train(CONFIG, windows, windows[:0], ONE_EPOCH, tmp_path, teachers=teachers)
    with pytest.raises(
        ValueError,
        match=r"each `teacher` must have the sensor \(34, 34\) and the classes across, down, got",
    ):
        other = replace(model, classes=("a", "b"))
        train(CONFIG, windows, windows[:0], ONE_EPOCH, tmp_path / "other", teachers=[other])


def test_the_model_has_the_average_of_the_weights_of_all_steps(windows, tmp_path):
    """The average is w <- a w + (1 - a) w', also of a batch norm's statistics.

    It is the same after an interruption.
    """
    settings = replace(ONE_EPOCH, averaging=0.9, epochs=2, network="conv4")
    whole = train(CONFIG, windows, windows[:0], settings, tmp_path / "whole").model
    last = train(
        CONFIG, windows, windows[:0], replace(settings, averaging=0.0), tmp_path / "last"
    ).model
    steps = settings.n_iterations(len(windows))
    assert steps > 4 and any(
        not np.array_equal(w, last.weights[name]) for name, w in whole.weights.items()
    )

    def stop(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(CONFIG, windows, windows[:0], settings, tmp_path / "again", report=stop)
    assert_equal(train(CONFIG, windows, windows[:0], settings, tmp_path / "again").model, whole)
