"""The log is a ring: the classifier's input stays right however often the ring has wrapped since its last read."""

import numpy as np
import pytest
from incremental.cases import Case, dense_of
from made import events_of, random_events

from async_tnt import TNTVolume
from async_tnt.kernels import layout as L
from async_tnt.kernels import state as S
from async_tnt.kernels.sync_input import NUMBERS_PER_LOGGED

TINY = Case((4, 4), 1, "signed", "none", (3, 5, 7), 3)
SMALL = Case((8, 8), 9, "signed", "running", (3, 5, 7), 3)
MIDDLE = Case((34, 34), 9, "split", "running", (3, 5, 7), 3)


def log_size(volume: TNTVolume) -> int:
    return int(volume.buffer.view(np.int64)[S.LOG_SIZE])


def n_worth_following(case: Case) -> int:
    """Up to this many new events the classifier follows the log; for more it reads all cells."""
    return int(np.prod(case.config.shape)) // NUMBERS_PER_LOGGED


def assert_right_after_packets(case: Case, sizes: list[int]) -> None:
    network, volume, twin = case.classifier(), case.volume(), case.volume()
    events = random_events(sum(sizes), seed=7, duration_us=3900, sensor=case.grid, start_us=1)
    for packet in np.split(events, np.cumsum(sizes)[:-1]):
        volume.update(packet)
        twin.update(packet)
        assert network.refresh(volume).tobytes() == dense_of(case)(twin.array).tobytes()
    assert volume.n_events == len(events)  # all in one window


@pytest.mark.parametrize("case", [TINY, SMALL, MIDDLE], ids=str)
@pytest.mark.parametrize("more", [-1, 0, 1])
def test_packets_about_as_long_as_the_log(case, more):
    size = log_size(case.volume())
    assert size == (2048 if case is MIDDLE else 512)
    assert_right_after_packets(case, [size + more] * 5 + [1] * 5 + [2 * size + more] * 3 + [1, 2, 3])


@pytest.mark.parametrize("case", [SMALL, MIDDLE], ids=str)
@pytest.mark.parametrize("more", [-1, 0, 1])
def test_packets_about_as_long_as_it_pays_to_follow_the_log(case, more):
    """So many of them that they cross the ring's end several times, each time elsewhere."""
    n = n_worth_following(case)
    assert 4 < n < 400
    assert_right_after_packets(case, [n + more] * (4 * log_size(case.volume()) // n))


def test_packets_of_all_lengths():
    sizes = np.random.default_rng(8).integers(1, 140, 150).tolist()
    assert_right_after_packets(MIDDLE, sizes)
    assert_right_after_packets(MIDDLE, [20_000, 1, 100, 20_000, 3, 512, 5])


def test_few_events_after_very_many():
    """The classifier counts logged events, and the ring has wrapped forty times before its first read."""
    volume, twin, network = MIDDLE.volume(), MIDDLE.volume(), MIDDLE.classifier()
    events = random_events(20_100, seed=9, duration_us=3900, sensor=MIDDLE.grid, start_us=1)
    for one in (volume, twin):
        one.update(events[:20_000])
    network.refresh(volume)
    for event in events[20_000:].tolist():
        volume.update_one(*event)
        twin.update_one(*event)
        assert network.refresh(volume).tobytes() == dense_of(MIDDLE)(twin.array).tobytes()


def test_a_window_of_an_hour():
    config = MIDDLE.config.replace(window_us=3600 * 1_000_000)
    model = MIDDLE.classifier(), dense_of(MIDDLE)
    volume = TNTVolume(config)
    start_us = 10**15
    for k in range(40):
        volume.update(random_events(300, seed=k, duration_us=60_000_000, start_us=start_us + 90_000_000 * k + 1))
        assert model[0].refresh(volume).tobytes() == model[1](volume.array).tobytes()
    assert volume.n_events == 12_000


def test_cells_that_cancel_leave_no_trace():
    """Opposite events at one place: the cells come back to zero, and so do the logits of an empty window."""
    case = Case((8, 8), 2, "signed", "none", (3, 5, 7), 3)
    network, volume = case.classifier(), case.volume()
    volume.open(0)
    empty = network.refresh(volume).tobytes()
    for k in range(700):
        volume.update(events_of([100, 100], [k % 8] * 2, [k % 7] * 2, [1, 0]))
        if k % 3 == 0:
            assert network.refresh(volume).tobytes() == empty
    volume.update_one(100, 3, 3, 1)
    assert network.refresh(volume).tobytes() != empty


def test_the_log_was_followed_where_it_pays():
    """Otherwise the tests above might all read all cells: of a few new events only their places are compared.

    A cell that no new event touches is given a wrong value in the classifier's input. It stays.
    """
    network, volume = MIDDLE.classifier(), MIDDLE.volume()
    volume.open(0)
    network.refresh(volume)
    layout, maps = network.network.layout, network.network.maps
    far_away = layout[L.INPUT] + (34 * layout[L.CHANNELS] + 0) * 36 + 34  # pixel (33, 33) of channel 0
    n = n_worth_following(MIDDLE)
    assert maps[far_away] == 0
    maps[far_away] = 5
    for _ in range(3):
        volume.update(([2000] * n, [17] * n, [17] * n, [1] * n))
        network.refresh(volume)
        assert maps[far_away] == 5
    volume.update(([2000] * (n + 1), [17] * (n + 1), [17] * (n + 1), [1] * (n + 1)))
    network.refresh(volume)
    assert maps[far_away] == 0
