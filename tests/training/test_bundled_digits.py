"""The bundled model `digits`: right on every bundled sample, and as accurate as its record says."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from async_tnt.networks.model import load_model  # noqa: E402
from async_tnt.training.digits import read_nmnist_folder, read_samples  # noqa: E402
from async_tnt.training.evaluation import class_probabilities, evaluate  # noqa: E402
from async_tnt.training.pipeline import pipeline_of  # noqa: E402
from async_tnt.training.windows import make_windows  # noqa: E402

PER_DIGIT = 40  # 400 of the 1,000 test recordings: 1,200 windows, standard error 0.4 %


@pytest.fixture(scope="module")
def model():
    return load_model("digits")


@pytest.mark.parametrize("first_event", [False, True], ids=["from 0", "from the first event"])
def test_every_window_of_every_sample_is_classified_right(model, first_event):
    windows = make_windows(read_samples(), model.config.window_us, first_event=first_event)
    assert len(windows) == 30
    decided = class_probabilities(pipeline_of(model), windows).argmax(1)
    np.testing.assert_array_equal(decided, windows.labels)


def test_it_is_a_tnt_model_whose_landmark_costs_no_replay(model):
    assert model.config.transform == "tnt" and model.config.landmark in ("center", "running", "line")
    assert model.classes == tuple("0123456789")
    widths = [len(model.weights[f"{layer}.bias"]) for layer in ("conv1", "conv2", "fc1", "fc2")]
    assert widths == [16, 32, 64, 10]


def test_the_record_says_what_was_done(model):
    record = model.record
    assert {"data", "command", "seed", "epochs", "versions", "validation", "test", "tried"} <= set(record)
    assert "official" in record["data"]["note"]  # not the official split: said where the numbers are
    assert record["test"]["per_window"] >= 0.97 and record["test"]["per_recording"] >= 0.985
    assert len(record["tried"]) >= 10


@pytest.mark.parametrize("first_event", [False, True], ids=["from 0", "from the first event"])
def test_accuracy_on_real_recordings(model, first_event, data):
    recordings = read_nmnist_folder(data / "nmnist" / "Test", per_digit=PER_DIGIT)
    windows = make_windows(recordings, model.config.window_us, first_event=first_event)
    found = evaluate(pipeline_of(model), windows)
    assert found.n_recordings == 400 and found.n_windows >= 1_195
    assert found.per_window >= 0.98
    assert found.per_recording >= 0.985
