"""Training stores statistics of the classes, from which more are taught."""

import numpy as np
import pytest
from made import random_events, random_model
from training.gestures import bar

from async_tnt import Processor, TNTConfig, load_model
from async_tnt.networks.teaching import teach
from async_tnt.networks.teaching.statistics import MAX_BYTES
from async_tnt.networks.teaching.window_readings import MOMENTS

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

from async_tnt.training import Recordings, make_windows
from async_tnt.training.augment import KINDS
from async_tnt.training.batches import BatchVolumes
from async_tnt.training.class_statistics import can_have_statistics, with_class_statistics


def bars(kind, first, n):
    return [bar(kind, seed) for seed in range(first, first + n)]


def test_a_trained_model_has_statistics_of_what_it_learned_from(trained):
    model = load_model(trained)
    statistics = model.statistics
    assert statistics.trained == model.classes == ("flat", "upright")
    # of each class ten recordings of one window were learned from, each is read at three moments
    assert [moments.count for moments in statistics.moments.values()] == [30, 30]
    assert statistics.nothing.count == 60
    assert statistics.n_bytes <= MAX_BYTES
    # the mean is that of the windows as they were recorded: of these recordings about the same
    again = model.with_statistics({name: bars(name, 0, 12) for name in model.classes})
    assert again.statistics.layer == statistics.layer
    for name in model.classes:
        ours = statistics.projection @ statistics.moments[name].mean[:-1] + statistics.center
        theirs = again.statistics.projection @ again.statistics.moments[name].mean[:-1]
        theirs = theirs + again.statistics.center
        assert np.corrcoef(ours, theirs)[0, 1] > 0.9


def test_a_class_is_taught_to_a_trained_model(trained):
    model = load_model(trained)
    taught = model.with_class("slanted", bars("slanted", 500, 8))
    labels = []
    for kind in ("flat", "upright", "slanted"):
        for recording in bars(kind, 900, 10):
            processor = Processor(taught, start_us=0)
            processor.push(recording)
            labels.append(processor.fire().label == kind)
    assert np.mean(labels) > 0.75
    assert taught.record["taught"]["slanted"]["taken_of_nothing"] <= 0.5


def test_an_option_leaves_statistics_out(gestures, train):
    code, err, out = train(gestures, "--no-statistics")
    assert code == 0 and "statistics" not in err
    model = load_model(out)
    assert model.statistics is None
    assert "--no-statistics" in model.record["command"]


def test_of_many_windows_some_are_read(gestures, train, monkeypatch):
    monkeypatch.setattr(teach, "MOST_READINGS", 6)
    code, _, out = train(gestures)
    assert code == 0
    statistics = load_model(out).statistics
    assert [moments.count for moments in statistics.moments.values()] == [6, 6]
    assert statistics.nothing.count == 60  # one of nothing for each window, at three moments
    assert statistics.n_components == 16


@pytest.mark.parametrize("words", [("--last-events", "400"), ("--last-us", "50000")])
def test_windows_that_slide_have_statistics(gestures, train, words):
    code, _, out = train(gestures, *words)
    assert code == 0
    model = load_model(out)
    assert all(moments.count >= 30 for moments in model.statistics.moments.values())
    assert model.with_class("slanted", bars("slanted", 0, 5)).classes[-1] == "slanted"


def test_a_class_without_windows_has_no_statistics():
    config = TNTConfig(sensor=(20, 16), grid=(20, 16), bins=2, window_us=1000, transform="none")
    model = random_model(config, classes=2)
    t = np.arange(40, dtype=np.int32) % 20 * 10
    pixels = np.arange(40, dtype=np.uint16) % 16
    p = (pixels % 2).astype(np.uint8)
    for labels, expected in (([0, 0], False), ([0, 1], True)):
        offsets = np.array([0, 20, 40])
        recordings = Recordings(t, pixels, pixels, p, offsets, np.array(labels), ("a", "b"))
        windows = make_windows(recordings, config.window_us)
        assert can_have_statistics(model, windows) == expected
    statistics = with_class_statistics(model, windows).statistics
    assert [moments.count for moments in statistics.moments.values()] == [1, 1]


def test_each_kind_of_nothing_is_read_equally_often_at_all_moments(monkeypatch):
    """Seven windows: a kind each, then the first two again."""
    config = TNTConfig(sensor=(20, 16), grid=(20, 16), bins=2, window_us=1000, transform="none")
    model = random_model(config, classes=2)
    events = [random_events(40, seed=k, duration_us=1000, sensor=(20, 16)) for k in range(7)]
    windows = make_windows(Recordings.from_events(events, [0, 1] * 3 + [0]), config.window_us)
    kinds = []
    until_us = []
    volumes_of = BatchVolumes.__call__

    def noted(self, windows, draws):
        kinds.append(int(draws.content[0]))
        until_us.append(int(draws.until_us[0]))
        return volumes_of(self, windows, draws)

    monkeypatch.setattr(BatchVolumes, "__call__", noted)
    statistics = with_class_statistics(model, windows).statistics
    n = len(MOMENTS)
    every = list(KINDS.values())
    assert kinds == [kind for kind in [*every, *every[:2]] for _ in MOMENTS]
    assert until_us == [int(share * 1000) for share in MOMENTS] * 7
    assert statistics.nothing.count == 7 * n
