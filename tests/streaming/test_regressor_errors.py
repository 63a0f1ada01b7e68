"""A regressor that is missing, out of place, or says what cannot be a landmark."""

import re

import numpy as np
import pytest
from deciding import key
from made import random_events, random_model

from async_tnt import Processor, TNTConfig, TNTVolume

CONFIG = TNTConfig(window_us=1000, landmark="regressor", t_max=2.0)
MISSING = (
    "`regressor` is missing: landmark='regressor', transform='tnt' needs a callable from a raw volume to (x, y); "
    "a Model brings its own, CompiledRegressor(model)"
)
REFUSED = '`regressor` needs landmark="regressor" and transform="tnt", got landmark={!r}, transform={!r}'


def centre(raw):
    return 16.5, 16.5


@pytest.mark.parametrize(
    ("config", "regressor", "error", "message"),
    [
        (CONFIG, None, ValueError, MISSING),
        (CONFIG, (16.5, 16.5), TypeError, "`regressor` must be callable, got tuple"),
        (TNTConfig(), 7, TypeError, "`regressor` must be callable, got int"),
        *[
            (TNTConfig(landmark=landmark), centre, ValueError, REFUSED.format(landmark, "tnt"))
            for landmark in ("center", "running", "line", "window")
        ],
        (CONFIG.replace(transform="none"), centre, ValueError, REFUSED.format("regressor", "none")),
    ],
)
def test_regressor_and_landmark_go_together(config, regressor, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        TNTVolume(config, regressor=regressor)
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        Processor(config, classifier=lambda volume: [0.0], regressor=regressor)


def test_a_model_without_a_regressor_takes_none():
    with pytest.raises(ValueError, match=f"^{re.escape(REFUSED.format('running', 'tnt'))}$"):
        Processor(random_model(), regressor=centre)


WRONG = [
    (None, "must return two numbers (x, y) in grid pixels, got None"),
    (3.0, "must return two numbers (x, y) in grid pixels, got 3.0"),
    ((3.0,), "must return two numbers (x, y) in grid pixels, got (3.0,)"),
    ([1, 2, 3], "must return two numbers (x, y) in grid pixels, got [1, 2, 3]"),
    ("ab", "must return two numbers (x, y) in grid pixels, got 'ab'"),
    (np.zeros((2, 2)), "must return two numbers (x, y) in grid pixels, got array([[0."),
    (((1, 2), (3, 4)), "must return two numbers (x, y) in grid pixels, got ((1, 2), (3, 4))"),
    ((None, 1), "must return two numbers (x, y) in grid pixels, got (None, 1)"),
    ((1j, 1), "must return two numbers (x, y) in grid pixels, got (1j, 1)"),
    ((10**400, 1), "must return two numbers (x, y) in grid pixels, got (1000"),
    ((float("nan"), 1), "must return a finite landmark, got (nan, 1.0)"),
    ((1, float("inf")), "must return a finite landmark, got (1.0, inf)"),
    (np.array([-np.inf, np.nan]), "must return a finite landmark, got (-inf, nan)"),
]


@pytest.mark.parametrize(("answer", "message"), WRONG)
@pytest.mark.parametrize("read", ["array", "landmark", "counts"])
def test_an_answer_that_is_no_landmark(answer, message, read):
    volume = TNTVolume(CONFIG, regressor=lambda raw: answer)
    volume.update_one(5, 3, 3, 1)
    with pytest.raises(ValueError, match=f"^{re.escape('`regressor` ' + message)}") as caught:
        getattr(volume, read)
    assert len(str(caught.value)) < 200 and "\n" not in str(caught.value)


class Failing:
    """A regressor that raises as long as it is told to."""

    def __init__(self):
        self.fails = False

    def __call__(self, raw):
        if self.fails:
            raise RuntimeError("no memory")
        return raw.sum() / 10 + 16, 15.0


def test_what_it_raises_leaves_the_window_as_it_was():
    events = random_events(60, seed=1, duration_us=2000)
    failing = Failing()
    volume, untroubled = TNTVolume(CONFIG, regressor=failing), TNTVolume(CONFIG, regressor=Failing())
    volume.open(0), untroubled.open(0)
    volume.update(events[:20]), untroubled.update(events[:20])
    before = volume.array.copy()
    failing.fails = True
    volume.update(events[20:25])
    for read in ("array", "landmark", "counts"):
        with pytest.raises(RuntimeError, match="no memory"):
            getattr(volume, read)
    with pytest.raises(RuntimeError, match="no memory"):
        volume.open(5000)
    assert np.array_equal(volume._view, before)
    assert (volume.start_us, volume.n_events) == (0, 25)
    failing.fails = False
    untroubled.update(events[20:25])
    assert volume.array.tobytes() == untroubled.array.tobytes()
    volume.update(events[25:]), untroubled.update(events[25:])
    assert volume.array.tobytes() == untroubled.array.tobytes() and volume.counts == untroubled.counts


def test_reset_gets_out_of_a_window_that_has_no_landmark():
    volume = TNTVolume(CONFIG, regressor=lambda raw: (np.nan, 1.0))
    volume.update_one(5, 3, 3, 1)
    with pytest.raises(ValueError, match="must return a finite landmark"):
        volume.close()
    volume.reset()
    assert volume.n_events == 0 and not volume.array.any()


@pytest.mark.parametrize("settings", [{}, {"hop_us": 300}, {"every_us": 100}])
def test_in_a_processor_it_costs_only_the_rest_of_its_packet(settings):
    events = random_events(200, seed=3, duration_us=4000)
    failing = Failing()

    def processor_with(regressor):
        return Processor(CONFIG, classifier=lambda v: [v.sum(), abs(v).sum()], regressor=regressor, **settings)

    processor, untroubled = processor_with(failing), processor_with(Failing())
    decisions, expected, failures = [], [], 0
    for k, event in enumerate(events):
        failing.fails = k % 3 == 0
        try:
            decisions += processor.push(np.array([event]))
        except RuntimeError:
            failures += 1
            failing.fails = False
            decisions += processor.push(np.array([event]))  # in packets of one nothing is lost
        expected += untroubled.push(np.array([event]))
    failing.fails = False
    decisions += processor.finish()
    expected += untroubled.finish()
    assert failures > 0
    assert [key(d) for d in decisions] == [key(d) for d in expected]
    assert processor.counts == untroubled.counts
