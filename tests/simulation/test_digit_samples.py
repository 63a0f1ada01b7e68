"""`simulate_digit`, and the bundled samples."""

import gzip
import os
from pathlib import Path

import numpy as np
import pytest

from async_tnt.simulation.digits import sample_indices, simulate_digit, write_samples
from async_tnt.simulation.simulator import PixelModel
from async_tnt.simulation.trajectories import ConstantVelocity
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.sources.files.recording import sample_recordings

DATA = Path(os.environ.get("TNT_DATA", Path(__file__).parents[2].parent / "shared" / "data"))


def digit_image(shift=0):
    image = np.zeros((28, 28), np.uint8)
    image[5:23, 12 + shift : 16 + shift] = 255
    return image


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder like MNIST's, with 2,020 images: bars whose place follows their label."""
    folder = tmp_path_factory.mktemp("mnist")
    labels = np.arange(2_020, dtype=np.uint8)[::-1] % 10
    images = np.stack([digit_image(int(label) - 5) for label in labels])
    for name, array in (("images-idx3-ubyte", images), ("labels-idx1-ubyte", labels)):
        header = bytes([0, 0, 8, array.ndim]) + b"".join(n.to_bytes(4, "big") for n in array.shape)
        (folder / f"train-{name}.gz").write_bytes(gzip.compress(header + array.tobytes(), 1))
    return folder


def test_a_recording_is_in_order_on_the_sensor_and_in_time():
    events = simulate_digit(digit_image(), np.random.default_rng(0))
    assert len(events) > 1_000
    assert (np.diff(events["t"]) >= 0).all() and events["t"][0] >= 0 and events["t"][-1] <= 308_000
    assert events["x"].max() < 34 and events["y"].max() < 34 and set(events["p"].tolist()) == {0, 1}


def test_events_follow_the_stated_flow():
    # a bar at 60 px/s to the right: its events move as fast, and start from its place
    motion = ConstantVelocity.towards(0.0, 60.0, duration_us=100_000)
    events = simulate_digit(digit_image(), np.random.default_rng(0), trajectory=motion, pixels=PixelModel(noise_hz=0.0))
    late = events[events["t"] > 30_000]  # each pixel has seen its first event by then
    slope, start = np.polyfit(late["t"] * 1e-6, late["x"], 1)
    assert slope == pytest.approx(60.0, rel=0.05)
    assert start == pytest.approx(motion.start[0] + 13.5, abs=0.5)  # columns 12-15


def test_the_seed_decides_the_events():
    one, again, other = (simulate_digit(digit_image(), np.random.default_rng(seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, again)
    assert one.tolist() != other.tolist()


def test_finer_frames_change_little():
    coarse, fine = (
        simulate_digit(digit_image(), np.random.default_rng(0), frame_us=frame_us, pixels=PixelModel(noise_hz=0))
        for frame_us in (1_000, 100)
    )
    assert len(coarse) == pytest.approx(len(fine), rel=0.02)


def test_other_sensors_and_image_sizes():
    rng = np.random.default_rng(0)
    events = simulate_digit(np.ones((5, 60)), rng, trajectory=ConstantVelocity((0.0, 100.0)), sensor=(64, 20))
    assert 34 < events["x"].max() < 64 and events["y"].max() < 20


@pytest.mark.parametrize("frame_us", [0.0, -1.0, 308_001.0, np.nan])
def test_impossible_frame_intervals_are_refused(frame_us):
    with pytest.raises(ValueError, match=r"`frame_us` must be in \(0, 308000\], the duration, got"):
        simulate_digit(digit_image(), np.random.default_rng(0), frame_us=frame_us)


def test_samples_are_the_first_of_each_digit_from_index_2000():
    labels = np.arange(2_020)[::-1] % 10
    indices = sample_indices(labels)
    assert {digit: labels[index] for digit, index in indices.items()} == {digit: digit for digit in range(10)}
    assert sorted(indices.values()) == list(range(2_000, 2_010))


def test_a_digit_that_does_not_occur_is_refused():
    with pytest.raises(ValueError, match="no image of a 9 from index 0 on, in 18 images"):
        sample_indices(np.arange(18) % 9, first_index=0)


def test_samples_are_reproducible_bit_for_bit(folder, tmp_path):
    first = write_samples(folder, tmp_path / "first", seed=0)
    again = write_samples(folder, tmp_path / "deep" / "again", seed=0)
    other = write_samples(folder, tmp_path / "other", seed=1)
    assert [path.name for path in first] == [f"{digit}.bin" for digit in range(10)]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in again]
    assert all(a.read_bytes() != b.read_bytes() for a, b in zip(first, other, strict=True))
    assert all(len(read_nmnist(path)) > 1_000 for path in first)


@pytest.mark.skipif(not (DATA / "mnist").is_dir(), reason=f"needs mnist in {DATA} (set TNT_DATA)")
def test_bundled_samples_are_those_of_seed_0(tmp_path):
    made = write_samples(DATA / "mnist", tmp_path, seed=0)
    for digit, bundled in sample_recordings().items():
        assert bundled.read_bytes() == made[digit].read_bytes(), f"sample {digit} is not what this version simulates"
