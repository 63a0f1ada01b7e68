"""What is asked of a training reaches its settings; what is not asked for is the default."""

import numpy as np
import pytest
from made import random_events

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

from async_tnt.training.plan import Plan
from async_tnt.training.recordings import Recordings
from async_tnt.training.settings import CHANGES, OF_PICTURES, TrainSettings, settings_for
from async_tnt.training.training_data import TrainingData
from async_tnt.training.volume_choice import VolumeChoice
from async_tnt.training.windows import make_windows
from async_tnt.volume.config import TNTConfig

CONFIG = TNTConfig(transform="none", polarity="split", landmark="center", window_us=50_000)


@pytest.fixture(scope="module")
def data():
    recordings = Recordings.from_events([random_events(400, seed=k) for k in range(4)], [0, 1] * 2)
    windows = make_windows(recordings, CONFIG.window_us)
    return TrainingData(CONFIG, ("a", "b"), windows, windows[:0])


def test_what_is_asked_for_reaches_the_settings(data):
    volume = VolumeChoice(CONFIG)
    plan = Plan(volume, network="conv4", epochs=3, seed=7, mirror=True, has_pictures=True)
    found = plan.settings_for(data)
    assert (found.network, found.epochs, found.seed) == ("conv4", 3, 7)
    assert not found.ends_early and not found.everywhere
    assert found.augmentation.mirror
    assert OF_PICTURES.items() <= vars(found.augmentation).items()
    default = Plan(volume).settings_for(data)
    assert (default.network, default.seed, default.everywhere) == ("residual", 0, False)
    assert default.ends_early and default.balance and not default.augmentation.mirror
    assert CHANGES.items() <= vars(default.augmentation).items()
    held_out = TrainingData(CONFIG, ("a", "b"), data.training, data.training)
    assert Plan(volume).settings_for(held_out) == default  # held-out windows are not trained on
    scenes = Plan(volume, everywhere=True).settings_for(data)
    assert (scenes.network, scenes.everywhere, scenes.balance) == ("map", True, False)


def test_defaults_follow_the_volume_and_the_number_of_windows():
    """A window ends early after a twentieth at the earliest; signed cells have no logarithm."""
    found = settings_for(CONFIG, 64)
    assert found.augmentation.partial_from_ms == 2.5 and found.logarithm
    assert settings_for(CONFIG.replace(window_us=200_000), 64).augmentation.partial_from_ms == 10
    assert not settings_for(CONFIG.replace(polarity="signed"), 64).logarithm
    assert settings_for(CONFIG.replace(polarity="unsigned"), 64).logarithm
    assert [settings_for(CONFIG, n).batch for n in (1, 256, 320, 2_048, 9_999)] == [
        8,
        8,
        10,
        64,
        64,
    ]
    assert settings_for(CONFIG, 64, augmentation={"drop": 0.5}).augmentation.drop == 0.5
    assert settings_for(CONFIG, 64, augmentation=None).augmentation is None


REFUSED = [
    *((name, 0, "must be at least 1") for name in ("epochs", "iterations", "passes", "batch")),
    ("seed", -1, "must be at least 0"),
    ("precision", "float16", "must be one of float32, bfloat16, auto"),
    *(("learning_rate", value, "must be positive") for value in (0, -1, np.inf, np.nan)),
    *(("weight_decay", value, "must be at least 0") for value in (-1, np.inf, np.nan)),
    *(
        (name, value, r"must be in \[0, 1\)")
        for name in ("label_smoothing", "averaging", "warm_up")
        for value in (-0.1, 1, np.nan)
    ),
]


@pytest.mark.parametrize(("name", "value", "rule"), REFUSED)
def test_settings_outside_of_their_range_are_refused(name, value, rule):
    with pytest.raises(ValueError, match=rf"^`{name}` {rule}, got "):
        TrainSettings(**{name: value})
