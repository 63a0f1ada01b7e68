"""A regressor that is missing, out of place, fails, or returns what cannot be a landmark."""

import re

import numpy as np
import pytest
from deciding import total_and_size
from made import random_events

from async_tnt import Processor, TNTConfig, TNTVolume

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


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "must return two numbers (x, y) in grid pixels, got None"),
        (np.zeros((2, 2)), "must return two numbers (x, y) in grid pixels, got array([[0."),
        ((10**400, 1), "must return two numbers (x, y) in grid pixels, got (1000"),
        ((float("nan"), 1), "must return a finite landmark, got (nan, 1.0)"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_an_answer_that_cannot_be_a_landmark(answer, message):
    volume = TNTVolume(CONFIG, regressor=lambda raw: answer)
    volume.update_one(5, 3, 3, 1)
    for read in (lambda: volume.array, lambda: volume.landmark, lambda: volume.counts, volume.close):
        with pytest.raises(ValueError, match=f"^{re.escape('`regressor` ' + message)}") as caught:
            read()
        assert len(str(caught.value)) < 200 and "\n" not in str(caught.value)
    volume.reset()  # works without a landmark
    assert volume.n_events == 0 and not volume.array.any()


class Failing:
    """A regressor that raises while `fails` is set."""

    fails = False

    def __call__(self, raw):
        if self.fails:
            raise RuntimeError("no memory")
        return raw.sum() / 10 + 16, 15.0


def test_an_error_leaves_the_window_as_it_was():
    events = random_events(60, seed=1, duration_us=2000)
    failing = Failing()
    volume, untroubled = TNTVolume(CONFIG, regressor=failing), TNTVolume(CONFIG, regressor=Failing())
    volume.open(0), untroubled.open(0)
    volume.update(events[:20]), untroubled.update(events[:20])
    view = volume.array
    before = view.copy()
    failing.fails = True
    volume.update(events[20:25])
    for read in ("array", "landmark", "counts"):
        with pytest.raises(RuntimeError, match="no memory"):
            getattr(volume, read)
    with pytest.raises(RuntimeError, match="no memory"):
        volume.open(5000)
    assert np.array_equal(view, before) and (volume.start_us, volume.n_events) == (0, 25)
    failing.fails = False
    untroubled.update(events[20:25])
    assert volume.array.tobytes() == untroubled.array.tobytes()
    volume.update(events[25:]), untroubled.update(events[25:])
    assert volume.array.tobytes() == untroubled.array.tobytes() and volume.counts == untroubled.counts
