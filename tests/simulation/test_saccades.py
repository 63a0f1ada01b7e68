"""Cutting recordings: nothing is lost, an event at a cut belongs to the piece after it; N-MNIST's saccades."""

import numpy as np
import pytest
import tnt_reference
from hypothesis import given
from hypothesis import strategies as st
from made import events_of, nasty_streams

from async_tnt import EVENT_DTYPE
from async_tnt.simulation import segment, split_saccades


def at_times(*t):
    n = len(t)
    return events_of(t, range(n), [0] * n, [k % 2 for k in range(n)])  # x tells which is which


def test_an_event_at_a_cut_belongs_to_the_piece_after_it():
    pieces = segment(at_times(0, 9, 10, 10, 11, 19, 20), [10, 20, 30])
    assert [piece["t"].tolist() for piece in pieces] == [[0, 9], [10, 10, 11, 19], [20], []]
    assert all(piece.dtype == EVENT_DTYPE for piece in pieces)


def test_times_that_run_backwards_keep_their_order_within_each_piece():
    pieces = segment(at_times(12, 3, 10, 25, 9, 11), [10, 20])
    assert [piece["t"].tolist() for piece in pieces] == [[3, 9], [12, 10, 11], [25]]
    assert [piece["x"].tolist() for piece in pieces] == [[1, 4], [0, 2, 5], [3]]


@given(st.data())
def test_nothing_is_lost_and_every_event_is_where_the_reference_says(data):
    start_us = data.draw(st.sampled_from([0, 1_700_000_000_000_000]))
    window_us = data.draw(st.sampled_from([1, 16, 800]))
    events = data.draw(nasty_streams((34, 34), window_us, start_us))
    offsets = st.one_of(st.integers(0, window_us + 1), st.sampled_from([0, window_us // 2, window_us - 1]))
    cuts = sorted(start_us + cut for cut in data.draw(st.sets(offsets, max_size=5)))
    before, pieces = events.copy(), segment(events, cuts)
    assert len(pieces) == len(cuts) + 1
    index = tnt_reference.segment_index(events["t"], cuts).numpy()
    for k, piece in enumerate(pieces):
        assert piece.tobytes() == events[index == k].tobytes()
        piece["x"] = 0  # a copy
    assert (events["x"] == before["x"]).all()


def test_split_saccades_at_105_210_and_315_ms_on_any_clock():
    clock = 1_700_000_000_000_000
    for start_us in (0, clock):
        t = np.array([0, 104_999, 105_000, 209_999, 210_000, 314_999, 315_000, 320_000]) + start_us
        pieces = split_saccades(at_times(*t), start_us=start_us)
        assert [piece["x"].tolist() for piece in pieces] == [[0, 1], [2, 3], [4, 5], [6, 7]]
    before = split_saccades(at_times(5), start_us=10)
    assert [len(piece) for piece in before] == [1, 0, 0, 0]


def test_bad_arguments():
    with pytest.raises(ValueError, match=r"`cuts_us` must increase, got 10 after 10"):
        segment(at_times(1, 2), [10, 10])
    with pytest.raises(ValueError, match=r"`cuts_us` must be in \[0, 2\*\*62\), got -5"):
        segment(at_times(1, 2), [-5])
    with pytest.raises(ValueError, match=r"`p` must be 0 or 1, or -1 or \+1, got 3 at event 1"):
        segment(([1, 2], [0, 0], [0, 0], [1, 3]), [5])
