"""A trained model's probabilities, on held-out windows and where nothing is there."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made import events_of

torch = pytest.importorskip("torch")

from async_tnt.networks.models.compiled import CompiledClassifier  # noqa: E402
from async_tnt.networks.models.model import Model  # noqa: E402
from async_tnt.streaming.processor import Processor  # noqa: E402
from async_tnt.training import evaluation as evaluation_module  # noqa: E402
from async_tnt.training.augment import KINDS as KINDS_OF_NOTHING  # noqa: E402
from async_tnt.training.augment import ONE_POLARITY, Augmentation  # noqa: E402
from async_tnt.training.batches import BatchVolumes  # noqa: E402
from async_tnt.training.evaluation import (  # noqa: E402
    Evaluation,
    class_probabilities,
    evaluate,
)
from async_tnt.training.fitting import fit, moments_ms  # noqa: E402
from async_tnt.training.loop import train  # noqa: E402
from async_tnt.training.pipeline import pipeline_of  # noqa: E402
from async_tnt.training.recordings import Recordings  # noqa: E402
from async_tnt.training.settings import TrainSettings  # noqa: E402
from async_tnt.training.temperature import calibrated, fit_temperature, softened  # noqa: E402
from async_tnt.training.training_data import TrainingData  # noqa: E402
from async_tnt.training.windows import make_windows  # noqa: E402
from async_tnt.volume.config import TNTConfig  # noqa: E402
from experiments.nothing import KINDS, on_sensor  # noqa: E402

CONFIG = TNTConfig(transform="none", landmark="center", bins=3, window_us=100_000)
CLASSES = ("spot", "ring")


def shapes(n, seed):
    """A spot, and a ring that fills the sensor, with a few stray events."""
    rng = np.random.default_rng(seed)
    recordings = []
    for k in range(n):
        n_shape = rng.integers(150, 400)
        n_stray = rng.integers(0, 60)
        radius = (13.0 if k % 2 else 4.0) + rng.normal(0, 1.5, n_shape)
        angle = rng.uniform(0, 2 * np.pi, n_shape)
        x = radius * np.cos(angle) + rng.integers(14, 20)
        y = radius * np.sin(angle) + rng.integers(14, 20)
        x = np.concatenate([np.clip(x, 0, 33), rng.integers(0, 34, n_stray)]).astype(int)
        y = np.concatenate([np.clip(y, 0, 33), rng.integers(0, 34, n_stray)]).astype(int)
        t = np.sort(rng.integers(0, 100_000, n_shape + n_stray))
        recordings.append(events_of(t, x, y, rng.integers(0, 2, n_shape + n_stray)))
    return make_windows(Recordings.from_events(recordings, np.arange(n) % 2), CONFIG.window_us)


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Trained with and without windows that show nothing."""
    made = {}
    for nothing in (0.0, 0.2):
        settings = TrainSettings(epochs=6, batch=16, augmentation=Augmentation(nothing=nothing))
        folder = tmp_path_factory.mktemp("run")
        data = TrainingData(CONFIG, CLASSES, shapes(400, 0), shapes(60, 1))
        made[nothing] = train(data, settings, folder).model
    return made


def test_no_class_is_decided_with_confidence_where_nothing_is_there(models):
    rng = np.random.default_rng(3)
    sure = {}
    for nothing, model in models.items():
        assert evaluate(pipeline_of(model), shapes(60, 2)).per_window >= 0.95
        model, _ = calibrated(model, evaluate(pipeline_of(model), shapes(60, 1)).temperature)
        for kind in ("noise", "noise of one polarity", "pairs"):
            decisions = []
            for _ in range(40):
                processor = Processor(model, start_us=0)
                t = np.sort(rng.integers(0, CONFIG.window_us - 1, rng.integers(150, 450)))
                x, y, p = KINDS[kind](t / CONFIG.window_us, CONFIG.sensor[0], rng)
                processor.push(on_sensor(t, x, y, p, CONFIG.sensor))
                decisions.append(processor.fire().probability >= 0.9)
            sure[kind, nothing] = np.mean(decisions)
    assert all(share <= 0.05 for (_, nothing), share in sure.items() if nothing), sure
    assert np.mean([share for (_, nothing), share in sure.items() if not nothing]) > 0.3, sure


def test_what_shows_nothing_is_counted_in_no_class(tmp_path):
    """With all windows scattered, the loss is that of an answer which says nothing.

    No accuracy is then claimed.
    """
    settings = TrainSettings(
        epochs=2, batch=16, augmentation=Augmentation(nothing=1.0), label_smoothing=0.0
    )
    data = TrainingData(CONFIG, CLASSES, shapes(64, 0), shapes(8, 1))
    row = train(data, settings, tmp_path).history[-1]
    assert row["loss"] == pytest.approx(np.log(2), abs=0.01) and row["training"] == 0.0


def test_a_temperature_makes_nine_of_ten_right_at_nine_tenths():
    rng = np.random.default_rng(0)
    truth = rng.dirichlet((1, 1, 1), 40_000)
    labels = (rng.random(40_000)[:, None] > truth.cumsum(1)).sum(1)
    told = softened(truth, 1 / 2.5)  # far too sure
    temperature = fit_temperature(told, labels)
    assert temperature == pytest.approx(2.5, rel=0.05)
    found = Evaluation(
        SimpleNamespace(labels=labels, stop=None), (100.0,), told[np.newaxis], {"scattered": told}
    )
    softer = found.at_temperature(temperature)
    assert found.calibration_error > 0.15 and softer.calibration_error < 0.01
    assert found.sure_of_nothing["scattered"] > softer.sure_of_nothing["scattered"]
    assert fit_temperature(softened(truth, 4), labels) == pytest.approx(1 / 4, rel=0.05)
    # A temperature is at least 1/5, and at most 5.
    assert fit_temperature(softened(truth, 9), labels) == pytest.approx(1 / 5)
    assert fit_temperature(np.array([[1.0, 0.0]] * 9), np.ones(9, int)) == pytest.approx(5)


def test_the_decisions_of_all_moments_are_compared_with_their_own_windows():
    """Three windows at two moments, always right with a probability of .85: .15 too unsure. Nothing
    is decided surely from .9 on."""
    right = np.array([[0.85, 0.15], [0.85, 0.15], [0.15, 0.85]])
    nothing = np.array([[0.9, 0.1], [0.89, 0.11], [0.05, 0.95], [0.5, 0.5]])
    labels = np.array([0, 0, 1])
    found = Evaluation(
        SimpleNamespace(labels=labels, stop=None),
        (50.0, 100.0),
        np.stack([right, right]),
        {"noise": nothing},
    )
    assert found.calibration_error == pytest.approx(0.15)
    assert found.temperature == fit_temperature(np.tile(right, (2, 1)), np.tile(labels, 2)) < 1
    assert found.sure_of_nothing == {"noise": 0.5}
    assert found.against_time == {50.0: 1.0, 100.0: 1.0}


def test_windows_of_a_number_of_events_are_not_compared_with_time():
    windows = SimpleNamespace(labels=np.array([0]), stop=np.array([7]))
    found = Evaluation(windows, (100.0,), np.array([[[0.9, 0.1]]]), {})
    assert found.against_time == {} and found.per_window == 1.0


def test_without_windows_nothing_is_evaluated(models):
    with pytest.raises(ValueError, match="`windows` must hold at least one window, got none"):
        evaluate(pipeline_of(models[0.0]), shapes(2, 0)[:0])


@pytest.mark.parametrize("kind", KINDS_OF_NOTHING.values(), ids=KINDS_OF_NOTHING)
def test_nothing_is_shown_otherwise_in_each_window_and_always_the_same(kind, monkeypatch):
    """Also in later batches, here of three windows, whose events are those of the first ones."""
    monkeypatch.setattr(evaluation_module, "BATCH", 3)
    seen = []
    places = set()

    class Watching:
        """A pipeline that keeps the volumes of each call."""

        config = CONFIG
        training = False
        volumes = BatchVolumes(CONFIG)

        def eval(self):
            pass

        def train(self, training):
            pass

        def __call__(self, windows, draws):
            seen.extend(volume.tobytes() for volume in self.volumes(windows, draws))
            places.update(place.tobytes() for place in draws.place)
            return torch.zeros(len(windows), 2)

    same = shapes(1, 0)[np.zeros(9, int)]
    for _ in range(2):
        class_probabilities(Watching(), same, content=kind)
    assert seen[:9] == seen[9:] and len(set(seen)) == 9
    assert len(places) == (2 if kind == ONE_POLARITY else 9)  # all ON or all OFF, or its own share


def test_a_calibrated_model_decides_the_same(models):
    model = models[0.0]
    calibrated_model, temperature = calibrated(model, 2.5)
    assert temperature == 2.5 and calibrated_model.classes == model.classes
    *others, last = model.network["classifier"]
    # a layer that has the same weights
    twice = {"classifier": [*others, last | {"name": "unused"}, last]}
    assert calibrated(replace(model, network=twice), 2.5)[1] == 1.0
    volumes = np.random.default_rng(0).normal(size=(50, *model.config.shape)).astype(np.float32)
    for volume in volumes:
        logits = np.array(CompiledClassifier(model)(volume))
        softer = np.array(CompiledClassifier(calibrated_model)(volume))
        np.testing.assert_allclose(softer, logits / 2.5, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("end", "expected"),
    [
        ([torch.nn.Conv2d(3, 2, 34)], 2.5),
        ([torch.nn.Flatten(), torch.nn.Linear(3 * 34 * 34, 2)], 2.5),
        ([torch.nn.Conv2d(3, 2, 5), torch.nn.AdaptiveAvgPool2d(1)], 1.0),
    ],
    ids=["convolution", "dense", "mean"],
)
def test_a_network_is_calibrated_if_it_ends_in_weights(end, expected):
    """Any other stays as it is."""
    model = Model.from_torch(torch.nn.Sequential(*end), CONFIG, CLASSES)
    softer, temperature = calibrated(model, 2.5)
    volume = np.random.default_rng(0).normal(size=CONFIG.shape).astype(np.float32)
    logits, softer_logits = (np.array(CompiledClassifier(made)(volume)) for made in (model, softer))
    assert temperature == expected
    np.testing.assert_allclose(softer_logits, logits / temperature, rtol=1e-5, atol=1e-6)


ENDS_IN_A_MEAN = """
from torch import nn

def build(channels, grid, n_classes):
    return nn.Sequential(nn.Conv2d(channels, n_classes, 5), nn.AdaptiveAvgPool2d(1), nn.Flatten())
"""
"""A user's own network, whose last layer has no weights."""


@pytest.mark.parametrize("is_calibrated", [True, False])
def test_the_record_of_a_model_tells_what_the_saved_model_does(is_calibrated, tmp_path):
    """The record is of the held-out windows after the calibration, which changes the model.

    A network that cannot be calibrated stays as it is.
    """
    (tmp_path / "own.py").write_text(ENDS_IN_A_MEAN)
    network = "thesis" if is_calibrated else f"{tmp_path / 'own.py'}:build"
    validation = shapes(40, 1)
    data = TrainingData(CONFIG, CLASSES, shapes(60, 0), validation)
    settings = TrainSettings(
        network=network, epochs=1, batch=16, augmentation=Augmentation(nothing=0.0)
    )
    data = replace(data, tests={"other day": (shapes(20, 2), {"left_out": ["spot/a.npz: torn"]})})
    fitted = fit(data, settings, tmp_path / "first")
    model = fitted.model
    found = evaluate(pipeline_of(model), validation, times_ms=moments_ms(model)).to_dict()
    told = model.record["validation"]
    assert (model.record["temperature"] != 1) == is_calibrated and told["calibration_error"] > 0
    assert told["calibration_error"] == pytest.approx(found["calibration_error"], abs=1e-4)
    one_window = 1 / len(validation)  # rounding may make one of them sure
    assert told["sure_of_nothing"] == pytest.approx(found["sure_of_nothing"], abs=1.1 * one_window)
    assert told["confusion"] == found["confusion"]
    # every tenth of 100 ms
    assert list(told["against_time_ms"]) == [str(10 * k) for k in range(1, 11)]
    tested = fitted.tested(data).model.record["other day"]
    assert (tested["windows"], tested["left_out"]) == (20, ["spot/a.npz: torn"])
    assert list(tested["against_time_ms"]) == list(told["against_time_ms"])
    assert fitted.scores["window_confusion"] == told["confusion"]


def test_the_record_of_a_continued_training_keeps_that_of_its_start(tmp_path):
    data = TrainingData(CONFIG, CLASSES, shapes(30, 0), shapes(10, 1), record={"source": "made"})
    settings = TrainSettings(epochs=2, batch=15, seed=3)
    first = fit(data, settings, tmp_path / "first").with_record(command="the first").model
    assert (first.record["epochs"], first.record["iterations"]) == (2, 4)
    assert (first.record["network"], first.record["data"]) == ("thesis", {"source": "made"})
    assert "started_from" not in first.record
    again = fit(data, replace(settings, epochs=1, seed=4), tmp_path / "again", start=first).model
    assert again.record["network"] == "that of the model it started from"
    assert (again.record["seed"], again.record["epochs"]) == (4, 1)
    began = again.record["started_from"]
    assert (began["seed"], began["epochs"], began["command"]) == (3, 2, "the first")
    assert began["validation"] == first.record["validation"]
    assert "versions" not in began
