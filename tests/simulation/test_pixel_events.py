"""The event camera's pixel: numbers by hand, and the kernel against the reference, by event."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_scenes import noiseless_events
from tnt_reference.simulator import low_pass as reference_low_pass
from tnt_reference.simulator import simulate_events as reference_events

from async_tnt.kernels.training.simulate import low_pass
from async_tnt.simulation.simulator import AFTER_US, PixelModel, simulate

# light of one pixel, times in us, settings (thresholds 1 where not stated), events (t, p)
BY_HAND = {
    # L rises by 3.5 in 7,000 us: it reaches 1, 2 and 3 at 2,000, 4,000 and 6,000 us
    "a ramp over three thresholds": (
        [0, 3.5],
        [0, 7_000],
        {},
        [(2_000, 1), (4_000, 1), (6_000, 1)],
    ),
    # up to 2 in 1,000 us with C_on 0.5, then down to -0.2 with C_off 0.8: from 2 to 1.2 and 0.4,
    # 0.8 / 2.2 ms each
    "ON and OFF thresholds differ": (
        [0, 2, -0.2],
        [0, 1_000, 2_000],
        {"threshold_on": 0.5, "threshold_off": 0.8},
        [(250, 1), (500, 1), (750, 1), (1_000, 1), (1_364, 0), (1_727, 0)],
    ),
    # 0.6 each: 0.6 + 0.4 of the second frame reaches 1; 2 is reached 0.2/0.6 into the fourth
    "the level carries over": (
        [0, 0.6, 1.2, 1.8, 2.4],
        [0, 300, 600, 900, 1_200],
        {},
        [(500, 1), (1_000, 1)],
    ),
    "less than a threshold": ([0, 0.99, -0.99, 0], [0, 1_000, 2_000, 3_000], {}, []),
    "a threshold met exactly at a frame": (
        [0, 1, 1, 1],
        [0, 1_000, 2_000, 3_000],
        {},
        [(1_000, 1)],
    ),
    # L(t) = t / 1000. An event at 1,000 us, blind to 2,500, level 2.5. The next at 3,500, blind to
    # 5,000, level 5. The last at 6,000.
    "the level follows the light in reset": (
        [0, 7],
        [0, 7_000],
        {"refractory_us": 1_500},
        [(1_000, 1), (3_500, 1), (6_000, 1)],
    ),
    # event at 500 (L = 1); blind to 2,250, where L = 2 - 0.25 x 2 = 1.5; OFF at L = 0.5, 2,750 us
    "reset over two frames": (
        [0, 2, 2, 0],
        [0, 1_000, 2_000, 3_000],
        {"refractory_us": 1_750},
        [(500, 1), (2_750, 0)],
    ),
    "a reference far below": ([2.5, 2.5], [100, 200], {"reference": 0.0}, [(100, 1), (100, 1)]),
    "a reference far above": ([2.5, 2.5], [100, 200], {"reference": 4.0}, [(100, 0)]),
    "times are rounded": ([0, 3], [0, 10], {}, [(3, 1), (7, 1), (10, 1)]),
    "a half is rounded up": (
        [0, 2],
        [0, 5],
        {"threshold_on": 0.5},
        [(1, 1), (3, 1), (4, 1), (5, 1)],
    ),
    # at 7.1 and 7.2 up past 1 and 2, at 7.3 and 7.4 down past 1 and 0
    "one microsecond keeps its order": (
        [0, 2, 0],
        [7.0, 7.2, 7.4],
        {},
        [(7, 1), (7, 1), (7, 0), (7, 0)],
    ),
}


def kernel_events(*arguments):
    """The kernel's events, as those of the reference."""
    return noiseless_events(*arguments).tolist()


@pytest.mark.parametrize("events_of", [kernel_events, reference_events])
@pytest.mark.parametrize(("light", "times", "settings", "expected"), BY_HAND.values(), ids=BY_HAND)
def test_one_pixel_by_hand(light, times, settings, expected, events_of):
    frames = np.array(light, float).reshape(-1, 1, 1)
    threshold_on = np.full((1, 1), settings.get("threshold_on", 1.0))
    threshold_off = np.full((1, 1), settings.get("threshold_off", 1.0))
    reference = np.full((1, 1), settings.get("reference", light[0]), float)
    refractory_us = settings.get("refractory_us", 0.0)
    events = events_of(frames, times, threshold_on, threshold_off, reference, refractory_us)
    assert [(t, p) for t, x, y, p in events] == expected


def test_more_events_than_the_first_buffer_holds():
    # 5 x 4 pixels x 1,000 crossings, against 4,096 places to begin with
    frames = np.stack([np.zeros((4, 5)), np.full((4, 5), 1000.25)])
    events = noiseless_events(frames, [0, 1_000_250], 1.0, 1.0)
    np.testing.assert_array_equal(events["t"], np.repeat(np.arange(1, 1001) * 1000, 20))


@given(
    seed=st.integers(0, 2**32),
    refractory_us=st.sampled_from([0.0, 1.0, 333.3, 1_000.0, 2_500.0, 40_000.0]),
    mismatch=st.sampled_from([0.0, 0.3]),
    roughness=st.sampled_from([0.05, 0.5, 3.0]),
)
def test_kernel_equals_reference_event_for_event(seed, refractory_us, mismatch, roughness):
    rng = np.random.default_rng(seed)
    frames = np.cumsum(rng.normal(0.0, roughness, (12, 4, 5)), axis=0)
    frames[rng.integers(1, 12)] = frames[0]  # still light and repeated values too
    times = 100 + np.cumsum(rng.uniform(1.0, 2_000.0, 12))
    on = 0.3 * np.exp(mismatch * rng.standard_normal((4, 5)))
    off = 0.4 * np.exp(mismatch * rng.standard_normal((4, 5)))
    reference = frames[0] + rng.uniform(-1.0, 1.0, (4, 5))
    expected = reference_events(frames, times, on, off, reference, refractory_us)
    events = noiseless_events(frames, times, on, off, reference, refractory_us)
    assert events.tolist() == expected and (expected or roughness < 3)


def test_background_events_of_still_light_have_the_stated_rate_and_polarity():
    # 5 Hz x 600 pixels x 10 s = 30,000 events. Four standard deviations are 693 events, and 0.0106
    # of the ON share.
    model = PixelModel(noise_hz=5.0, noise_on_share=0.7)
    still = np.zeros((2, 20, 30))
    events = simulate(still, np.array([0, 10_000_000]), np.random.default_rng(0), model)
    assert abs(len(events) - 30_000) < 693
    assert abs(events["p"].mean() - 0.7) < 0.0106
    counts = np.zeros((20, 30))
    np.add.at(counts, (events["y"], events["x"]), 1)
    assert counts.min() > 15
    assert (np.diff(events["t"]) >= 0).all()
    assert events["t"].max() < 10_000_000

    quiet = PixelModel(noise_hz=0.0)
    assert len(simulate(still, np.array([0, 10_000]), np.random.default_rng(0), quiet)) == 0


def test_bandwidth_equals_reference():
    rng = np.random.default_rng(0)
    frames = np.log(rng.uniform(0.02, 1, (9, 3, 2)))
    times = np.cumsum(rng.uniform(1, 4_000, 9))
    found = low_pass(frames, times, 300.0, 0.1)
    for y, x in np.ndindex(3, 2):
        expected = reference_low_pass(frames[:, y, x], times, 300.0, 0.1)
        np.testing.assert_allclose(found[:, y, x], expected, rtol=1e-12)


def test_a_dark_pixel_answers_later():
    """After a step of 2.5 thresholds, the last event of a dark pixel comes ten times as late.

    The bandwidth is 100 Hz in full light, and a tenth of it in the dark. Behind a low-pass a share
    s of the step is reached after ln(1 / (1 - s)) / (2 pi f). A level begins within a threshold of
    its light, so that the last event comes when 1.5 to 2.5 thresholds are reached: after 1.5 ms or
    later, and in the dark after 15 ms or later.
    """
    pixels = PixelModel(0.2, 0.2, 0.0, 0.0, 0.0, bandwidth_hz=100.0)
    times = np.arange(0, 300_000, 10.0)
    for light, earliest_us in ((0.0, 1_458), (-5.0, 14_583)):
        frames = np.where(times > 0, light, light - 0.5).reshape(-1, 1, 1) + np.zeros((1, 6, 6))
        events = simulate(frames, times, np.random.default_rng(0), pixels)
        last = np.zeros((6, 6))
        np.maximum.at(last, (events["y"], events["x"]), events["t"])
        assert 0.98 * earliest_us < last.min() < 1.4 * earliest_us


def test_leak_hot_pixels_and_after_pulses_by_their_rates():
    """In 10 s of still light, pixels give as many events of each kind as their rates say."""

    def simulated(**rates):
        pixels = PixelModel(mismatch=0.0, refractory_us=0.0, noise_hz=0.0, **rates)
        still = np.zeros((2, 20, 30))
        return simulate(still, np.array([0, 10_000_000]), np.random.default_rng(0), pixels)

    # Each pixel leaks 3 ON events a second, the first after half an interval.
    leaked = simulated(leak_hz=3.0)
    assert (leaked["p"] == 1).all()
    assert len(leaked) == pytest.approx(600 * 29.5, rel=0.01)

    # A tenth of the pixels are hot.
    hot = simulated(hot_share=0.1, hot_hz=20.0)
    n_hot = len(np.unique(hot["y"].astype(int) * 30 + hot["x"]))
    assert 40 < n_hot < 80
    assert len(hot) == pytest.approx(200 * n_hot, rel=0.5)

    # A fifth of the events are followed by one of the other sign within a millisecond.
    after = simulated(leak_hz=3.0, after_share=0.2)
    later = after[after["p"] == 0]
    assert len(later) == pytest.approx(600 * 30 * 0.2, rel=0.06)
    for event in later[:50]:
        first = leaked[(leaked["x"] == event["x"]) & (leaked["y"] == event["y"])]["t"]
        assert ((event["t"] - first > 0) & (event["t"] - first < AFTER_US)).any()


def pixels_of(events, shape):
    """Events of each pixel."""
    counts = np.zeros(shape, int)
    np.add.at(counts, (events["y"], events["x"]), 1)
    return counts


def test_each_pixel_leaks_by_its_own_threshold():
    """Four events a second, whether its threshold is low or high."""
    pixels = PixelModel(mismatch=0.5, refractory_us=0.0, noise_hz=0.0, leak_hz=4.0)
    still = np.zeros((2, 4, 5))
    events = simulate(still, np.array([0, 10_000_000]), np.random.default_rng(0), pixels)
    for y, x in np.ndindex(4, 5):
        of_pixel = events[(events["x"] == x) & (events["y"] == y)]
        assert len(of_pixel) > 20
        assert set(np.diff(of_pixel["t"])) <= {249_999, 250_000, 250_001}


def test_thresholds_of_on_and_off_differ_from_pixel_to_pixel_independently():
    """After 100 mean thresholds up and 100 down, by the counts of each sign."""
    pixels = PixelModel(0.2, 0.2, mismatch=0.2, refractory_us=0.0, noise_hz=0.0)
    light = np.array([0.0, 20.0, 0.0])[:, None, None] + np.zeros((20, 30))
    events = simulate(light, np.array([0, 1e6, 2e6]), np.random.default_rng(0), pixels)
    on, off = [np.log(pixels_of(events[events["p"] == p], (20, 30))).ravel() for p in (1, 0)]
    assert [on.std(), off.std()] == pytest.approx([0.2, 0.2], rel=0.1)
    assert abs(np.corrcoef(on, off)[0, 1]) < 0.15


def test_a_level_begins_anywhere_from_one_threshold_below_to_the_other_one_above():
    """Thresholds are .4 and .1, so levels are in a range of .5. A rise or fall by .1 reaches the
    threshold of a fifth of the pixels."""
    pixels = PixelModel(0.4, 0.1, mismatch=0.0, refractory_us=0.0, noise_hz=0.0)
    for change, p, share in ((0.1, 1, 0.2), (-0.05, 0, 0.1), (-0.1, 0, 0.2), (0.4, 1, 0.8)):
        light = np.array([0.0, change])[:, None, None] + np.zeros((60, 50))
        events = simulate(light, np.array([0, 1_000]), np.random.default_rng(0), pixels)
        assert set(events["p"]) == {p}
        assert (pixels_of(events, (60, 50)) > 0).mean() == pytest.approx(share, abs=0.03)


def test_events_of_one_moment_come_row_by_row():
    """All events of 4 x 5 pixels within 2 us: sorted by time, then row, then column."""
    pixels = PixelModel(refractory_us=0.0, noise_hz=0.0)
    rise = np.array([0.0, 3.0])[:, None, None] + np.zeros((4, 5))
    events = simulate(rise, np.array([0, 2]), np.random.default_rng(0), pixels)
    rows = events[["t", "y", "x"]].tolist()
    assert len(rows) > 200
    assert rows == sorted(rows)


def test_no_threshold_is_below_the_least():
    """Thresholds that differ much are at least .001: a rise by 1 gives at most 1,000 events."""
    pixels = PixelModel(1e-3, 1e-3, mismatch=1.0, refractory_us=0.0, noise_hz=0.0)
    rise = np.array([0.0, 1.0])[:, None, None] + np.zeros((4, 5))
    events = simulate(rise, np.array([0, 1e6]), np.random.default_rng(0), pixels)
    counts = pixels_of(events, (4, 5))
    assert 999 <= counts.max() <= 1_000
    assert counts.min() < 500


def test_hot_pixels_differ_and_after_pulses_come_at_any_time_of_a_millisecond():
    still = np.zeros((2, 20, 30))
    times = np.array([0, 10_000_000])
    quiet = {"mismatch": 0.0, "refractory_us": 0.0, "noise_hz": 0.0}
    hot = PixelModel(**quiet, hot_share=0.2, hot_hz=20.0)
    counts = pixels_of(simulate(still, times, np.random.default_rng(0), hot), (20, 30))
    counts = counts[counts > 0]
    assert counts.std() > 0.7 * counts.mean()  # of an exponential distribution they are equal
    assert (pixels_of(simulate(still, times, np.random.default_rng(0), hot), (20, 30)) > 0)[
        :, 20:
    ].any()

    leaking = PixelModel(**quiet, leak_hz=3.0, after_share=0.2)
    events = simulate(still, times, np.random.default_rng(0), leaking)
    events = events[np.lexsort((events["t"], events["x"], events["y"]))]
    late_us = np.diff(events["t"].astype(np.int64))[events["p"][1:] == 0]
    assert len(late_us) > 3_000
    assert 1 <= late_us.min() < 20
    assert 980 < late_us.max() < AFTER_US
    assert np.median(late_us) == pytest.approx(500, rel=0.1)


@pytest.mark.parametrize(
    ("frames", "times", "message"),
    [
        (
            np.zeros((2, 3)),
            [0, 5],
            r"`log_frames` must have shape \(K, H, W\) with K >= 1, got \(2, 3\)",
        ),
        (
            np.full((2, 1, 1), -np.inf),
            [0, 5],
            "`log_frames` must be finite; luminance 0 has no logarithm",
        ),
        (np.zeros((2, 1, 1)), [5, 5], "`frame_times_us` must be strictly increasing"),
        (
            np.zeros((2, 1, 1)),
            [5],
            r"`frame_times_us` must have shape \(2,\), one per frame, got \(1,\)",
        ),
        (np.zeros((2, 1, 1)), [-1, 5], "`frame_times_us` must be strictly increasing, in "),
        (np.zeros((2, 1, 1)), [5, np.inf], "`frame_times_us` must be strictly increasing, in "),
        (np.zeros((2, 1, 1)), [np.nan, 5], "`frame_times_us` must be strictly increasing, in "),
        (np.zeros((2, 1, 1)), [0, 2.0**54], "`frame_times_us` must be strictly increasing, in "),
        (
            np.zeros((1, 1, 65_537)),
            [0],
            r"`log_frames` must be at most 65536 pixels wide and high, got \(1, 1, 65537\)",
        ),
    ],
)
def test_invalid_frames_and_pixels_are_refused(frames, times, message):
    with pytest.raises(ValueError, match=message):
        simulate(frames, times, np.random.default_rng(0))


@pytest.mark.parametrize("value", [-0.1, np.inf, np.nan])
def test_every_number_of_a_pixel_has_its_range(value):
    """The ends of the range are in it; infinity and nan are in no range."""
    for name in vars(PixelModel()):
        with pytest.raises(ValueError, match=f"`{name}` must be .*, got {value}"):
            PixelModel(**{name: value})
    for name in ("noise_on_share", "after_share", "hot_share"):
        assert getattr(PixelModel(**{name: 0.0}), name) == 0
        assert getattr(PixelModel(**{name: 1.0}), name) == 1
        with pytest.raises(ValueError, match=rf"`{name}` must be in \[0, 1\], got 1.01"):
            PixelModel(**{name: 1.01})


def test_rules_of_a_pixels_numbers_are_stated():
    for name, value, rule in (
        ("noise_on_share", 1.5, r"in \[0, 1\], got 1.5"),
        ("threshold_on", 0.0, "finite and at least 0.001, got 0.0"),
        ("refractory_us", -1.0, "finite and at least 0, got -1.0"),
        ("after_share", 2.0, r"in \[0, 1\], got 2.0"),
        ("bandwidth_hz", np.inf, "None, or finite and above 0, got inf"),
    ):
        with pytest.raises(ValueError, match=f"`{name}` must be {rule}"):
            PixelModel(**{name: value})


@pytest.mark.parametrize("start_us", [1, 1 << 24, 1 << 40])
def test_events_do_not_depend_on_when_the_frames_begin(start_us):
    """They are the same within the rounding of a microsecond.

    The pixels leak, follow slowly, give events by themselves, and give after-pulses.
    """
    frames = np.cumsum(np.random.default_rng(1).normal(0.0, 0.3, (30, 6, 7)), axis=0)
    times = 1_000.0 * np.arange(30)
    pixels = PixelModel(
        leak_hz=40.0, bandwidth_hz=300.0, noise_hz=30.0, hot_share=0.1, after_share=0.3
    )
    first = simulate(frames, times, np.random.default_rng(2), pixels=pixels)
    later = simulate(frames, times + start_us, np.random.default_rng(2), pixels=pixels)
    assert len(first) == len(later) > 200
    for one in (first, later):
        one.sort(order=("x", "y", "p", "t"))
    assert np.abs(later["t"].astype(np.int64) - start_us - first["t"].astype(np.int64)).max() <= 1
    np.testing.assert_array_equal(later[["x", "y", "p"]], first[["x", "y", "p"]])
