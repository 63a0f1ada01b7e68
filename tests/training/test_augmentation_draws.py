"""What augmentation draws: how its changes are distributed, and the point about which windows are
turned."""

from itertools import pairwise

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt.kernels.training.window_batches import (
    EDGE,
    HOT_PIXELS,
    ONE_POLARITY,
    PATCH,
    SCATTERED,
)
from async_tnt.training.augment import (
    FINE,
    KINDS,
    Augmentation,
    during_slice,
    fineness,
    showing_nothing,
    unchanged,
)
from async_tnt.training.recordings import Recordings
from async_tnt.training.windows import Windows
from async_tnt.volume.config import MAX_SIDE, TNTConfig

CONFIG = TNTConfig()
N = 5_000
"""Windows whose changes are drawn: shares are right within .03, which is four standard errors."""
STILL = dict.fromkeys(Augmentation.__dataclass_fields__, 0)
"""No change at all."""


def drawn(n=N, **changes):
    recordings = Recordings.from_events([random_events(50)], [0])
    windows = Windows(recordings, np.zeros(n, int), np.zeros(n, int))
    return Augmentation(**STILL | changes).draw(windows, CONFIG, np.random.default_rng(0))


def fineness_of(draws):
    return (draws.sensor[0] - 1) / (CONFIG.sensor[0] - 1)


def test_a_window_is_turned_about_the_middle_of_its_own_recording():
    """Half way between its outermost events. Neither the sensor's middle, nor another
    recording's."""
    events = [
        events_of([1, 2, 3], [2, 8, 3], [4, 5, 10], [1, 1, 1]),
        events_of([], [], [], []),
        events_of([1, 2], [20, 30], [30, 32], [1, 1]),
        events_of([], [], [], []),
    ]
    recordings = Recordings.from_events(events, [0, 0, 1, 1])
    assert recordings.middles.tolist() == [[5, 7], [0, 0], [25, 31], [0, 0]]
    windows = Windows(recordings, np.array([0, 2] * 50), np.zeros(100, int))
    turning = Augmentation(shift_px=0, mirror=True)
    draws = turning.draw(windows, CONFIG, np.random.default_rng(0))
    middles = np.array([[5.0, 7], [25, 31]] * 50)
    moved = np.einsum("nij,nj->ni", draws.matrix[:, :, :2], middles) + draws.matrix[:, :, 2]
    assert np.ptp(draws.matrix[:, 0, 0]) > 0
    np.testing.assert_allclose(moved, fineness_of(draws) * middles)


@pytest.mark.parametrize("name", ["shift_px", "translate_px"])
def test_a_shift_in_x_says_nothing_of_the_one_in_y(name):
    draws = drawn(**{name: 3})
    shifts = draws.matrix[:, :, 2] / fineness_of(draws)
    assert abs(np.corrcoef(shifts.T)[0, 1]) < 0.06
    assert np.abs(shifts).max() == pytest.approx(3, abs=0.01)
    assert np.abs(shifts.mean(axis=0)).max() < 0.15
    if name == "translate_px":
        pixels, counts = np.unique(np.rint(shifts), return_counts=True)
        assert pixels.tolist() == list(range(-3, 4))
        np.testing.assert_allclose(shifts, np.rint(shifts), atol=1e-9)
        np.testing.assert_allclose(counts / counts.sum(), 1 / 7, atol=0.02)


def test_the_logarithm_of_the_length_of_a_partial_window_is_uniform():
    """So that half of them are shorter than a tenth, from a hundredth on."""
    until_us = drawn(partial=1.0, partial_from_ms=1.05).until_us
    assert 1_050 <= until_us.min() < 1_060 and 104_000 < until_us.max() <= 105_000
    found = np.quantile(np.log10(until_us / 105_000), [0.25, 0.5, 0.75])
    np.testing.assert_allclose(found, [-1.5, -1.0, -0.5], atol=0.06)


def test_a_partial_window_has_an_instant_at_least_and_is_no_longer_than_a_window():
    assert 1 <= drawn(partial=1.0, partial_from_ms=0).until_us.min() < 5
    assert set(drawn(partial=1.0, partial_from_ms=500).until_us) == {CONFIG.window_us}


def test_all_kinds_of_nothing_are_drawn_alike():
    draws = drawn(nothing=1.0)
    kinds, counts = np.unique(draws.content, return_counts=True)
    assert set(kinds) == {SCATTERED, ONE_POLARITY, HOT_PIXELS, PATCH, EDGE}
    np.testing.assert_allclose(counts / N, 1 / len(KINDS), atol=0.03)


@pytest.mark.parametrize(("kind", "share_of_one"), [(ONE_POLARITY, 1.0), (EDGE, 0.5)])
def test_what_is_of_one_polarity_is_as_often_on_as_off(kind, share_of_one):
    draws = showing_nothing(unchanged(N, CONFIG), np.full(N, kind), np.random.default_rng(0))
    on_share = draws.place[:, 7]
    found = np.mean(on_share == 0), np.mean(on_share == 1)
    assert found == pytest.approx((share_of_one / 2, share_of_one / 2), abs=0.03)


def test_what_shows_nothing_stands_within_the_stated_shares_of_the_sensor():
    """The sensor is twice as wide as high: an edge is measured by its longer side."""
    wide = TNTConfig(sensor=(60, 30))
    rng = np.random.default_rng(0)
    place = {}
    for name, kind in KINDS.items():
        place[name] = showing_nothing(unchanged(N, wide), np.full(N, kind), rng).place

    def assert_uniform(values, least, most):
        """They reach from end to end, and half of them are below the middle."""
        assert least <= values.min() < least + 0.01 * (most - least)
        assert most - 0.01 * (most - least) < values.max() <= most
        assert np.median(values) == pytest.approx((least + most) / 2, abs=0.03 * (most - least))

    for name in ("scattered", "of one polarity"):
        assert (place[name][:, :4] == (0, 0, 60, 30)).all()
    hot = place["at hot pixels"][:, :6].reshape(-1, 2)
    assert (hot == np.floor(hot)).all()
    assert (hot.min(axis=0).tolist(), hot.max(axis=0).tolist()) == ([0, 0], [59, 29])
    patch = place["on a patch"]
    assert_uniform(patch[:, 2], 6, 30)
    assert_uniform(patch[:, 3], 3, 15)
    assert (patch[:, :2] >= 0).all() and (patch[:, :2] + patch[:, 2:4] <= (60, 30)).all()
    edge = place["along an edge"]
    assert_uniform(edge[:, 0], 15, 45)
    assert_uniform(edge[:, 1], 7.5, 22.5)
    assert_uniform(np.arctan2(edge[:, 3], edge[:, 2]), -np.pi, np.pi)
    for column, least, most in ((4, 0.2, 1.2), (5, 0.01, 0.1), (6, 0.4, 2.0)):
        assert_uniform(edge[:, column], 60 * least, 60 * most)


def test_an_edge_goes_on_in_a_slice_where_it_ended_in_the_slice_before():
    """All slices together have the edge's whole way, half of it on either side of its middle."""
    whole = showing_nothing(unchanged(3, CONFIG), np.full(3, EDGE), np.random.default_rng(0))
    before = whole.place.copy()
    slices = [during_slice(whole, b, 4) for b in range(4)]
    assert (whole.place == before).all()

    def ends(draws):
        """The middle of the edge at the beginning and at the end: (2, N, 2)."""
        normal = draws.place[:, 2:4]
        half = draws.place[:, 4:5] / 2
        return np.stack([draws.place[:, :2] - half * normal, draws.place[:, :2] + half * normal])

    np.testing.assert_allclose(ends(slices[0])[0], ends(whole)[0])
    np.testing.assert_allclose(ends(slices[3])[1], ends(whole)[1])
    for one, next_one in pairwise(slices):
        np.testing.assert_allclose(ends(one)[1], ends(next_one)[0])


def test_augmented_events_have_positions_that_a_sensor_may_have():
    for side in (2, 3, 34, 1024, 1025, 1026, 1280, MAX_SIDE // 2, MAX_SIDE - 1, MAX_SIDE):
        fine = fineness((side, 2))
        assert fine == fineness((2, side)) and 1 <= fine <= FINE
        assert (side - 1) * fine + 1 <= MAX_SIDE
        assert fine == FINE or (side - 1) * (fine + 1) + 1 > MAX_SIDE


@pytest.mark.parametrize("name", STILL)
def test_a_change_below_zero_is_refused_and_a_share_above_one(name):
    with pytest.raises(ValueError, match=rf"^`{name}` must be in \[0, (1.0|inf)\], got -1$"):
        Augmentation(**{name: -1})
    if name.endswith(("_ms", "_px", "_deg")) or name == "shear":
        assert getattr(Augmentation(**{name: 2}), name) == 2
        return
    with pytest.raises(ValueError, match=rf"^`{name}` must be in \[0, 1.0\], got 2$"):
        Augmentation(**{name: 2})
