"""Count and timestamp images: by hand, against the torch reference bit for bit, and however the stream is cut."""

import numpy as np
import pytest
import tnt_reference
from hypothesis import given
from hypothesis import strategies as st
from made import events_of, nasty_streams

from async_tnt import TNTConfig, TNTVolume
from async_tnt.representations import count_image, count_timestamp_image

SHAPES = [((34, 34), 105_000), ((5, 3), 7), ((2, 2), 1), ((64, 48), 1_000)]  # sensor, window_us
STARTS = [0, 123_456_789, 1_700_000_000_000_000]


def both_images(events, *, start_us, window_us, sensor, out=(None, None)):
    return (
        count_image(events, sensor=sensor, out=out[0]),
        count_timestamp_image(events, start_us=start_us, window_us=window_us, sensor=sensor, out=out[1]),
    )


def as_bits(images):
    return [np.asarray(image, np.float64).tobytes() for image in images]


def reference(events, *, sensor, **window):
    columns = [events[name] for name in "txyp"]
    return (
        tnt_reference.count_image(*columns, sensor=sensor),
        tnt_reference.count_timestamp_image(*columns, sensor=sensor, **window),
    )


BY_HAND = events_of(
    # ON at (1, 0): at the window's start, again at 1/4. OFF at (1, 0): at 1/2, then one that is older, 1/8.
    # ON at (2, 1): at the window's last microsecond. OFF at (0, 1): at the start only.
    # Not in the window [1000, 1800): OFF at (2, 0), one before it and one at its end.
    [1_000, 1_200, 1_400, 1_100, 1_799, 1_000, 999, 1_800],
    [1, 1, 1, 1, 2, 0, 2, 2],
    [0, 0, 0, 0, 1, 1, 0, 0],
    [1, 1, 0, 0, 1, 0, 0, 0],
)
AT = dict(start_us=1_000, window_us=800, sensor=(3, 2))


def test_by_hand():
    counts, four = both_images(BY_HAND, **AT)
    assert counts.dtype == np.int32 and four.dtype == np.float32
    assert counts.tolist() == [[[0, 2, 0], [0, 0, 1]], [[0, 2, 2], [1, 0, 0]]]
    assert four[:2].tolist() == [[[0, 2, 0], [0, 0, 1]], [[0, 2, 0], [1, 0, 0]]]
    assert four[2].tolist() == [[0, 0.25, 0], [0, 0, np.float32(799 / 800)]]
    assert four[3].tolist() == [[0, 0.5, 0], [0, 0, 0]]  # the newest, not the last to arrive; the start is 0


@given(st.data())
def test_any_packets_in_any_order_equal_the_reference_bit_for_bit(data):
    sensor, window_us = data.draw(st.sampled_from(SHAPES))
    start_us = data.draw(st.sampled_from(STARTS))
    begin = data.draw(st.sampled_from([start_us, max(0, start_us - window_us)]))  # some events before the window
    events = data.draw(nasty_streams(sensor, 3 * window_us, begin))  # and some after it
    at = dict(start_us=start_us, window_us=window_us, sensor=sensor)
    shuffled = events[np.random.default_rng(data.draw(st.integers(0, 9))).permutation(events.size)]
    got = both_images(None, **at)
    size = data.draw(st.sampled_from([1, 2, 7, 61]))
    for first in range(0, events.size, size):
        after = both_images(shuffled[first : first + size], **at, out=got)
        assert after[0] is got[0] and after[1] is got[1]
    assert as_bits(got) == as_bits(both_images(events, **at)) == as_bits(reference(events, **at))


GOOD = ([1_000], [0], [0], [1])


def test_invalid_events_change_nothing():
    images, events = both_images(GOOD, **AT), ([1, 1], [1, 3], [0, 0], [1, 1])
    before = as_bits(images)
    with pytest.raises(ValueError, match="`x` must be in"):
        count_image(events, sensor=(3, 2), out=images[0])
    with pytest.raises(ValueError, match="`x` must be in"):
        count_timestamp_image(events, **AT, out=images[1])
    assert as_bits(images) == before


@pytest.mark.parametrize(
    ("bad", "error", "message"),
    [
        (dict(sensor=(3, 1)), ValueError, r"`sensor` must have sides of 2 to 32768 pixels, got \(3, 1\)"),
        (dict(window_us=0), ValueError, r"`window_us` must be in \[1, 3600000000\], got 0"),
        (dict(start_us=-1), ValueError, r"`start_us` must be in \[0, 2\*\*62\), got -1"),
        (dict(out=[[0]]), TypeError, r"`out` must be an array that an earlier call returned, got list"),
        (
            dict(out=np.zeros((4, 3, 2), np.float32)),
            ValueError,
            r"of shape \(4, 2, 3\), got float32 of shape \(4, 3, 2\)",
        ),
        (dict(out=np.zeros((3, 2, 4), np.float32).T), ValueError, r"`out` must be contiguous, aligned and writeable"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_bad_settings(bad, error, message):
    with pytest.raises(error, match=message):
        count_timestamp_image(GOOD, **AT | bad)


def image_of(events, **settings):
    volume = TNTVolume(TNTConfig(sensor=(3, 2), window_us=40, transform="none", polarity="split", **settings))
    volume.open(10)
    volume.update(events)
    return volume.array


def test_the_images_of_a_configuration_by_hand():
    events = ([10, 20, 40, 30], [0, 2, 2, 2], [1, 0, 0, 1], [1, 0, 0, 1])  # t, x, y, p; one comes late
    settings = {"grid": (3, 2)}
    on, off = image_of(events, representation="count", **settings)
    assert on.tolist() == [[0, 0, 0], [1, 0, 1]] and off.tolist() == [[0, 0, 2], [0, 0, 0]]
    n_on, t_on, n_off, t_off = image_of(events, representation="count_time", **settings)
    assert np.array_equal(n_on, on) and np.array_equal(n_off, off)
    assert t_on.tolist() == [[0, 0, 0], [0, 0, 0.5]] and t_off.tolist() == [[0, 0, 0.75], [0, 0, 0]]
    assert image_of(events, representation="mean_time", **settings)[1].tolist() == [[0, 0, 0.5], [0, 0, 0]]
    on, off = image_of(events, representation="time_surface", **settings)  # ages: 1, half and a quarter of the window
    newest_on, newest_off = np.exp([-2.0, -1.0]), np.exp(-0.5)
    np.testing.assert_allclose(on, [[0, 0, 0], [newest_on[0], 0, newest_on[1]]], rtol=1e-6)
    np.testing.assert_allclose(off, [[0, 0, newest_off], [0, 0, 0]], rtol=1e-6)


def test_on_a_larger_grid_an_event_is_shared_by_the_cells_around_it():
    """A sensor of 3 pixels on a grid of 4: pixel 1 lies half way between columns 1 and 2."""
    events = ([20, 30], [1, 0], [0, 0], [1, 1])
    settings = {"grid": (4, 2)}
    n_on, t_on, *_ = image_of(events, representation="count_time", **settings)
    assert n_on[0].tolist() == [1, 0.5, 0.5, 0] and t_on[0].tolist() == [0.5, 0.25, 0.25, 0]
    assert image_of(events, representation="mean_time", **settings)[0, 0].tolist() == [0.5, 0.25, 0.25, 0]


@given(nasty_streams((12, 9), 1000, 50))
def test_a_volume_holds_what_the_functions_count(events):
    config = TNTConfig(sensor=(12, 9), grid=(12, 9), window_us=1000, transform="none", polarity="split")
    counted, timed = (TNTVolume(config.replace(representation=of, bins=None)) for of in ("count", "count_time"))
    counted.open(50), timed.open(50)
    counted.update(events), timed.update(events)
    assert np.array_equal(counted.array, count_image(events, sensor=(12, 9)))
    expected = count_timestamp_image(events, start_us=50, window_us=1000, sensor=(12, 9))
    assert np.array_equal(timed.array, expected[[0, 2, 1, 3]])
