"""Volumes of a batch of windows are those of `TNTVolume`.

Augmentation changes them as stated.
"""

import itertools

import numpy as np
import pytest
from made import events_of, opened, random_events

from async_tnt.kernels.training.window_batches import (
    EDGE,
    HOT_PIXELS,
    ONE_POLARITY,
    PATCH,
    SCATTERED,
    SHOWN,
)
from async_tnt.training.augment import FINE, Augmentation, showing_nothing, unchanged
from async_tnt.training.batches import BatchVolumes
from async_tnt.training.recordings import Recordings
from async_tnt.training.windows import make_windows
from async_tnt.volume.config import TNTConfig

NOTHING = Augmentation(start_ms=0, shift_px=0, rotation_deg=0, scale=0, shear=0, drop=0, partial=0)
RNG = np.random.default_rng


def random_windows(config, n=3, n_events=700, **settings):
    events = [
        random_events(n_events, seed=k, duration_us=330_000, sensor=config.sensor) for k in range(n)
    ]
    return make_windows(
        Recordings.from_events(events, range(n)), config.window_us, duration_us=315_000, **settings
    )


def streamed(config, windows, k, until_us):
    """The volume of window `k`, streamed: of its events before `until_us`."""
    recordings = windows.recordings
    start = int(windows.start_us[k])
    first, end = recordings.offsets[windows.recording[k] :][:2]
    own = slice(first, end)
    inside = (recordings.t[own] >= start) & (recordings.t[own] < start + until_us)
    columns = [getattr(recordings, name)[own][inside].astype(np.int64) for name in "txyp"]
    return opened(config, columns, start).array


@pytest.mark.parametrize(
    "changes",
    [
        {"landmark": "center"},
        {"landmark": "running", "t_max": 2.0},
        {"landmark": "line", "polarity": "split"},
        {"landmark": "line", "remove_flow": True, "polarity": "unsigned"},
        {"landmark": "window", "sensor": (67, 41)},
        {"transform": "none", "sensor": (64, 40)},
        {"representation": "count", "landmark": "line"},
        {
            "representation": "count_time",
            "transform": "none",
            "polarity": "split",
            "sensor": (64, 40),
        },
        {"representation": "mean_time", "transform": "none", "polarity": "unsigned"},
        {"representation": "time_surface", "transform": "none"},
    ],
    ids=lambda changes: "-".join(map(str, changes.values())),
)
def test_a_batch_equals_the_streamed_volumes(changes):
    config = TNTConfig(**changes)
    # as a teacher of shorter windows may be asked
    for first_event, until_us in ((False, 200_000), (True, 40_000)):
        windows = random_windows(config, first_event=first_event)
        draws = unchanged(len(windows), config)
        draws.until_us[:] = until_us
        batch = BatchVolumes(config)(windows, draws)
        expected = [streamed(config, windows, k, min(until_us, 105_000)) for k in range(9)]
        assert np.abs(expected).max((1, 2, 3)).min() > 0
        np.testing.assert_array_equal(batch, expected)


def test_windows_of_events_are_refused():
    with pytest.raises(
        ValueError, match="windows of a duration can be trained on, but not of 50 events"
    ):
        BatchVolumes(TNTConfig(window_events=50))


def test_an_event_at_a_windows_end_belongs_to_the_next():
    """The event has no weight in the volume itself.

    But it would move the centroid that all other events are normalized about.
    """
    config = TNTConfig(landmark="window", t_max=2.0)
    events = events_of(
        [0, 60_000, 90_000, 105_000, 120_000],
        [3, 12, 20, 33, 5],
        [4, 9, 20, 33, 6],
        [1, 0, 1, 1, 0],
    )
    windows = make_windows(Recordings.from_events([events], [0]), config.window_us)
    batch = BatchVolumes(config)(windows)
    for k in range(2):
        np.testing.assert_array_equal(batch[k], streamed(config, windows, k, config.window_us))


def test_a_moved_start_takes_in_the_neighbouring_windows_events():
    config = TNTConfig(transform="none")
    windows = random_windows(config, 1)
    draws = NOTHING.draw(windows, config, RNG(1))
    draws.start_us[:] = -4_000, 5_000, 2_345
    moved = BatchVolumes(config)(windows, draws).copy()
    windows.start_us[:] += draws.start_us
    # another sensor: rounding
    np.testing.assert_allclose(BatchVolumes(config)(windows), moved, atol=1e-5)


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({}, (20.0, 10.0)),
        ({"shift_px": 2.0}, (22.0, 12.0)),
        ({"translate_px": 2}, (22.0, 12.0)),
        ({"rotation_deg": 90.0}, (23.0, 20.0)),  # x to the right, y downwards: from x towards y
        ({"scale": 0.5}, (21.75, 6.75)),
        ({"shear": 0.5}, (16.75, 10.0)),
        ({"mirror": True, "shift_px": 2.0}, (33 - 20 + 2.0, 12.0)),
        ({"mirror": True, "rotation_deg": 90.0}, (23.0, 33 - 20.0)),
        # (3.5, -6.5), (.25, -6.5), (6.5, .25)
        ({"scale": 0.5, "rotation_deg": 90.0, "shear": 0.5}, (26.25, 16.875)),
    ],
    ids=str,
)
def test_the_largest_changes_by_hand(changes, place):
    """An event at (20, 10) is augmented.

    It is at (3.5, -6.5) from the middle of its recording's events, (16.5, 16.5).
    """

    class Largest:
        """Draws the upper end of every range."""

        def uniform(self, low, high, n):
            return np.full(n, high)

        def integers(self, low, high, shape, dtype=int):
            return np.full(shape, high - 1, dtype)

        def random(self, n):
            return np.full(n, 0.4)

    config = TNTConfig(transform="none")
    # the second one in another window
    events = events_of([50_000, 200_000], [20, 13], [10, 23], [1, 1])
    windows = make_windows(Recordings.from_events([events], [0]), config.window_us)[:1]
    augmentation = Augmentation(**{name: 0 for name in vars(NOTHING)} | changes)
    volume = BatchVolumes(config)(windows, augmentation.draw(windows, config, Largest()))[0]
    ys, xs = np.mgrid[:34, :34]
    assert volume.sum() == pytest.approx(1.0)
    assert ((volume.sum(0) * xs).sum(), (volume.sum(0) * ys).sum()) == pytest.approx(
        place, abs=0.5 / FINE
    )


def test_draws_are_the_generators_and_stay_within_the_stated_ranges():
    config = TNTConfig()
    augmentation = Augmentation(partial=0.25, translate_px=4, mirror=True, nothing=0.1)
    windows = random_windows(config, 1, 100)[np.zeros(4_000, int)]
    draws = augmentation.draw(windows, config, RNG(1))
    again = augmentation.draw(windows, config, RNG(1))
    other = augmentation.draw(windows, config, RNG(2))
    for name in ("start_us", "until_us", "matrix", "keep", "seed", "content", "place"):
        np.testing.assert_array_equal(getattr(draws, name), getattr(again, name))
        assert not np.array_equal(getattr(draws, name), getattr(other, name))
    assert -5_000 <= draws.start_us.min() < -4_900 and 4_900 < draws.start_us.max() <= 5_000
    assert 0.7 <= draws.keep.min() < 0.71 and draws.until_us.min() >= 15_000
    shares = (draws.until_us < config.window_us, draws.content > 0, draws.matrix[:, 0, 0] < 0)
    assert np.mean(shares, axis=1) == pytest.approx([0.25, 0.1, 0.5], abs=0.03)
    late = Augmentation(late_start=0.25).draw(windows, config, RNG(1)).start_us
    assert (late > 5_000).mean() == pytest.approx(0.23, abs=0.03) and 60_000 < late.max() < 68_000
    # an event between pixels would count for all of them
    times = TNTConfig(representation="mean_time")
    assert NOTHING.draw(windows, times, RNG(1)).sensor == (34, 34)
    scaled = Augmentation.for_sensor(TNTConfig(sensor=(100, 67), window_us=210_000), drop=0.5)
    found = (scaled.start_ms, scaled.shift_px, scaled.partial_from_ms, scaled.drop)
    assert found == (10.0, 3.0, 30.0, 0.5)
    with pytest.raises(ValueError, match=r"`drop` must be in \[0, 1.0\], got 1.5"):
        Augmentation(drop=1.5)


def test_thinning_keeps_the_drawn_share_and_scattered_events_are_anywhere_and_otherwise_the_same():
    config = TNTConfig(transform="none", polarity="split", sensor=(50, 40))
    windows = random_windows(config, 1, 60_000)
    windows.recordings.x[:] = 20
    windows.recordings.y[:] = 10
    all_of_it = BatchVolumes(config)(windows).sum((2, 3), dtype=np.float64)
    draws = unchanged(3, config)
    draws.keep[:] = 0.25, 1.0, 1.0
    draws.seed[:] = 1, 2, 3
    draws = showing_nothing(draws, np.array([SHOWN, SCATTERED, SCATTERED]), RNG(0))
    thinned, first, second = BatchVolumes(config)(windows, draws).astype(np.float64)
    # 4 sd of 19,000 events
    assert thinned.sum() / all_of_it[0].sum() == pytest.approx(0.25, abs=0.015)
    assert np.count_nonzero(thinned.sum(0)) <= 4 and not np.array_equal(first, second)
    np.testing.assert_allclose(first.sum((1, 2)), all_of_it[1], rtol=1e-4)  # in time and polarity
    for along in (first.sum((0, 1)), first.sum((0, 2))):
        # as many everywhere
        np.testing.assert_allclose(along[1:-1] / along[1:-1].mean(), 1, atol=0.2)


@pytest.mark.parametrize("kind", [SHOWN, SCATTERED, HOT_PIXELS])
def test_what_is_drawn_for_a_window_is_the_same_whatever_else_the_data_set_holds(kind):
    config = TNTConfig(transform="none")
    own = random_events(600, seed=600, duration_us=330_000, sensor=config.sensor)
    other = random_events(501, seed=501, duration_us=330_000, sensor=config.sensor)

    def second_window_of_the_last(events):
        recordings = Recordings.from_events(events, [0] * len(events))
        windows = make_windows(recordings, config.window_us)
        is_last = windows.recording == windows.recording.max()
        return windows[is_last & (windows.start_us == 105_000)]

    alone = second_window_of_the_last([own])
    behind = second_window_of_the_last([other, own[own["t"] > 99_000]])
    draws = unchanged(1, config)
    draws.keep[:] = 0.5
    draws.seed[:] = 7
    draws = showing_nothing(draws, np.array([kind]), RNG(0))
    expected = BatchVolumes(config)(alone, draws).copy()
    assert len(alone) == 1 and expected.any()
    np.testing.assert_array_equal(BatchVolumes(config)(behind, draws), expected)


@pytest.mark.parametrize("offset, pixels", [((0.4, -0.4), (0, 0)), ((-0.6, 0.6), (-1, 1))])
def test_a_moved_event_is_on_the_nearest_pixel(offset, pixels):
    config = TNTConfig(transform="none", representation="count", sensor=(20, 16), grid=(20, 16))
    windows = random_windows(config, 1)
    windows.recordings.x[:] = 5 + windows.recordings.x % 10
    windows.recordings.y[:] = 3 + windows.recordings.y % 10
    draws = unchanged(len(windows), config)
    draws.matrix[:, :, 2] = offset
    moved = BatchVolumes(config)(windows, draws).copy()
    unmoved = BatchVolumes(config)(windows)
    expected = np.roll(unmoved, pixels[::-1], (2, 3))
    assert unmoved.any()
    np.testing.assert_array_equal(moved, expected)


@pytest.mark.parametrize("kind", [ONE_POLARITY, HOT_PIXELS, PATCH, EDGE])
def test_what_stands_in_the_place_of_a_recording(kind):
    """It has as many events as before, or fewer where an edge leaves the sensor."""
    config = TNTConfig(transform="none", polarity="split", bins=2, sensor=(50, 40), grid=(50, 40))
    windows = random_windows(config, 1, 30_000)[np.zeros(40, int)]
    n_events = BatchVolumes(config)(windows).sum() / 40
    draws = showing_nothing(unchanged(40, config), np.full(40, kind), RNG(0))
    n_hot = set()
    # often of one polarity
    assert kind != EDGE or 10 < np.isin(draws.place[:, 7], (0, 1)).sum() < 30
    for volume in BatchVolumes(config)(windows, draws).astype(np.float64):
        of_pixels = volume.sum(0)
        of_polarity = volume.sum((1, 2)).reshape(2, 2).sum(1)
        y, x = np.nonzero(of_pixels)
        if kind != EDGE:
            assert volume.sum() == pytest.approx(n_events, rel=1e-5)
        if kind == ONE_POLARITY:
            assert of_polarity.min() == 0 and len(x) > 1_900
        elif kind == HOT_PIXELS:
            n_hot.add(len(x))
        elif kind == PATCH:
            assert np.ptp(x) < 26 and np.ptp(y) < 21
            assert len(x) > 0.8 * (np.ptp(x) + 1) * (np.ptp(y) + 1)
        else:  # what is there in the second half lies beside what was there in the first
            first, second = [
                np.mgrid[:40, :50].reshape(2, -1) @ half.ravel() / half.sum()
                for half in (volume[0] + volume[2], volume[1] + volume[3])
            ]
            assert np.hypot(*(second - first)) > 0.5 and volume.sum() > 0.02 * n_events
    assert n_hot == ({1, 2, 3} if kind == HOT_PIXELS else set())


def splitmix64(seed):
    """The numbers of the generator SplitMix64, as its authors publish it: 64 bits each."""
    state = seed
    while True:
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        z = state
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 % 2**64
        z = (z ^ z >> 27) * 0x94D049BB133111EB % 2**64
        yield z ^ z >> 31


def test_which_events_are_kept_is_drawn_by_the_generator_that_is_named():
    """The first numbers of the seed 1234567 are those that are published with the generator."""
    numbers = list(itertools.islice(splitmix64(1234567), 99))
    assert numbers[:2] == [6457827717110365317, 3203168211198807973]
    config = TNTConfig(transform="none", representation="count", polarity="unsigned")
    events = events_of(range(100), [*range(25)] * 4, np.repeat(range(4), 25), [1] * 100)
    windows = make_windows(Recordings.from_events([events], [0]), config.window_us)[:1]
    draws = unchanged(1, config)
    draws.keep[:] = 0.4
    draws.seed[:] = 1234567
    kept = BatchVolumes(config)(windows, draws)[0, 0, :4, :25].reshape(-1)
    # the number before the first one, of event 0, is drawn with the seed itself as state
    assert kept[1:].tolist() == [number / 2**64 < 0.4 for number in numbers]


@pytest.mark.parametrize("on_share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize(("cosine", "sine"), [(1.0, 0.0), (0.0, 1.0), (0.6, 0.8), (-0.8, 0.6)])
def test_an_edge_by_hand(cosine, sine, on_share):
    """It moves 20 pixels along its normal, through (25, 20) in the middle of the window.

    It is 4 pixels thick and 16 long.
    """
    config = TNTConfig(
        transform="none", polarity="split", bins=2, sensor=(50, 40), grid=(50, 40), window_us=1_000
    )
    y, x = np.mgrid[:40, :50]
    across = (x + 0.5 - 25) * cosine + (y + 0.5 - 20) * sine
    along = (y + 0.5 - 20) * cosine - (x + 0.5 - 25) * sine
    for share in (0.0, 0.25, 0.9):
        events = events_of([int(1_000 * share)] * 2_000, [3] * 2_000, [3] * 2_000, [1] * 2_000)
        windows = make_windows(Recordings.from_events([events], [0]), 1_000, duration_us=1_000)
        draws = unchanged(1, config)
        draws.content[:] = EDGE
        draws.place[:] = 25, 20, cosine, sine, 20, 4, 16, on_share
        volume = BatchVolumes(config)(windows, draws)[0].astype(np.float64)
        assert volume.sum() == pytest.approx(2_000)
        assert volume[:2].sum() / 2_000 == pytest.approx(on_share, abs=0.05)
        for place, middle, side in ((across, 20 * (share - 0.5), 4), (along, 0, 16)):
            found = place[volume.sum(0) > 0]
            # a pixel's middle is less than 0.71 from any of its places
            assert abs(found - middle).max() < side / 2 + 0.71
            weights = volume.sum(0) / 2_000
            assert (weights * place).sum() == pytest.approx(middle, abs=0.6)
            assert np.ptp(found) > 0.8 * side - 1


def test_a_folder_is_a_data_set_of_volumes_for_torch(tmp_path):
    """Every window of every recording, with its class, in batches; the same bits as a stream's."""
    torch = pytest.importorskip("torch")
    from async_tnt import volumes
    from async_tnt.training import VolumeDataset

    config = TNTConfig(landmark="running", bins=5)
    recordings = {}
    for label, name in enumerate(("clap", "wave")):
        (tmp_path / name).mkdir()
        for k in range(2):
            events = random_events(900, seed=10 * label + k, duration_us=300_000)
            recordings[name, k] = events
            np.save(tmp_path / name / f"{k}.npy", events)
    data = VolumeDataset(tmp_path, config)
    expected = []
    for label, name in enumerate(data.classes):
        for k in range(2):
            windows = volumes([recordings[name, k]], config)
            expected += [(window.volume, label) for window in windows]
    assert data.classes == ("clap", "wave") and len(data) == len(expected) == 12
    for (volume, label), (by_hand, of) in zip(data, expected, strict=True):
        np.testing.assert_array_equal(volume.numpy(), by_hand)
        assert label == of
    batches = list(torch.utils.data.DataLoader(data, batch_size=5))
    assert [tuple(v.shape) for v, _ in batches] == [(5, 5, 34, 34), (5, 5, 34, 34), (2, 5, 34, 34)]
    assert torch.cat([labels for _, labels in batches]).tolist() == [0] * 6 + [1] * 6
    assert torch.equal(data[-1][0], data[11][0])
    (tmp_path / "wave" / "damaged.npy").write_bytes(b"no events")
    with pytest.warns(UserWarning, match="^1 recordings left out, first wave/damaged.npy: "):
        known = VolumeDataset(tmp_path, config, classes=("no", "wave", "clap"))  # in this order
    assert [label for _, label in known] == [1] * 6 + [2] * 6
    with pytest.raises(FileNotFoundError, match="has neither a folder Test nor lists"):
        VolumeDataset(tmp_path, config, part="Test")
    with pytest.raises(
        IndexError, match=r"^`index` must be below 12, the number of windows, got 12$"
    ):
        data[12]
    with pytest.raises(ValueError, match="landmark 'regressor' needs a network"):
        VolumeDataset(tmp_path, TNTConfig(landmark="regressor"))
