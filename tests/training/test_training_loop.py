"""The loop learns, says what it did, and an interruption leaves no trace in the weights."""

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from async_tnt.config import TNTConfig  # noqa: E402
from async_tnt.events import EVENT_DTYPE  # noqa: E402
from async_tnt.networks.model import load_model  # noqa: E402
from async_tnt.networks.torch_modules import torch_classifier  # noqa: E402
from async_tnt.progress import Bar  # noqa: E402
from async_tnt.training.augment import Augmentation  # noqa: E402
from async_tnt.training.batches import BatchVolumes  # noqa: E402
from async_tnt.training.checkpoint import CHECKPOINT, FORMAT, load_checkpoint, save_checkpoint  # noqa: E402
from async_tnt.training.evaluation import evaluate  # noqa: E402
from async_tnt.training.loop import train  # noqa: E402
from async_tnt.training.pipeline import Pipeline, export, input_scale, new_pipeline  # noqa: E402
from async_tnt.training.settings import TrainSettings  # noqa: E402
from async_tnt.training.windows import CLASSES, Recordings, make_windows  # noqa: E402

CONFIG = TNTConfig(landmark="running", t_max=2.0)


def bars(n=24, seed=0):
    """Recordings of two classes that anyone can tell apart: bars along x, and along y."""
    rng = np.random.default_rng(seed)
    recordings, labels = [], []
    for k in range(n):
        events = np.empty(600, EVENT_DTYPE)
        events["t"] = np.sort(rng.integers(0, 315_000, 600))
        along, across = rng.integers(8, 26, 600), rng.integers(15, 19, 600)
        events["x"], events["y"] = (along, across) if k % 2 else (across, along)
        events["p"] = rng.integers(0, 2, 600)
        recordings.append(events)
        labels.append(k % 2)
    return make_windows(Recordings.from_events(recordings, labels), CONFIG.window_us)


def weights_equal(a, b):
    return all(np.array_equal(a.weights[name], b.weights[name]) for name in a.weights)


@pytest.fixture(scope="module")
def windows():
    return bars()


def test_it_learns_what_is_easy(windows, tmp_path):
    settings = TrainSettings(epochs=4, batch=8, augmentation=Augmentation(rotation_deg=5.0))
    result = train(CONFIG, windows, bars(8, seed=1), settings, tmp_path)
    assert result.history[-1]["loss"] < 0.5 * result.history[0]["loss"]
    assert result.history[-1]["per_window"] == 1.0
    assert json.loads((tmp_path / "history.json").read_text())["history"] == result.history


class Killed(Exception):
    pass


def test_interrupted_and_resumed_equals_uninterrupted(windows, tmp_path):
    settings = TrainSettings(epochs=3, batch=16, seed=5)
    whole = train(CONFIG, windows, windows[:6], settings, tmp_path / "whole")

    class KilledInEpoch2(Bar):
        def update(self, n=1, title=None):
            super().update(n, title)
            if self.done == 8:  # of 5 steps an epoch
                raise Killed

    with pytest.raises(Killed):
        train(CONFIG, windows, windows[:6], settings, tmp_path / "cut", progress=KilledInEpoch2)
    epochs_run = []
    resumed = train(
        CONFIG,
        windows,
        windows[:6],
        settings,
        tmp_path / "cut",
        report=lambda row: epochs_run.append(row["epoch"]),
    )
    assert epochs_run == [2, 3]
    assert weights_equal(resumed.last, whole.last) and weights_equal(resumed.best, whole.best)
    assert resumed.history == whole.history
    other = train(CONFIG, windows, windows[:6], TrainSettings(epochs=3, batch=16, seed=6), tmp_path / "other")
    assert not weights_equal(other.last, whole.last)


def test_a_finished_run_gives_its_weights_again(windows, tmp_path):
    settings = TrainSettings(epochs=1, batch=16)
    first = train(CONFIG, windows, windows[:0], settings, tmp_path)
    again = train(CONFIG, windows, windows[:0], settings, tmp_path)
    assert weights_equal(first.last, again.last) and weights_equal(first.last, first.best)


def test_a_run_folder_of_other_settings_or_data_is_refused(windows, tmp_path):
    settings = TrainSettings(epochs=1, batch=16)
    train(CONFIG, windows, windows[:0], settings, tmp_path)
    with pytest.raises(ValueError, match=r"holds a run with other batch, seed; give another .* delete the folder"):
        train(CONFIG, windows, windows[:0], TrainSettings(epochs=1, batch=8, seed=1), tmp_path)
    with pytest.raises(ValueError, match="holds a run with other t_max"):
        train(CONFIG.replace(t_max=8.0), windows, windows[:0], settings, tmp_path)
    with pytest.raises(ValueError, match="holds a run with other data"):
        train(CONFIG, bars(seed=3), windows[:0], settings, tmp_path)
    state = torch.load(tmp_path / CHECKPOINT)
    torch.save({**state, "identity": json.dumps({**json.loads(state["identity"]), "format": 2})}, tmp_path / CHECKPOINT)
    with pytest.raises(ValueError, match=r"checkpoint.pt was written by another release .* remove it to start again"):
        train(CONFIG, windows, windows[:0], settings, tmp_path)
    (tmp_path / CHECKPOINT).write_bytes(b"damaged")
    with pytest.raises(ValueError, match=r"not a readable checkpoint .* remove it"):
        train(CONFIG, windows, windows[:0], settings, tmp_path)


def test_a_damaged_checkpoint_is_not_believed(tmp_path):
    """Any bit: `torch.load` alone takes weights as they come."""
    identity = json.dumps({"config": {}, "settings": {}, "format": FORMAT})
    save_checkpoint(tmp_path, {"identity": identity, "history": [], "weights": torch.ones(500)})
    content = (tmp_path / CHECKPOINT).read_bytes()
    rng, n_refused = np.random.default_rng(0), 0
    for at in rng.integers(0, len(content), 300).tolist():
        damaged = bytearray(content)
        damaged[at] ^= 1 << int(rng.integers(8))
        (tmp_path / CHECKPOINT).write_bytes(damaged)
        try:
            state = load_checkpoint(tmp_path, identity)
        except ValueError as error:
            assert "not a readable checkpoint" in str(error)
            n_refused += 1
        else:  # padding, or what nobody reads
            assert torch.equal(state["weights"], torch.ones(500)) and state["identity"] == identity
    assert n_refused > 100


def test_the_exported_network_takes_raw_volumes(windows, tmp_path):
    """conv1 absorbs the scale: logits are those of the scaled input, and survive the file."""
    pipeline = new_pipeline(CONFIG, len(CLASSES), 1, windows).eval()
    volumes = torch.from_numpy(BatchVolumes(CONFIG)(windows[:5]).copy())
    with torch.no_grad():
        scaled = pipeline(windows[:5])
        export(pipeline, CLASSES, {"seed": 1}).save(tmp_path / "m.safetensors")
        model = load_model(tmp_path / "m.safetensors")
        raw = torch_classifier(model)(volumes)
        unscaled = pipeline.classifier(volumes)
    torch.testing.assert_close(raw, scaled, atol=1e-5, rtol=1e-4)
    assert (scaled - unscaled).abs().max() > 1e-3
    assert model.record == {"seed": 1}


def test_the_scale_makes_the_mean_square_one(windows):
    volumes = BatchVolumes(CONFIG)(windows).astype(np.float64)
    assert not np.isclose(np.square(volumes).mean(), 1.0, rtol=0.3)
    assert np.isclose(np.square(volumes * input_scale(CONFIG, windows, n=len(windows))).mean(), 1.0, rtol=1e-5)


def test_the_first_weights_depend_on_the_seed_alone(windows):
    state = torch.get_rng_state()
    first, torch_after = new_pipeline(CONFIG, 10, 3, windows).classifier, torch.get_rng_state()
    torch.manual_seed(99)
    again, other = (new_pipeline(CONFIG, 10, seed, windows).classifier for seed in (3, 4))
    assert torch.equal(state, torch_after)
    assert torch.equal(first.fc1.weight, again.fc1.weight)
    assert not torch.equal(first.fc1.weight, other.fc1.weight)


def test_iterations_end_the_training_within_an_epoch(windows, tmp_path):
    """72 windows, 16 at a time, are 5 steps; 7 steps are an epoch and 2 steps of the next."""
    settings = TrainSettings(epochs=50, iterations=7, batch=16)
    assert settings.n_epochs(len(windows)) == 2
    steps = []

    class Counted(Bar):
        def update(self, n=1, title=None):
            steps.append(title)

    result = train(CONFIG, windows, windows[:6], settings, tmp_path, progress=Counted)
    assert steps == ["epoch 1/2"] * 5 + ["epoch 2/2"] * 2
    assert [row["iterations"] for row in result.history] == [5, 7]


def test_products_in_16_bits_learn_as_well(windows, tmp_path):
    settings = TrainSettings(epochs=3, batch=8, augmentation=None, precision="bfloat16")
    result = train(CONFIG, windows, bars(8, seed=1), settings, tmp_path)
    assert result.history[-1]["per_window"] == 1.0
    assert all(w.dtype == np.float32 for w in result.last.weights.values())
    exact = train(CONFIG, windows, windows[:0], TrainSettings(epochs=3, batch=8, augmentation=None), tmp_path / "32")
    assert not weights_equal(result.last, exact.last)


def test_no_windows_are_refused(windows, tmp_path):
    with pytest.raises(ValueError, match="`training` must hold at least one window"):
        train(CONFIG, windows[:0], windows, TrainSettings(), tmp_path)


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("epochs", 0, "at least 1, got 0"),
        ("iterations", 0, "at least 1, got 0"),
        ("precision", "float16", "one of float32, bfloat16, got 'float16'"),
        ("learning_rate", 0.0, "positive, got 0.0"),
        ("label_smoothing", 1.0, r"in \[0, 1\), got 1.0"),
    ],
)
def test_settings_out_of_range_are_refused(name, value, text):
    with pytest.raises(ValueError, match=rf"`{name}` must be .*{text}"):
        TrainSettings(**{name: value})


class CountsOn(torch.nn.Module):
    """A network whose decision is known: class 1 where the volume's sum is positive."""

    def __init__(self):
        super().__init__()
        self.unused = torch.nn.Parameter(torch.zeros(1))

    def forward(self, volume):
        total = volume.sum((1, 2, 3))
        return torch.stack([torch.zeros_like(total), total], dim=1)


def test_evaluation_by_hand():
    """Recording 0: two saccades ON, weakly, one OFF, strongly; recording 1: OFF throughout."""

    def recording(*saccades):
        rows = []
        for k, (n, p) in enumerate(saccades):
            rows += [(105_000 * k + 1_000 * (i + 40), 16, 16, p) for i in range(n)]
        return np.array(rows, EVENT_DTYPE)

    recordings = Recordings.from_events([recording((1, 1), (1, 1), (9, 0)), recording((3, 0), (3, 0), (3, 0))], [1, 0])
    config = TNTConfig(transform="none")
    found = evaluate(Pipeline(config, CountsOn()), make_windows(recordings, 105_000), times_ms=(10, 100))
    assert found.per_window == pytest.approx(5 / 6)
    np.testing.assert_array_equal(found.confusion, [[3, 0], [1, 2]])
    assert (found.n_windows, found.n_recordings) == (6, 2)
    assert found.per_recording == 0.5  # mean of .731, .731, .0001 for class 1 is below a half
    assert found.against_time == {10.0: 0.5, 100.0: pytest.approx(5 / 6)}  # nothing yet: class 0
    assert found.to_dict()["against_time_ms"] == {"10": 0.5, "100": 0.83333}


def test_training_on_starts_where_the_model_ended(windows, tmp_path):
    """With a rate of next to nothing, the weights stay those of the model."""
    first = train(CONFIG, windows, windows[:0], TrainSettings(epochs=1, batch=16), tmp_path / "first").last
    still = TrainSettings(epochs=1, batch=16, learning_rate=1e-12, weight_decay=0.0)
    on = train(CONFIG, windows, windows[:0], still, tmp_path / "on", start=first).last
    for name, weights in first.weights.items():
        np.testing.assert_allclose(on.weights[name], weights, rtol=1e-5, atol=1e-7)
    fresh = train(CONFIG, windows, windows[:0], still, tmp_path / "fresh").last
    assert not np.allclose(fresh.weights["fc1.weight"], first.weights["fc1.weight"], atol=1e-4)
    with pytest.raises(ValueError, match="holds a run with other start"):
        train(CONFIG, windows, windows[:0], still, tmp_path / "on", start=fresh)
    with pytest.raises(ValueError, match="`start` must have the configuration and classes of this training"):
        train(CONFIG.replace(t_max=8.0), windows, windows[:0], still, tmp_path / "other", start=first)
