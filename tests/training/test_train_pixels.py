"""Training with a region and a mask of pixels: as if the other events had never been recorded."""

import numpy as np
import pytest
from made import events_of
from training.gestures import bar, write

from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training.data import dataset_data
from async_tnt.training.held_out import Split
from async_tnt.volume.config import TNTConfig

SIZE = (64, 64)
CAMERA = (120, 90)
CORNER = (30, 10)
HOT = np.array([(5, 60), (60, 3)])


def mask_of(size, pixels):
    mask = np.zeros(size[::-1], bool)
    mask[pixels[:, 1], pixels[:, 0]] = True
    return mask


def recorded(seed):
    """A bar at 64x64, and with two pixels that fire all the time.

    The file begins with one of their late events: dropping what is older than the first event
    before the hot pixels are removed would drop half of the bar.
    """
    events = bar("upright" if seed % 2 else "flat", seed, side=64, n=600, start_us=5_000)
    events = events[~mask_of(SIZE, HOT)[events["y"], events["x"]]]
    t = np.linspace(1_000, 120_000, 900).astype(int)
    hot = events_of(t, *HOT[np.arange(900) % 2].T, np.zeros(900, int))
    rest = np.concatenate((events, np.delete(hot, 450)))
    return events, np.concatenate((hot[450:451], rest[np.argsort(rest["t"], kind="stable")]))


def write_sets(folder):
    """The same recordings three times.

    They are without hot pixels, with them, and with them on a larger camera, parts of which
    move, too.
    """
    for k in range(20):
        events, hot = recorded(k)
        large = hot.copy()
        around = hot[::2].copy()
        large["x"] += CORNER[0]
        large["y"] += CORNER[1]
        around["x"] = np.where(np.arange(len(around)) % 2, 2, 119)
        made = {
            "clean": (events, SIZE),
            "hot": (hot, SIZE),
            "large": (np.concatenate((large, around)), CAMERA),
        }
        for name, (all_events, sensor) in made.items():
            # .npy does not state the sensor
            file = f"Test/{k % 2}/{k}.npy" if k < 10 else f"Train/{k % 2}/{k}.npz"
            write(folder / name / file, all_events, sensor=sensor)


@pytest.mark.parametrize(
    ("name", "region", "mask"),
    [("hot", None, mask_of(SIZE, HOT)), ("large", (30, 10, 64, 64), mask_of(CAMERA, HOT + CORNER))],
)
def test_the_network_sees_recordings_without_these_events(name, region, mask, tmp_path):
    """Event by event, to train on, to validate on and to test on."""
    write_sets(tmp_path)
    pixels = Pixels(region, region is not None, mask)
    split = Split(test=True)
    got = dataset_data(tmp_path / name, TNTConfig(), pixels=pixels, split=split)
    clean = dataset_data(tmp_path / "clean", TNTConfig(), split=split)
    disturbed = dataset_data(tmp_path / "hot", TNTConfig(), split=split)
    assert (
        got.config == clean.config and got.config.sensor == SIZE and len(got.tests["test"][0]) == 10
    )
    for part in (
        lambda data: data.training,
        lambda data: data.validation,
        lambda data: data.tests["test"][0],
    ):
        for name in ("recording", "start_us", "labels"):
            np.testing.assert_array_equal(getattr(part(got), name), getattr(part(clean), name))
        for name in ("t", "x", "y", "p", "offsets"):
            np.testing.assert_array_equal(
                getattr(part(got).recordings, name), getattr(part(clean).recordings, name)
            )
    assert len(disturbed.training.recordings.t) > len(clean.training.recordings.t)
    assert (
        "events left out of the recordings: " in got.notes[0]
        and "9,000 of masked pixels" in got.notes[0]
    )
    assert "left out" not in "".join(clean.notes)
    if region is not None:
        counts = {"camera": [120, 90], "left_out_outside": 7500, "left_out_masked": 9000}
        assert got.record["pixels"] == pixels.about | counts
