"""Hot pixels: all that were planted are found, and none where there are none."""

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.mask_learning import _neighbours, count_pixels, hot_pixels, learn_mask

SENSOR = (34, 34)
SAMPLES = sample_recordings()


def planted(pixels, n, *, seed=0, duration_us=315_000):
    """Packets of hot pixels: about n events each, at random times."""
    rng = np.random.default_rng(seed)
    for x, y in pixels:
        events = rng.poisson(n)
        t = np.sort(rng.integers(0, duration_us, events))
        yield events_of(t, [x] * events, [y] * events, rng.integers(0, 2, events))


def as_mask(pixels, sensor=SENSOR):
    mask = np.zeros(sensor[::-1], bool)
    for x, y in pixels:
        mask[y, x] = True
    return mask


def random_pixels(rng, n, sensor=SENSOR):
    """Pixels of which no 5x5 block holds more than three."""
    pixels = []
    while len(pixels) < n:
        x, y = (int(rng.integers(side)) for side in sensor)
        if (x, y) not in pixels and sum(abs(x - a) < 5 and abs(y - b) < 5 for a, b in pixels) < 3:
            pixels.append((x, y))
    return pixels


@pytest.mark.parametrize("digit", SAMPLES)
def test_no_pixel_of_a_clean_recording_is_hot(digit):
    assert not learn_mask(open_recording(SAMPLES[digit]), SENSOR).any()
    assert not learn_mask(open_recording(SAMPLES[digit]), SENSOR, factor=2).any()  # far from the bound


@pytest.mark.parametrize("digit", SAMPLES)
@pytest.mark.parametrize("seed", range(3))
def test_all_planted_pixels_are_found_and_no_others(digit, seed):
    rng = np.random.default_rng([digit, seed])
    pixels = random_pixels(rng, int(rng.integers(1, 12)))
    recording = open_recording(SAMPLES[digit])
    busiest = count_pixels(recording, SENSOR).max()
    packets = [*recording, *planted(pixels, 10 * busiest, seed=seed)]
    assert (learn_mask(packets, SENSOR) == as_mask(pixels)).all()


def test_hot_pixels_need_not_be_the_busiest():
    """In the dark corner of a recording 60 events are many; on the digit's edge they would be normal."""
    recording = open_recording(SAMPLES[0])
    packets = [*recording, *planted([(0, 0), (33, 0), (33, 33)], 60)]
    assert (learn_mask(packets, SENSOR) == as_mask([(0, 0), (33, 0), (33, 33)])).all()


@pytest.mark.parametrize("corner", [(0, 0), (33, 0), (0, 33), (33, 33), (1, 1), (32, 1), (0, 16), (16, 33)])
def test_at_the_border(corner):
    packets = [random_events(20_000), *planted([corner], 400)]
    assert (learn_mask(packets, SENSOR) == as_mask([corner])).all()


def test_four_neighbours_are_found_and_a_lamp_is_not():
    four = [(10, 10), (11, 10), (10, 11), (11, 11)]
    noise = random_events(5_000)
    assert (learn_mask([noise, *planted(four, 500)], SENSOR) == as_mask(four)).all()
    lamp = [(x, y) for x in range(10, 14) for y in range(10, 14)]
    assert not learn_mask([noise, *planted(lamp, 500)], SENSOR).any()


def test_a_line_that_moves_along_itself_is_not_hot():
    counts = np.zeros((20, 30), np.int64)
    counts[7, :] = 400
    counts[:, 0] = 300
    assert not hot_pixels(counts).any()
    counts[7, 12] = 400 * 6
    assert np.argwhere(hot_pixels(counts)).tolist() == [[7, 12]]


def test_hot_pixels_alone_in_the_dark():
    assert (learn_mask(planted([(3, 4), (20, 30)], 300), SENSOR) == as_mask([(3, 4), (20, 30)])).all()


def test_one_that_outshines_the_others_does_not_hide_them():
    packets = [random_events(2000), *planted([(5, 5)], 100_000), *planted([(6, 5), (30, 30)], 60)]
    assert (learn_mask(packets, SENSOR) == as_mask([(5, 5), (6, 5), (30, 30)])).all()


def test_chance_alone_is_not_hot():
    """Uniform noise of every strength: none of 100 sensors has a hot pixel."""
    rng = np.random.default_rng(0)
    for rate in (0.001, 0.01, 0.1, 0.5, 1, 2, 5, 20, 1000):
        for _ in range(100):
            assert not hot_pixels(rng.poisson(rate, (34, 34)).astype(np.int64)).any()


def test_chance_is_what_the_second_bound_holds_back():
    rng = np.random.default_rng(0)
    careless = [hot_pixels(rng.poisson(1, (260, 346)).astype(np.int64), false_alarms=1e9) for _ in range(3)]
    assert all(mask.any() for mask in careless)  # by the factor alone


def test_factor_and_bound_by_hand():
    counts = np.full((34, 34), 100)
    for n, is_hot in ((500, False), (510, True)):
        counts[9, 9] = n
        assert hot_pixels(counts).any() == is_hot  # the mean is 100.3: 5 times that is 501.7
    counts = np.zeros((34, 34), np.int64)
    for n, is_hot in ((8, False), (9, True)):  # 9 log 9 - 8 = 11.8 > log(1156 / 0.01) = 11.7 > 8 log 8 - 7 = 9.6
        counts[9, 9] = n
        assert hot_pixels(counts).any() == is_hot


@pytest.mark.parametrize("shape", [(34, 34), (5, 5), (2, 2), (1, 1), (1, 40), (7, 3)])
def test_neighbours_equal_a_plain_loop(shape):
    counts = np.random.default_rng(1).integers(0, 1000, shape)
    height, width = shape
    for y in range(height):
        for x in range(width):
            top, left = (max(0, min(at - 2, side - 5)) for at, side in ((y, height), (x, width)))
            others = [
                counts[j, i]
                for j in range(top, min(top + 5, height))
                for i in range(left, min(left + 5, width))
                if (j, i) != (y, x)
            ]
            others = sorted([*others, 0], reverse=True)
            fourth = others[3] if len(others) > 4 else others[-2] if len(others) > 1 else None
            if fourth is not None and counts[y, x] > fourth and height * width > 4:
                assert _neighbours(counts, np.array([y]), np.array([x])) == [fourth]


@pytest.mark.parametrize("sensor", [(1, 1), (2, 2), (3, 7), (40, 1)])
def test_small_sensors(sensor):
    assert learn_mask([random_events(3000, sensor=sensor)], sensor).shape == sensor[::-1]
    assert not learn_mask([random_events(3000, sensor=sensor)], sensor).any()


def test_no_events_no_hot_pixels():
    assert not learn_mask([], SENSOR).any()
    assert not learn_mask([None, random_events(0)], SENSOR).any()


def test_counts_equal_numpy():
    events = random_events(10_000, sensor=(50, 20), seed=3)
    expected = np.zeros((20, 50), int)
    np.add.at(expected, (events["y"], events["x"]), 1)
    assert (count_pixels(np.array_split(events, 7), (50, 20)) == expected).all()


def test_counts_are_left_as_they_are():
    counts = np.zeros((34, 34), np.int64)
    counts[3, 3] = 100
    before = counts.copy()
    assert hot_pixels(counts).sum() == 1 and (counts == before).all()


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"factor": 1}, "`factor` must be above 1, got 1"),
        ({"factor": float("nan")}, "`factor` must be above 1, got nan"),
        ({"false_alarms": 0}, "`false_alarms` must be above 0, got 0"),
        ({"sensor": (0, 5)}, r"`sensor` must have sides in \[1, 32768\] pixels, got \(0, 5\)"),
        ({"sensor": 34}, r"`sensor` must be \(width, height\) in whole pixels, got 34"),
        ({"source": [([1], [34], [0], [1])]}, r"`x` must be in \[0, 34\), got 34 at event 0"),
    ],
)
def test_wrong_arguments(settings, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        learn_mask(**({"source": [], "sensor": SENSOR} | settings))
