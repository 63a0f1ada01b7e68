"""Training on windows that slide: they hold what a stream's window holds at some moment."""

import numpy as np
import pytest
from made import events_of, random_events
from training.gestures import write_set

from async_tnt import TNTConfig, TNTVolume
from async_tnt.networks.loading import load_model
from async_tnt.training.recordings import Recordings
from async_tnt.training.windows import FARTHEST, windows_of

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

from async_tnt.training.augment import KINDS, fineness, showing_nothing, unchanged
from async_tnt.training.batches import BatchVolumes
from async_tnt.training.data import dataset_data
from async_tnt.training.held_out import Split, hold_out_ends
from async_tnt.training.loop import batches_of
from async_tnt.training.plan import Plan
from async_tnt.training.settings import settings_for
from async_tnt.training.volume_choice import VolumeChoice

SENSOR = (9, 8)


def config_of(**window):
    return TNTConfig(sensor=SENSOR, grid=SENSOR, representation="count", **window)


def recording(times_us):
    return events_of(times_us, *(np.full(len(times_us), value) for value in (5, 7, 1)))


TIMES = [[5, 40, 100, 300], [], [7]]
"""Times of three recordings, in microseconds."""


@pytest.mark.parametrize(
    "moments, starts_us",
    [
        # ends: 105, 205 (without events), 301, and in the last recording 8, after the only event
        (1, [5, 201, -92]),
        (2, [-45, 5, 55, 201, -92]),
    ],
)
def test_windows_of_a_duration_by_hand(moments, starts_us):
    recordings = Recordings.from_events(map(recording, TIMES), [0, 1, 2])
    windows = windows_of(recordings, config_of(last_us=100), moments=moments)
    assert windows.start_us.tolist() == starts_us
    assert windows.recording.tolist() == [0] * (len(starts_us) - 1) + [2]
    assert windows.ends_us(100).tolist() == [start + 100 for start in starts_us]
    t, *_ = windows.events(len(windows) - 2, 100)
    assert t.tolist() == [99]


def test_windows_of_a_number_of_events_by_hand():
    times = [[1, 2, 2, 2, 3, 4, 4], [9]]
    recordings = Recordings.from_events(map(recording, times), [0, 1])
    windows = windows_of(recordings, config_of(last_events=3))
    assert windows.stop.tolist() == [3, 6, 7, 8]
    assert windows.start_us.tolist() == [1, 2, 3, 9]
    assert windows.ends_us(10).tolist() == [3, 5, 5, 10]
    # those at one time are told apart
    counts = [len(windows.events(k, 10)[0]) for k in range(4)]
    assert counts == [3, 3, 3, 1]
    assert windows[[2, 0]].stop.tolist() == [7, 3]
    joined = windows[:1].joined(windows[2:])
    assert joined.stop.tolist() == [3, 7, 8] and joined.recording.tolist() == [0, 0, 1]


def in_a_stream(config, events, end_us, n):
    """The image of a stream after n events, at the microsecond before `end_us`."""
    volume = TNTVolume(config)
    volume.open(0)
    volume.update(events[:n])
    volume.advance(end_us - 1)
    return volume.array.copy()


@pytest.mark.parametrize(
    "window, times", [({"last_us": 700}, 1), ({"last_us": 210_000}, 300), ({"last_events": 60}, 1)]
)
@pytest.mark.parametrize("polarity", ["split", "signed", "unsigned"])
@pytest.mark.parametrize("slides_on", [False, True])
def test_a_window_has_the_bits_of_a_stream(window, times, polarity, slides_on):
    """times : how many times longer the recordings are."""
    config = config_of(polarity=polarity, **window)
    streams = [
        random_events(n, seed=n, duration_us=3_000 * times, sensor=SENSOR, start_us=11)
        for n in (400, 30)
    ]
    recordings = Recordings.from_events(streams, [0, 1])
    windows = windows_of(recordings, config, moments=4)
    if slides_on:
        windows = windows.slid(config.window_us, np.random.default_rng(0))
    images = BatchVolumes(config)(windows)
    ends_us = windows.ends_us(config.window_us)
    n_whole = 0
    for k, image in enumerate(images):
        r = int(windows.recording[k])
        end_us = int(ends_us[k])
        n = int(np.searchsorted(streams[r]["t"], end_us))
        if windows.stop is not None:
            n = int(windows.stop[k] - recordings.offsets[r])
        np.testing.assert_array_equal(image, in_a_stream(config, streams[r], end_us, n))
        n_whole += n > 60
    assert n_whole > 8


@pytest.mark.parametrize("polarity", ["split", "signed", "unsigned"])
@pytest.mark.parametrize("lacking_us", [0, 1, 60, 99])
def test_slices_have_the_bits_of_a_stream(polarity, lacking_us):
    """At a slice's end, or before: then the newest slice is not complete."""
    config = TNTConfig(
        sensor=SENSOR, grid=SENSOR, transform="none", polarity=polarity, bins=7, last_us=700
    )
    events = random_events(400, seed=3, duration_us=3_000, sensor=SENSOR, start_us=211)
    recordings = Recordings.from_events([events], [0])
    windows = windows_of(recordings, config, moments=3)
    draws = unchanged(len(windows), config)
    draws.until_us[:] = 700 - lacking_us
    volumes = BatchVolumes(config)(windows, draws)
    for k, end_us in enumerate(windows.ends_us(700).tolist()):
        volume = TNTVolume(config)
        volume.open(end_us % 100)  # a start that a slice's end lies whole slices behind
        volume.update(events[events["t"] < end_us - lacking_us])
        volume.advance(end_us - 1 - lacking_us)
        np.testing.assert_array_equal(volumes[k], volume.array)


def test_slices_are_drawn_with_a_newest_one_of_any_length():
    config = TNTConfig(sensor=SENSOR, grid=SENSOR, transform="none", bins=7, last_us=700)
    recordings = Recordings.from_events([recording(np.arange(600) * 10)], [0])
    windows = windows_of(recordings, config)
    settings = settings_for(config, 100)
    draws = [
        settings.augmentation.draw(windows, config, np.random.default_rng(k)) for k in range(60)
    ]
    lacking_us = np.concatenate([one.start_us for one in draws])
    assert lacking_us.min() >= 0 and lacking_us.max() <= 99 and len(set(lacking_us.tolist())) > 60
    ends_us = np.concatenate([one.start_us + one.until_us for one in draws])
    assert (ends_us == 700).all()  # where the window ends does not change


@pytest.mark.parametrize("kind", KINDS)
def test_what_shows_nothing_differs_from_slice_to_slice(kind):
    """Events at other places; an edge goes on where it was at the end of the slice before."""
    config = TNTConfig(
        sensor=(60, 60), grid=(60, 60), transform="none", polarity="unsigned", bins=4, last_us=4_000
    )
    events = random_events(4_000, duration_us=4_000, sensor=config.sensor)
    recordings = Recordings.from_events([events], [0])
    windows = windows_of(recordings, config)[:1]
    draws = unchanged(1, config)
    draws = showing_nothing(draws, np.array([KINDS[kind]]), np.random.default_rng(3))
    (volume,) = BatchVolumes(config)(windows, draws)
    assert volume.sum() > 500
    for b in range(3):
        assert not np.array_equal(volume[b], volume[b + 1])
    if kind == "along an edge":
        normal = draws.place[0, 2:4]
        rows, columns = np.mgrid[:60, :60]
        across = [
            (one * (columns * normal[0] + rows * normal[1])).sum() / one.sum() for one in volume
        ]
        steps = np.diff(across)
        np.testing.assert_allclose(steps, draws.place[0, 4] / 4, rtol=0.2)


def test_a_line_of_pixels_is_augmented_on_its_own_pixels():
    """An own network may be trained on one."""
    config = TNTConfig(sensor=(30, 1), grid=(30, 1), representation="count", last_us=700)
    events = random_events(300, duration_us=3_000, sensor=config.sensor)
    recordings = Recordings.from_events([events], [0])
    windows = windows_of(recordings, config)
    draws = settings_for(config, 100).augmentation.draw(windows, config, np.random.default_rng(0))
    assert draws.sensor == (30, 1) and fineness((1, 1)) == 1
    assert BatchVolumes(config)(windows, draws).sum() > 100


@pytest.mark.parametrize("window", [{"last_us": 700}, {"last_events": 60}], ids=str)
def test_windows_slide_to_all_moments(window):
    """Each moment of a recording is as likely as any other, but for its very beginning."""
    config = config_of(**window)
    recordings = Recordings.from_events([recording(np.arange(600) * 10)], [0])
    windows = windows_of(recordings, config)
    rng = np.random.default_rng(0)
    if windows.stop is None:
        ends = [windows.slid(700, rng).ends_us(700) / 6_000 for _ in range(500)]
    else:
        ends = [windows.slid(700, rng).stop / 600 for _ in range(500)]
    counts, _ = np.histogram(ends, 10, (0.0, 1.0))
    # the last window overlaps the one before: 9 windows for 6,000 us, and 10 for 600 events
    assert counts[1:8].min() > 0.8 * counts[1:8].max()
    shortest = (1 - FARTHEST) * (700 / 6_000 if windows.stop is None else 60 / 600)
    assert np.min(ends) >= shortest * 0.9
    assert np.max(ends) <= 1.0


@pytest.mark.parametrize("window", [{"last_us": 700}, {"last_events": 60}], ids=str)
def test_each_epoch_shows_windows_that_slide_at_other_moments(window):
    config = config_of(**window)
    recordings = Recordings.from_events([recording(np.arange(600) * 10)], [0])
    windows = windows_of(recordings, config)
    settings = settings_for(config, 100, passes=1, balance=False)
    ends_us = []
    for epoch in (0, 1):
        batches = [shown for shown, _ in batches_of(config, windows, settings, epoch)]
        shown_us = np.concatenate([shown.ends_us(700) for shown in batches])
        assert len(shown_us) == len(windows)
        ends_us.append(set(shown_us.tolist()))
    own_us = set(windows.ends_us(700).tolist())
    assert len(ends_us[0] & own_us) < 3 and len(ends_us[0] & ends_us[1]) < 3


def test_a_held_out_end_shares_no_event_with_windows_to_learn_from():
    config = config_of(last_events=50)
    recordings = Recordings.from_events([random_events(1_000, sensor=SENSOR)], [0])
    windows = windows_of(recordings, config)
    learned, held_out, labels = hold_out_ends(windows, windows[:0], 0.2, 1, config.window_us)
    assert labels == [0] and len(held_out) == 4 and len(learned) > 10
    assert learned.stop.max() <= (held_out.stop - 50).min()
    rng = np.random.default_rng(0)
    for _ in range(20):  # they slide to earlier moments
        assert learned.slid(config.window_us, rng).stop.max() <= (held_out.stop - 50).min()


def test_held_out_windows_end_at_four_moments_in_the_length_of_a_window(tmp_path):
    """Those to learn from lie end to end: in each epoch they slide to other moments."""
    folder = tmp_path / "set"
    write_set(folder / "Train", {"upright": 2, "flat": 2}, side=34)
    write_set(folder / "Test", {"upright": 1, "flat": 1}, seed=1, side=34)
    data = dataset_data(folder, VolumeChoice.of(last_us=20_000), split=Split(0.5, test=True))
    for windows, apart_us in (
        (data.training, 20_000),
        (data.validation, 5_000),
        (data.tests["test"][0], 5_000),
    ):
        starts_us = windows.start_us[windows.recording == windows.recording[0]]
        assert len(starts_us) >= 4
        assert set(np.diff(starts_us)[:-1].tolist()) == {apart_us}  # the last one ends at the end


def test_the_settings_of_windows_that_slide():
    """They end at any moment anyway, and those of a number of events lose none."""
    for window, drop in (({"last_us": 700}, 0.3), ({"last_events": 60}, 0.0)):
        settings = settings_for(config_of(**window), 100, augmentation={"drop": 0.3})
        augmentation = settings.augmentation
        assert (augmentation.start_ms, augmentation.partial, augmentation.late_start) == (0, 0, 0)
        assert augmentation.drop == drop
    choice = VolumeChoice.of(last_us=700)
    config = choice.for_recordings((200, 100), 300)
    assert config.grid == (200, 100) and config.last_us == 700
    assert Plan(choice)._settings(config, 100).augmentation.partial == 0


@pytest.mark.parametrize(
    "window",
    [
        ("--last-us", "40000"),
        ("--last-events", "500"),
        ("--last-us", "40000", "--volume", "representation=volume,transform=none,bins=4"),
    ],
)
def test_a_model_for_windows_that_slide(window, tmp_path, train):
    folder = write_set(tmp_path / "set", {"upright": 8, "flat": 8}, side=34)
    code, err, out = train(folder, *window, "--epochs", "4")
    assert code == 0, err
    model = load_model(out)
    name = window[0].removeprefix("--").replace("-", "_")
    assert getattr(model.config, name) == int(window[1])
    assert model.config.grid == model.config.sensor
    assert model.record["validation"]["windows"] > model.record["validation"]["recordings"]
    assert model.record["validation"]["per_window"] >= 0.6


@pytest.mark.parametrize(
    "words, message",
    [
        (
            ("--last-us", "9000", "--motions", "resynthesized"),
            "--motions resynthesized is for windows with a start: give --window-us, and not",
        ),
        (
            ("--last-events", "900", "--everywhere"),
            "--everywhere makes scenes of windows of a duration: give --last-us or --window-us",
        ),
        (
            ("--last-us", "9", "--volume", "representation=volume"),
            "--last-us needs representation=",
        ),
    ],
)
def test_what_does_not_slide(words, message, tmp_path, train):
    folder = write_set(tmp_path / "set", {"upright": 3, "flat": 3})
    code, err, _ = train(folder, *words)
    assert code == 2 and message in err
