"""Parts of training on small and uneven data sets: balance, patience, settings, windows, the split."""

import numpy as np
import pytest
from made import events_of

from async_tnt.archive.records import decided_at
from async_tnt.archive.scores import score_recordings
from async_tnt.config import MAX_SIDE, TNTConfig
from async_tnt.decision import Decision
from async_tnt.training.augment import FINE, Augmentation, fineness
from async_tnt.training.windows import Recordings, make_windows, split_recordings


def recording(times_us):
    return events_of(times_us, np.full(len(times_us), 5), np.full(len(times_us), 7), np.ones(len(times_us), int))


def test_windows_reach_to_the_recordings_last_event():
    events = [recording([3, 102, 103, 2_000_000_003]), recording([50]), recording([])]
    windows = make_windows(Recordings.from_events(events, [0, 1, 1]), 100, first_event=True, duration_us=None)
    np.testing.assert_array_equal(windows.recording, [0, 0, 0, 1])
    np.testing.assert_array_equal(windows.start_us, [3, 103, 2_000_000_003, 50])


def test_small_classes_give_one_recording_to_the_held_out_and_keep_one():
    recordings = Recordings.from_events([recording([1])] * 14, [0] * 10 + [1] * 3 + [2])
    for fraction, expected in ((0.1, [1, 1, 0]), (0.5, [5, 2, 0]), (0.99, [9, 2, 0]), (0.0, [0, 0, 0])):
        _, held_out = split_recordings(recordings, fraction, np.random.default_rng(0), at_least=1)
        np.testing.assert_array_equal(np.bincount(recordings.labels[held_out], minlength=3), expected)


@pytest.mark.parametrize("sensor", [(2, 2), (34, 34), (1280, 720), (MAX_SIDE, 4)])
def test_augmented_events_have_a_place_on_every_sensor(sensor):
    config = TNTConfig(sensor=sensor)
    draws = Augmentation.for_sensor(config).draw(3, config, np.random.default_rng(0))
    assert max(draws.sensor) <= MAX_SIDE and 1 <= fineness(sensor) <= FINE
    assert draws.sensor == tuple((side - 1) * fineness(sensor) + 1 for side in sensor)


def test_augmentation_grows_with_sensor_and_window():
    assert Augmentation.for_sensor(TNTConfig()) == Augmentation()
    found = Augmentation.for_sensor(TNTConfig(sensor=(100, 67), window_us=1_050))
    assert (found.shift_px, found.start_ms, found.partial_from_ms) == (3.0, 0.05, 0.15)


def test_scores_by_hand():
    windows = [np.array([[0.1, 0.9], [0.6, 0.4], [0.6, 0.4]]), np.array([[0.2, 0.8]])]
    scores = score_recordings(["a", "b"], [0, 1], windows)
    np.testing.assert_array_equal(scores.confusion, [[0, 1], [0, 1]])  # means .433, .567: b
    np.testing.assert_array_equal(scores.window_confusion, [[2, 1], [0, 1]])
    assert (scores.accuracy, scores.window_accuracy, scores.balanced_accuracy) == (0.5, 0.75, 0.5)
    for labels, probabilities in (([], []), ([0], [np.empty((0, 2))])):
        with pytest.raises(ValueError, match=r"got none|with none"):
            score_recordings(["a", "b"], labels, probabilities)


def test_every_class_is_shown_equally_often_and_every_window_in_turn():
    train = pytest.importorskip("async_tnt.training.loop", reason="needs torch", exc_type=ImportError)
    labels = np.array([0] * 90 + [1] * 7 + [2] * 3)
    order = train.balanced_order(labels, np.random.default_rng(1))
    assert len(order) == 100
    assert sorted(np.bincount(labels[order])) == [33, 33, 34]
    shown = np.bincount(order, minlength=100)
    assert shown[:90].max() == 1 and np.ptp(shown[90:97]) <= 1 and np.ptp(shown[97:]) <= 1
    again, other = (train.balanced_order(labels, np.random.default_rng(seed)) for seed in (1, 2))
    np.testing.assert_array_equal(order, again)
    assert not np.array_equal(order, other)


def test_an_epoch_of_training_shows_every_class_equally_often():
    train = pytest.importorskip("async_tnt.training.loop", reason="needs torch", exc_type=ImportError)
    events = [recording([1_000 * k, 50_000]) for k in range(12)]
    windows = make_windows(Recordings.from_events(events, [0] * 9 + [1] * 3), 105_000)
    seen = {True: [], False: []}
    for balance, labels in seen.items():
        settings = train.TrainSettings(epochs=2, batch=4, balance=balance)
        for epoch in range(2):
            for some, _ in train.batches_of(TNTConfig(), windows, settings, epoch):
                labels += some.labels.tolist()
    assert np.bincount(seen[True]).tolist() == [12, 12] and np.bincount(seen[False]).tolist() == [18, 6]


def test_a_moment_knows_the_events_before_it_and_no_others():
    def decided(time_us, index):
        return Decision("", index, np.zeros(2), np.zeros(2), 1_000, 1_000 + time_us, 1, False, "every_us")

    window = [decided(4, 0), decided(10, 1), decided(25, 2)]
    assert decided_at(window, [4, 5, 10, 11, 25, 26]) == [-1, 0, 0, 1, 1, 2]


def test_patience_ends_the_training_and_the_best_epoch_has_the_lowest_loss(tmp_path, monkeypatch):
    train = pytest.importorskip("async_tnt.training.loop", reason="needs torch", exc_type=ImportError)
    losses = iter([3.0, 1.0, 2.0, 1.5, 0.5])
    monkeypatch.setattr(train, "_validate", lambda *words, **more: {"validation_loss": next(losses), "per_window": 0.5})
    rng = np.random.default_rng(0)
    events = [recording(np.sort(rng.integers(0, 100_000, 50))) for _ in range(4)]
    windows = make_windows(Recordings.from_events(events, [0, 1, 0, 1]), 105_000, first_event=True, duration_us=None)
    settings = train.TrainSettings(epochs=5, batch=4, patience=2, balance=True)
    result = train.train(TNTConfig(), windows, windows, settings, tmp_path, classes=("a", "b"))
    assert len(result.history) == 4 and result.best_epoch == 2
    again = train.train(TNTConfig(), windows, windows, settings, tmp_path, classes=("a", "b"))  # asks for no fifth loss
    assert len(again.history) == 4
    with pytest.raises(ValueError, match="holds a run with other classes"):
        train.train(TNTConfig(), windows, windows, settings, tmp_path, classes=("a", "c"))
    with pytest.raises(ValueError, match=r"labels must be in \[0, 1\), one for each class, got 1"):
        train.train(TNTConfig(), windows, windows, settings, tmp_path / "x", classes=("a",))


def test_a_rare_class_counts_as_much_in_the_validation_loss(monkeypatch):
    train = pytest.importorskip("async_tnt.training.loop", reason="needs torch", exc_type=ImportError)
    windows = make_windows(Recordings.from_events([recording([1])] * 4, [0, 0, 0, 1]), 105_000)
    probabilities = np.array([[0.5, 0.5]] * 3 + [[0.75, 0.25]])
    monkeypatch.setattr(train, "class_probabilities", lambda *words: probabilities)
    balanced, plain = (train._validate(None, windows, balance=b)["validation_loss"] for b in (True, False))
    assert balanced == pytest.approx((np.log(2) + np.log(4)) / 2) and plain == pytest.approx(1.25 * np.log(2))


def test_every_public_name_is_there():
    pytest.importorskip("torch")
    import async_tnt.training

    for name in async_tnt.training.__all__:
        assert getattr(async_tnt.training, name).__name__ == name
    with pytest.raises(AttributeError, match=r"module 'async_tnt.training' has no attribute 'x'"):
        _ = async_tnt.training.x
