"""Hot pixels: all that were planted are found, and none where there are none."""

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixel_masks import hot_pixels, learn_mask

SENSOR = (34, 34)
RECORDINGS = {digit: open_recording(sample_recordings()[digit]).read() for digit in (0, 1, 8)}


def planted(pixels, n, *, seed=0, duration_us=315_000):
    """Packets of hot pixels: about n events each, at random times."""
    rng = np.random.default_rng(seed)
    for x, y in pixels:
        events = rng.poisson(n)
        t = np.sort(rng.integers(0, duration_us, events))
        yield events_of(t, [x] * events, [y] * events, rng.integers(0, 2, events))


def found(packets, sensor=SENSOR, **settings):
    return {(x, y) for y, x in np.argwhere(learn_mask(packets, sensor, **settings)).tolist()}


FOUR = [(10, 10), (11, 10), (10, 11), (11, 11)]
BRIGHT = [(5, 5), (6, 5), (30, 30)]


@pytest.mark.parametrize(
    ("packets", "pixels"),
    [
        # in the dark corner of a recording 60 events are many; on the digit's edge they would be normal
        ([RECORDINGS[0], *planted([(0, 0), (33, 0), (33, 33)], 60)], [(0, 0), (33, 0), (33, 33)]),
        *(([random_events(20_000), *planted([at], 400)], [at]) for at in [(0, 0), (32, 1)]),
        ([random_events(5_000), *planted(FOUR, 500)], FOUR),
        ([random_events(5_000), *planted([(x, y) for x in range(10, 14) for y in range(10, 14)], 500)], []),  # a lamp
        (list(planted([(3, 4), (20, 30)], 300)), [(3, 4), (20, 30)]),  # alone in the dark
        ([random_events(2000), *planted(BRIGHT[:1], 100_000), *planted(BRIGHT[1:], 60)], BRIGHT),  # one outshines two
        *(([recording], []) for recording in RECORDINGS.values()),
        ([None, random_events(0)], []),
    ],
)
def test_hot_pixels_at_borders_side_by_side_and_in_the_dark(packets, pixels):
    assert found(packets) == set(pixels)


def test_a_line_that_moves_along_itself_is_not_hot():
    counts = np.zeros((20, 30), np.int64)
    counts[7, :] = 400
    counts[:, 0] = 300
    assert not hot_pixels(counts).any()
    counts[7, 12] = 400 * 6
    before = counts.copy()
    assert np.argwhere(hot_pixels(counts)).tolist() == [[7, 12]] and (counts == before).all()


def test_chance_alone_is_not_hot_by_the_second_bound():
    """Uniform noise of every strength: none of 50 sensors has a hot pixel; by the factor alone, many have."""
    rng = np.random.default_rng(0)
    for rate in (0.001, 0.1, 1, 5, 1000):
        for _ in range(50):
            assert not hot_pixels(rng.poisson(rate, (34, 34)).astype(np.int64)).any()
    assert hot_pixels(rng.poisson(1, (260, 346)).astype(np.int64), false_alarms=1e9).any()


@pytest.mark.parametrize(
    ("others", "n", "is_hot"),
    [
        (100, 500, False),  # the mean is 100.3: 5 times that is 501.7
        (100, 510, True),
        (0, 8, False),  # 9 log 9 - 8 = 11.8 > log(1156 / 0.01) = 11.7 > 8 log 8 - 7 = 9.6
        (0, 9, True),
    ],
)
def test_factor_and_bound_by_hand(others, n, is_hot):
    counts = np.full((34, 34), others)
    counts[9, 9] = n
    assert hot_pixels(counts).any() == is_hot


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"factor": 1}, "`factor` must be above 1, got 1"),
        ({"false_alarms": 0}, "`false_alarms` must be above 0, got 0"),
        ({"source": [([1], [34], [0], [1])]}, r"`x` must be in \[0, 34\), got 34 at event 0"),
    ],
)
def test_wrong_arguments(settings, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        learn_mask(**({"source": [], "sensor": SENSOR} | settings))
