"""The bundled models of digits are right on every bundled sample.

They are as accurate as their records say.
"""

import pytest

torch = pytest.importorskip("torch")

from async_tnt.networks.loading import load_model  # noqa: E402
from async_tnt.sources import open_recording, sample_recordings  # noqa: E402
from async_tnt.training.evaluation import evaluate  # noqa: E402
from async_tnt.training.pipeline import pipeline_of  # noqa: E402
from async_tnt.training.recordings import Recordings  # noqa: E402
from async_tnt.training.windows import make_windows  # noqa: E402
from experiments import everywhere  # noqa: E402
from experiments.digit_data.recordings import DURATION_US, read_nmnist_folder  # noqa: E402

from_either = pytest.mark.parametrize(
    "first_event", [False, True], ids=["from 0", "from the first event"]
)


@pytest.fixture(scope="module", params=["digits", "digits-from-pictures"])
def model(request):
    return load_model(request.param)


def test_the_record_of_digits_has_its_data_accuracy_and_command():
    model = load_model("digits")
    record = model.record
    assert model.config.transform == "tnt" and model.classes == tuple("0123456789")
    assert {"data", "command", "seed", "epochs", "versions", "validation", "test", "tried"} <= set(
        record
    )
    # The note beside the numbers says that the split is not the official one.
    assert "official" in record["data"]["note"]
    assert record["test"]["per_window"] >= 0.97 and record["test"]["per_recording"] >= 0.985


def test_the_other_one_saw_pictures_alone():
    model = load_model("digits-from-pictures")
    data = model.record["data"]
    test = model.record["test"]
    assert model.classes == tuple("0123456789") and data["pictures"]["pictures"] == 60_000
    assert test["recordings"] == 8_000 and test["window_accuracy"] >= 0.99


@from_either
def test_every_window_of_every_sample_is_classified_right(model, first_event):
    labels, paths = zip(*sample_recordings().items(), strict=True)
    recordings = Recordings.from_events([open_recording(path).read() for path in paths], labels)
    windows = make_windows(
        recordings, model.config.window_us, first_event=first_event, duration_us=DURATION_US
    )
    assert len(windows) == 30 and evaluate(pipeline_of(model), windows).per_window == 1.0


@pytest.fixture(scope="module")
def real_recordings(data):
    """400 of the 1,000 test recordings."""
    return read_nmnist_folder(data / "nmnist" / "Test", per_digit=40)


@from_either
def test_accuracy_on_real_recordings(model, first_event, real_recordings):
    """1,200 windows: standard error 0.4 %."""
    windows = make_windows(
        real_recordings, model.config.window_us, first_event=first_event, duration_us=DURATION_US
    )
    found = evaluate(pipeline_of(model), windows)
    assert (found.to_dict()["recordings"], len(windows) >= 1_195) == (400, True)
    assert found.per_window >= 0.98 and found.per_recording >= 0.985


def test_digits_on_a_large_sensor(data):
    """The scenes are the experiment's own, of real test recordings."""
    files = sorted((data / "nmnist" / "Test").glob("*/*.bin"))
    model = load_model("digits-everywhere")
    assert model.record["data"]["pictures"]["pictures"] == everywhere.N_PICTURES
    kind = everywhere.DIGITS["three"]
    f1 = everywhere.measure(model, files, 120, kind)
    assert f1["end"] > 0.95 and f1["early"] > 0.93
    assert everywhere.objects_in_noise(model, kind, 20) == 0
