"""`simulate_digit`, and the bundled samples."""

import gzip

import numpy as np
import pytest
from small_sets import idx_bytes

from async_tnt.simulation.digits import sample_indices, simulate_digit, write_samples
from async_tnt.simulation.simulator import PixelModel
from async_tnt.simulation.trajectories import ConstantVelocity
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.sources.files.recording import sample_recordings

BAR = np.zeros((28, 28), np.uint8)
BAR[5:23, 12:16] = 255


def test_the_seed_decides_the_events_which_are_in_order_on_the_sensor_and_in_time():
    events, again, other = (simulate_digit(BAR, np.random.default_rng(seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(events, again)
    assert len(events) > 1_000 and events.tolist() != other.tolist()
    assert (np.diff(events["t"]) >= 0).all() and events["t"][0] >= 0 and events["t"][-1] <= 308_000
    assert events["x"].max() < 34 and events["y"].max() < 34 and set(events["p"].tolist()) == {0, 1}


def test_events_follow_the_stated_flow():
    # a bar at 60 px/s to the right: its events move as fast, and start from its place
    motion = ConstantVelocity.towards(0.0, 60.0, duration_us=100_000)
    events = simulate_digit(BAR, np.random.default_rng(0), trajectory=motion, pixels=PixelModel(noise_hz=0.0))
    late = events[events["t"] > 30_000]  # each pixel has seen its first event by then
    slope, start = np.polyfit(late["t"] * 1e-6, late["x"], 1)
    assert slope == pytest.approx(60.0, rel=0.05)
    assert start == pytest.approx(motion.start[0] + 13.5, abs=0.5)  # columns 12-15


def test_other_sensors_and_image_sizes():
    rng = np.random.default_rng(0)
    events = simulate_digit(np.ones((5, 60)), rng, trajectory=ConstantVelocity((0.0, 100.0)), sensor=(64, 20))
    assert 34 < events["x"].max() < 64 and events["y"].max() < 20


@pytest.mark.parametrize("frame_us", [0.0, -1.0, 308_001.0, np.nan])
def test_invalid_frame_intervals_are_refused(frame_us):
    with pytest.raises(ValueError, match=r"`frame_us` must be in \(0, 308000\], the duration, got"):
        simulate_digit(BAR, np.random.default_rng(0), frame_us=frame_us)


def test_samples_are_the_first_of_each_digit_from_index_2000_and_reproducible(tmp_path):
    """Of 2,020 images: bars whose place follows their label."""
    labels = np.arange(2_020)[::-1] % 10
    indices = sample_indices(labels)
    assert [labels[indices[digit]] for digit in range(10)] == list(range(10))
    assert sorted(indices.values()) == list(range(2_000, 2_010))
    images = np.stack([np.roll(BAR, label - 5, axis=1) for label in labels])
    for name, array in (("images-idx3-ubyte", images), ("labels-idx1-ubyte", labels)):
        (tmp_path / f"train-{name}.gz").write_bytes(gzip.compress(idx_bytes(array), 1))
    first, again, other = (
        write_samples(tmp_path, tmp_path / name / "deep", seed) for name, seed in (("a", 0), ("b", 0), ("c", 1))
    )
    assert [path.name for path in first] == [f"{digit}.bin" for digit in range(10)]
    for one, same, different in zip(first, again, other, strict=True):
        assert one.read_bytes() == same.read_bytes() != different.read_bytes() and len(read_nmnist(one)) > 1_000
    with pytest.raises(ValueError, match="no image of a 9 from index 0 on, in 18 images"):
        sample_indices(np.arange(18) % 9, first_index=0)


def test_bundled_samples_are_those_of_seed_0(real_mnist, tmp_path):
    made = write_samples(real_mnist, tmp_path, seed=0)
    for digit, bundled in sample_recordings().items():
        assert bundled.read_bytes() == made[digit].read_bytes(), f"sample {digit} is not what this version simulates"
