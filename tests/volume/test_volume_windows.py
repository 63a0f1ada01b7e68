"""Windows, counts and errors of TNTVolume."""

import copy
import re

import numpy as np
import pytest
from deciding import total_and_size
from made import events_of, opened, random_events, random_model

from async_tnt import CompiledRegressor, Processor, TNTConfig, TNTVolume
from async_tnt.volume.config import LANDMARKS

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


@pytest.mark.parametrize("landmark", ["center", "window"])
def test_after_a_close_the_next_event_opens_a_window_and_the_counts_go_on(landmark):
    volume = opened(CONFIG.replace(landmark=landmark), events_of([500], [16], [16], [1]))
    assert volume.is_open and volume.array.any()
    volume.close()
    assert not volume.is_open and not volume.array.any()
    assert (volume.n_events, volume.newest_us) == (0, -1)
    # no multiple of the window after the first start, and no window that is closed by it
    assert volume.update_one(1234, 16, 16, 1) == 0
    assert (volume.start_us, volume.newest_us, volume.n_events) == (1234, 1234, 1)
    volume.update_one(1233, 16, 16, 1)
    counts = volume.counts
    assert (counts.received, counts.kept) == (3, 1)
    assert (counts.dropped_tau_zero, counts.dropped_late) == (1, 1)


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


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_before_the_first_event_and_without_the_transform_the_landmark_is_the_grids_centre(
    landmark,
):
    """A landmark network is not even needed then."""
    config = CONFIG.replace(landmark=landmark, sensor=(50, 20), grid=(9, 6))
    regressor = (lambda raw: (1.0, 2.0)) if landmark == "regressor" else None
    transformed = opened(config, regressor=regressor)
    plain = opened(config.replace(transform="none"))
    for volume, moves in ((transformed, landmark != "center"), (plain, False)):
        assert volume.landmark == (4.0, 2.5)
        volume.update_one(10, 7, 3, 1)
        assert (volume.landmark != (4.0, 2.5)) == moves
        volume.open(1000)
        assert volume.landmark == (4.0, 2.5)


def test_what_is_refused():
    with pytest.raises(ValueError, match=r"`start_us` must be in \[0, 2\*\*62\), got -1"):
        TNTVolume(CONFIG).open(-1)
    with pytest.raises(TypeError, match=r"`start_us` must be a whole number, got 0\.5"):
        TNTVolume(CONFIG).open(0.5)
    with pytest.raises(
        ValueError, match=r"`flow` needs landmark=.line. and transform=.tnt., got landmark='center'"
    ):
        _ = TNTVolume(CONFIG).flow
    with pytest.raises(ValueError, match=r"`flow` needs .*, got landmark='line', transform='none'"):
        _ = TNTVolume(CONFIG.replace(landmark="line", transform="none")).flow


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
    volume.update(packet[:2_000])
    assert volume.n_events == 5_000


@pytest.mark.parametrize(
    "settings", [{"landmark": "window"}, {"window_events": 9_000, "window_us": 3_000}], ids=str
)
def test_events_of_later_windows_and_windows_of_events_are_stored_beyond_that(
    settings, monkeypatch
):
    monkeypatch.setattr("async_tnt.volume.replay.MAX_STORED", 5_000)
    volume = TNTVolume(CONFIG.replace(**settings))
    events = random_events(9_000, seed=10, duration_us=3_000)
    events["t"][0] = 0
    volume.update(events)
    counts = volume.counts
    assert counts.received == 9_000 and counts.kept > 0
    assert volume.n_events == (events["t"] >= volume.start_us).sum()


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


READS = [lambda v: v.array, lambda v: v.landmark, lambda v: v.counts, lambda v: v.open(5000)]


@pytest.mark.parametrize("first", READS)
def test_a_regressor_is_asked_once_after_new_events_whatever_is_read_and_how_often(first):
    """It gets a volume that it cannot change."""
    asked = []

    def regressor(raw):
        asked.append(raw.sum())
        with pytest.raises(ValueError, match="read-only"):
            raw[0, 0, 0] = 1
        return 16.0, 15.0

    volume = opened(OF_REGRESSOR, regressor=regressor)
    for read in (*READS, lambda v: v.open(0)):
        read(volume)
    assert asked == []  # no events
    for n in (1, 2):
        volume.update_one(500, 16, 16, 1)
        for read in (first, *READS[:3], *READS[:3]):
            read(volume)
        assert len(asked) == n and asked[-1] > 0
        volume.open(0)
    assert len(asked) == 2


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (None, ValueError, "`regressor` must return two numbers (x, y) in grid pixels, got None"),
        (
            (1.0, 2.0, 3.0),
            ValueError,
            "`regressor` must return two numbers (x, y) in grid pixels, got (1.0, 2.0, 3.0)",
        ),
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


@pytest.mark.parametrize("late", ["accept", "drop"])
@pytest.mark.parametrize("landmark", ["running", "window", "regressor"])
def test_after_a_reset_a_volume_is_as_it_was_made(landmark, late):
    """The same events later again, some of them late, give the same volume and the same counts."""
    config = CONFIG.replace(landmark=landmark)
    regressor = brightest if landmark == "regressor" else None
    events = random_events(90, duration_us=2900, start_us=100)
    events["t"][7::10] -= 90
    events["t"][65::10] -= 1900
    volume = TNTVolume(config, late=late, regressor=regressor)
    before = None
    for _ in range(2):
        assert volume.counts.received == 0 and not volume.is_open
        volume.update(events)
        after = volume.array.tobytes(), volume.landmark, volume.counts
        assert volume.counts.dropped_late > 0 and before in (None, after)
        before = after
        volume.reset()
