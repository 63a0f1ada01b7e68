"""Windows, counts and errors of TNTVolume."""

import copy
import re

import numpy as np
import pytest
from deciding import total_and_size
from made import events_of, opened, random_events, random_model

from async_tnt import CompiledRegressor, Processor, TNTConfig, TNTVolume

CONFIG = TNTConfig(window_us=1000, landmark="center", t_max=1.0)
OF_REGRESSOR = CONFIG.replace(landmark="regressor")


def brightest(raw):
    """A regressor: the pixel with the most events, beside the middle of its grid cell."""
    y, x = np.unravel_index(np.abs(raw).sum(0).argmax(), raw.shape[1:])
    return x + 0.5, y + 0.25


@pytest.mark.parametrize("landmark", ["center", "window"])
def test_window_is_half_open(landmark):
    volume = opened(CONFIG.replace(landmark=landmark))
    assert volume.update_one(999, 3, 3, 1) == 0 and volume.start_us == 0
    assert volume.update_one(1000, 3, 3, 1) == 1 and volume.start_us == 1000
    assert volume.update_one(999, 30, 30, 1) == 0 and volume.n_events == 1
    assert volume.counts.dropped_late == 1
    assert volume.update_one(10**15 + 7, 3, 3, 1) == 1 and volume.start_us == 10**15


@pytest.mark.parametrize("landmark", ["center", "window"])
@pytest.mark.parametrize(
    "update", [TNTVolume.update, lambda volume, events: volume.update_one(*events[0].tolist())]
)
def test_a_window_without_events_is_not_closed_but_left(update, landmark):
    volume = opened(CONFIG.replace(landmark=landmark))
    first = events_of([5_000], [3], [3], [1])
    second = events_of([7_000], [3], [3], [1])
    assert update(volume, first) == 0 and volume.start_us == 5_000
    assert update(volume, second) == 1 and volume.start_us == 7_000
    volume.open(9_000)
    assert update(volume, events_of([10_000], [3], [3], [1])) == 0


def test_array_is_a_read_only_float32_view_of_the_open_window():
    volume = opened(CONFIG)
    first = volume.array
    volume.update_one(500, 16, 16, 1)
    assert first is volume.array and first.any()
    assert first.dtype == np.float32 and first.shape == (9, 34, 34) and first.flags.c_contiguous
    for array in (first, copy.copy(volume).array):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0, 0] = 1
    volume.open(1000)
    assert not volume.array.any()


def test_what_is_refused():
    with pytest.raises(ValueError, match=r"`start_us` must be in \[0, 2\*\*62\), got -1"):
        TNTVolume(CONFIG).open(-1)
    with pytest.raises(TypeError, match=r"`start_us` must be a whole number, got 0\.5"):
        TNTVolume(CONFIG).open(0.5)
    with pytest.raises(
        ValueError, match=r"`flow` needs landmark=.line. and transform=.tnt., got landmark='center'"
    ):
        _ = TNTVolume(CONFIG).flow


def test_the_replay_buffer_grows_and_loses_nothing():
    config = CONFIG.replace(landmark="window")
    whole = opened(config)
    cut = opened(config)
    events = random_events(9_000, seed=10, duration_us=1000)
    whole.update(events)
    for part in np.array_split(events, 9):
        cut.update(part)
    assert whole.array.any() and cut.array.tobytes() == whole.array.tobytes()
    assert cut.counts == whole.counts and cut.counts.received == cut.n_events == 9_000
    assert cut.landmark == pytest.approx((events["x"].mean(), events["y"].mean()))


def test_a_clock_that_stands_still_is_not_stored_without_end(monkeypatch):
    monkeypatch.setattr("async_tnt.volume.replay.MAX_STORED", 5_000)
    volume = opened(CONFIG.replace(landmark="window"))
    packet = random_events(3_000, seed=10, duration_us=1000)
    volume.update(packet)
    before = volume.array.tobytes(), volume.counts
    with pytest.raises(
        ValueError,
        match=r"a window must have at most 5000 events .*, got 6000: shorten `window_us`",
    ):
        volume.update(packet)
    assert (volume.array.tobytes(), volume.counts) == before


# -- a regressor that is missing, out of place, fails, or returns what cannot be a landmark --------


@pytest.mark.parametrize(
    ("config", "regressor", "error", "message"),
    [
        (
            OF_REGRESSOR,
            None,
            ValueError,
            "`regressor` is missing: landmark='regressor', transform='tnt' needs a callable",
        ),
        (OF_REGRESSOR, (16.5, 16.5), TypeError, "`regressor` must be callable, got tuple"),
        (
            TNTConfig(),
            brightest,
            ValueError,
            '`regressor` needs landmark="regressor" and transform="tnt", got',
        ),
    ],
)
def test_regressor_and_landmark_go_together(config, regressor, error, message):
    for make in (
        TNTVolume,
        lambda config, **settings: Processor(config, classifier=total_and_size, **settings),
    ):
        with pytest.raises(error, match=f"^{re.escape(message)}"):
            make(config, regressor=regressor)
    with pytest.raises(
        ValueError, match=r'^the model has no regressor: that needs landmark="regressor" and trans'
    ):
        CompiledRegressor(random_model())


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (None, ValueError, "`regressor` must return two numbers (x, y) in grid pixels, got None"),
        (
            np.zeros((2, 2)),
            ValueError,
            "`regressor` must return two numbers (x, y) in grid pixels, got array([[0.",
        ),
        (
            (10**400, 1),
            ValueError,
            "`regressor` must return two numbers (x, y) in grid pixels, got (1000",
        ),
        (
            (float("nan"), 1),
            ValueError,
            "`regressor` must return a finite landmark, got (nan, 1.0)",
        ),
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
    volume = TNTVolume(OF_REGRESSOR, regressor=regressor)
    untroubled = TNTVolume(OF_REGRESSOR, regressor=regressor)
    for one in (volume, untroubled):
        one.update(events[:20])
    view = volume.array
    before = view.copy()
    for one in (volume, untroubled):
        one.update(events[20:25])
    fails = True
    reads = (lambda: volume.array, lambda: volume.landmark, lambda: volume.counts)
    for call in (*reads, volume.close, lambda: volume.open(5000)):
        with pytest.raises(error, match=f"^{re.escape(message)}") as caught:
            call()
        assert len(str(caught.value)) < 200 and "\n" not in str(caught.value)
    assert np.array_equal(view, before) and volume.n_events == 25
    fails = False
    assert volume.array.tobytes() == untroubled.array.tobytes()
    for one in (volume, untroubled):
        one.update(events[25:])
    assert volume.array.tobytes() == untroubled.array.tobytes()
    assert volume.counts == untroubled.counts
    fails = True
    volume.reset()  # works without a landmark
    assert volume.n_events == 0 and not volume.array.any()
