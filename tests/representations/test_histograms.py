"""HATS, by hand: which earlier events count, and what they are divided by."""

import numpy as np
from made import random_events

from async_tnt.config import TNTConfig
from async_tnt.volume import TNTVolume


def histograms_of(events, **settings):
    config = TNTConfig(representation="hats", sensor=(20, 10), grid=(2, 2), window_us=100, **settings)
    volume = TNTVolume(config)
    volume.open(0)
    volume.update(events)
    return volume.array.reshape(-1, 7, 7, 2, 2)  # polarity, z_y + 3, z_x + 3, row, column


def test_earlier_events_of_the_same_cell_and_polarity_count():
    """Cells of 10 x 5 pixels. In the left upper one, ON at (2, 1) twice, then at (4, 2); OFF at (4, 1)."""
    t, x, y, p = np.array([(1, 2, 1, 1), (2, 2, 1, 1), (3, 4, 1, 0), (4, 4, 2, 1), (5, 9, 4, 1), (6, 10, 4, 1)]).T
    histograms = histograms_of((t, x, y, p))
    assert histograms.shape == (2, 7, 7, 2, 2)
    expected = np.zeros_like(histograms)
    expected[0, 3, 3, 0, 0] = 1 / 5  # the second at (2, 1) finds the first; five events are in this cell
    expected[0, 2, 1, 0, 0] = 2 / 5  # that at (4, 2) finds both, two pixels to the left and one up
    np.testing.assert_allclose(histograms, expected, rtol=1e-6)  # (9, 4) is too far; (10, 4) is in the next cell
    both = histograms_of((t, x, y, p), polarity="unsigned")
    expected[0, 3, 1, 0, 0] = 2 / 5  # the OFF event finds both ON events
    expected[0, 2, 3, 0, 0] = 1 / 5  # and is found
    np.testing.assert_allclose(both, expected[:1], rtol=1e-6)


def test_time_does_not_matter_but_order_does():
    events = random_events(300, seed=3, duration_us=100, sensor=(20, 10))
    late = events.copy()
    late["t"] = late["t"][::-1]
    np.testing.assert_array_equal(histograms_of(events), histograms_of(late))
    assert not np.array_equal(histograms_of(events), histograms_of(events[::-1]))
