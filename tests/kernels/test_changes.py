"""Which places of a map see a changed one: by words of 64, as if each were looked at by itself."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from async_tnt.kernels.network.changes import Taps, list_places, note_changes, seen_from

FRAME = 10  # words of zeros around the row


@njit
def find(bits, words, n_columns, taps, places):
    """List the places of row 7 that see a changed column. Returns how many."""
    end = 0
    for word in range(words):
        seen = seen_from(bits, FRAME, word, taps)
        end = list_places(seen, n_columns - 64 * word, 7, word, places, end)
    return end


@njit
def note(bits, column, changed):
    """`note_changes`, to be called from Python."""
    note_changes(bits, FRAME, column, changed)


@given(st.data())
def test_a_place_is_listed_if_a_tap_falls_on_a_changed_one(data):
    width = data.draw(st.sampled_from([1, 2, 8, 63, 64, 65, 128, 150]))
    stride = data.draw(st.integers(1, 5))
    dilation = data.draw(st.integers(1, 4))
    n_taps = data.draw(st.one_of(st.integers(1, 9), st.integers(60, 150)))
    padding = data.draw(st.integers(0, (n_taps - 1) * dilation))
    n_columns = (width + 2 * padding - (n_taps - 1) * dilation - 1) // stride + 1
    if n_columns < 1:
        return
    share = data.draw(st.sampled_from([0.02, 0.3, 1.0]))
    changed = np.random.default_rng(data.draw(st.integers(0, 99))).random(width) < share

    bits = np.zeros(2 * FRAME + 20, np.uint64)
    for column in np.flatnonzero(changed).tolist():
        note(bits, column, np.uint64(1))
    places = np.zeros(n_columns + 1, np.uint32)
    n = find(bits, -(-n_columns // 64), n_columns, Taps(n_taps, stride, padding, dilation), places)

    sources = np.arange(n_columns)[:, None] * stride - padding + np.arange(n_taps) * dilation
    inside = (sources >= 0) & (sources < width)
    seen = (inside & changed[sources.clip(0, width - 1)]).any(axis=1)
    assert places[:n].tolist() == [7 << 16 | x for x in np.flatnonzero(seen)]


@given(
    st.integers(0, 180), st.integers(1, 64), st.integers(0, 2**64 - 1), st.integers(0, 2**64 - 1)
)
def test_neighbours_are_noted_together(column, n, changed, before):
    changed %= 1 << n
    bits = np.zeros(FRAME + 5, np.uint64)
    bits[FRAME] = before
    note(bits, column, np.uint64(changed))
    found = sum(int(word) << 64 * k for k, word in enumerate(bits[FRAME:]))
    assert found == before | changed << column
