"""Landmark "regressor": by hand; one that is missing, out of place, fails, or returns what cannot be a landmark."""

import re

import numpy as np
import pytest
from deciding import total_and_size
from made import random_events, random_model

from async_tnt import CompiledRegressor, Counts, Processor, TNTConfig, TNTVolume

CONFIG = TNTConfig(window_us=1000, landmark="regressor", t_max=2.0)


def centre(raw):
    return 16.5, 16.5


@pytest.mark.parametrize(
    ("config", "regressor", "error", "message"),
    [
        (CONFIG, None, ValueError, "`regressor` is missing: landmark='regressor', transform='tnt' needs a callable"),
        (CONFIG, (16.5, 16.5), TypeError, "`regressor` must be callable, got tuple"),
        (TNTConfig(), centre, ValueError, '`regressor` needs landmark="regressor" and transform="tnt", got'),
    ],
)
def test_regressor_and_landmark_go_together(config, regressor, error, message):
    for make in (TNTVolume, lambda config, **settings: Processor(config, classifier=total_and_size, **settings)):
        with pytest.raises(error, match=f"^{re.escape(message)}"):
            make(config, regressor=regressor)
    with pytest.raises(ValueError, match=r'^the model has no regressor: that needs landmark="regressor" and trans'):
        CompiledRegressor(random_model())


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (None, ValueError, "`regressor` must return two numbers (x, y) in grid pixels, got None"),
        (np.zeros((2, 2)), ValueError, "`regressor` must return two numbers (x, y) in grid pixels, got array([[0."),
        ((10**400, 1), ValueError, "`regressor` must return two numbers (x, y) in grid pixels, got (1000"),
        ((float("nan"), 1), ValueError, "`regressor` must return a finite landmark, got (nan, 1.0)"),
        (RuntimeError("no memory"), RuntimeError, "no memory"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_without_a_landmark_the_window_stays_as_it_was(answer, error, message):
    def regressor(raw):
        if fails and isinstance(answer, Exception):
            raise answer
        return answer if fails else (raw.sum() / 10 + 16, 15.0)

    fails = False
    events = random_events(60, seed=1, duration_us=2000)
    volume, untroubled = (TNTVolume(CONFIG, regressor=regressor) for _ in range(2))
    volume.update(events[:20]), untroubled.update(events[:20])
    view = volume.array
    before = view.copy()
    volume.update(events[20:25]), untroubled.update(events[20:25])
    fails = True
    reads = (lambda: volume.array, lambda: volume.landmark, lambda: volume.counts)
    for call in (*reads, volume.close, lambda: volume.open(5000)):
        with pytest.raises(error, match=f"^{re.escape(message)}") as caught:
            call()
        assert len(str(caught.value)) < 200 and "\n" not in str(caught.value)
    assert np.array_equal(view, before) and volume.n_events == 25
    fails = False
    assert volume.array.tobytes() == untroubled.array.tobytes()
    volume.update(events[25:]), untroubled.update(events[25:])
    assert volume.array.tobytes() == untroubled.array.tobytes() and volume.counts == untroubled.counts
    fails = True
    volume.reset()  # works without a landmark
    assert volume.n_events == 0 and not volume.array.any()


def test_by_hand():
    """bins 5, t_max 2, window 1000: t = 500 has tau 1 and bin 2; t = 750 has tau 1.5 and bin 3."""
    config = TNTConfig(sensor=(67, 34), grid=(34, 34), bins=5, window_us=1000, t_max=2.0, landmark="regressor")
    volume = TNTVolume(config, regressor=lambda raw: (10.5, 8.5))
    volume.open(0)
    volume.update(([500, 750], [21, 27], [9, 10], [1, 0]))  # in grid pixels (10.5, 9), (13.5, 10)
    expected = np.zeros((5, 34, 34), np.float32)
    expected[2, 17, 16:18] = 0.5  # u = 0 / 1 + 16.5, v = 0.5 / 1 + 16.5
    expected[3, 17:19, 18:20] = -0.25  # u = 3 / 1.5 + 16.5 = 18.5, v = 1.5 / 1.5 + 16.5 = 17.5
    assert np.abs(volume.array - expected).max() <= 1e-6
    assert volume.counts == Counts(received=2, kept=2)
