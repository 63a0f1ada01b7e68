"""A regressor that is missing, out of place, fails, or returns what cannot be a landmark."""

import re

import numpy as np
import pytest
from deciding import key, total_and_size
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
        (TNTConfig(landmark="window"), centre, ValueError, REFUSED.format("window", "tnt")),
        (CONFIG.replace(transform="none"), centre, ValueError, REFUSED.format("regressor", "none")),
    ],
)
def test_regressor_and_landmark_go_together(config, regressor, error, message):
    for make in (TNTVolume, lambda config, **settings: Processor(config, classifier=total_and_size, **settings)):
        with pytest.raises(error, match=f"^{re.escape(message)}$"):
            make(config, regressor=regressor)


def test_a_model_without_a_regressor_takes_none():
    with pytest.raises(ValueError, match=f"^{re.escape(REFUSED.format('running', 'tnt'))}$"):
        Processor(random_model(), regressor=centre)


NO_PAIR = "must return two numbers (x, y) in grid pixels, got "
WRONG = [
    (None, f"{NO_PAIR}None"),
    ((3.0,), f"{NO_PAIR}(3.0,)"),
    ([1, 2, 3], f"{NO_PAIR}[1, 2, 3]"),
    ("ab", f"{NO_PAIR}'ab'"),
    (np.zeros((2, 2)), f"{NO_PAIR}array([[0."),
    ((1j, 1), f"{NO_PAIR}(1j, 1)"),
    ((10**400, 1), f"{NO_PAIR}(1000"),
    ((float("nan"), 1), "must return a finite landmark, got (nan, 1.0)"),
    (np.array([1, -np.inf]), "must return a finite landmark, got (1.0, -inf)"),
]


@pytest.mark.parametrize(("answer", "message"), WRONG, ids=lambda value: str(value)[:20])
def test_an_answer_that_cannot_be_a_landmark(answer, message):
    volume = TNTVolume(CONFIG, regressor=lambda raw: answer)
    volume.update_one(5, 3, 3, 1)
    for read in ("array", "landmark", "counts"):
        with pytest.raises(ValueError, match=f"^{re.escape('`regressor` ' + message)}") as caught:
            getattr(volume, read)
        assert len(str(caught.value)) < 200 and "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="`regressor` must return"):
        volume.close()
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


@pytest.mark.parametrize("settings", [{"hop_us": 300}, {"every_us": 100}], ids=str)
def test_in_a_processor_it_costs_only_the_rest_of_its_packet(settings):
    events = random_events(200, seed=3, duration_us=4000)
    failing = Failing()
    processor, untroubled = (
        Processor(CONFIG, classifier=total_and_size, regressor=regressor, **settings)
        for regressor in (failing, Failing())
    )
    decisions, expected, n_failures = [], [], 0
    for k, event in enumerate(events):
        failing.fails = k % 3 == 0
        try:
            decisions += processor.push(np.array([event]))
        except RuntimeError:
            n_failures += 1
            failing.fails = False
            decisions += processor.push(np.array([event]))  # in packets of one nothing is lost
        expected += untroubled.push(np.array([event]))
    failing.fails = False
    decisions += processor.finish()
    assert n_failures > 0
    assert [key(d) for d in decisions] == [key(d) for d in expected + untroubled.finish()]
    assert processor.counts == untroubled.counts
