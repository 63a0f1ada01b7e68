"""Every recording of the set is what its seed says.

This holds however the work was shared out, cut or interrupted.
"""

import json
import shutil

import numpy as np
import pytest

from experiments.digit_data.mnist import load_mnist
from experiments.motions.kinds import motions_of
from experiments.motions.simulated_digits import simulate_digit
from experiments.motions.trajectories import ConstantVelocity
from experiments.moving_set.build import build, open_set
from experiments.moving_set.shards import open_shard

QUICK = {"which": range(5), "recordings_per_shard": 2, "frame_us": 5_250.0, "workers": 1}


def files_of(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def made(mnist, tmp_path_factory):
    return build(mnist, tmp_path_factory.mktemp("made"), **QUICK)


@pytest.fixture
def copied(made, tmp_path):
    return shutil.copytree(made.folder, tmp_path / "set")


def test_each_recording_is_simulated_with_its_own_seed(mnist, made):
    images, labels = load_mnist(mnist, "test")
    for index, image in ((0, 0), (7, 3), (29, 4)):
        motion = motions_of("constant")[index]
        angle = np.radians(motion.direction_deg)
        speed = motion.distance_px / 0.105
        trajectory = ConstantVelocity.towards(motion.direction_deg, speed)
        rng = np.random.default_rng((0, index, image))
        expected = simulate_digit(images[image], rng, trajectory=trajectory, frame_us=5_250.0)
        path, place = made.locate(index, image)
        shard = open_shard(path)
        np.testing.assert_array_equal(shard.recording(place), expected[expected["t"] < 105_000])
        assert len(expected) > 100
        assert shard.image[place] == image and shard.labels[place] == labels[image]
        velocity = speed * np.cos(angle), speed * np.sin(angle)
        np.testing.assert_allclose(shard.flow[place], [velocity], rtol=1e-6, atol=1e-12)
        assert shard.metadata["motion"]["name"] == motion.name and shard.metadata["split"] == "test"


def test_workers_and_the_size_of_shards_change_no_recording(mnist, made, tmp_path):
    build(mnist, tmp_path / "two workers", **QUICK | {"workers": 2})
    assert files_of(tmp_path / "two workers") == files_of(made.folder)
    other = build(mnist, tmp_path / "larger", **QUICK | {"recordings_per_shard": 3})
    assert len(other.shards) == 60
    for index, image in ((0, 0), (11, 2), (11, 3), (29, 4)):
        path, place = made.locate(index, image)
        other_path, other_place = other.locate(index, image)
        one = open_shard(path)
        same = open_shard(other_path)
        assert one.recording(place).tolist() == same.recording(other_place).tolist()
        assert one.image[place] == same.image[other_place] == image


def test_what_is_there_is_kept_and_what_is_missing_or_damaged_is_made(mnist, made, copied):
    missing = copied / made.shards[3].name
    cut = copied / made.shards[4].name
    flipped = copied / made.shards[5].name
    missing.unlink()
    cut.write_bytes(cut.read_bytes()[:-1])
    flipped.write_bytes(flipped.read_bytes()[:-1] + bytes([flipped.read_bytes()[-1] ^ 0xFF]))
    (copied / f"{missing.name}.part").write_bytes(b"left by a killed process")
    times = {path.name: path.stat().st_mtime_ns for path in copied.iterdir()}
    build(mnist, copied, **QUICK)
    assert files_of(copied) == files_of(made.folder)
    kept = {
        path.name for path in copied.iterdir() if times.get(path.name) == path.stat().st_mtime_ns
    }
    assert kept == set(times) - {missing.name, cut.name, flipped.name, f"{missing.name}.part"}


def test_a_set_of_other_parameters_or_without_its_manifest_is_refused_and_left_alone(
    mnist, made, tmp_path
):
    before = files_of(made.folder)
    with pytest.raises(
        ValueError,
        match=r"set\.json: made with other .*: seed is 0, requested 1\. Give the same parameters",
    ):
        build(mnist, made.folder, **QUICK | {"seed": 1})
    (tmp_path / made.shards[0].name).write_bytes(made.shards[0].read_bytes())
    with pytest.raises(
        ValueError, match=r"shards without set\.json, which says how they were made"
    ):
        build(mnist, tmp_path, **QUICK | {"seed": 3})
    assert files_of(made.folder) == before


def test_open_set_gives_what_build_gave(made):
    """There is a shard for each motion and two images.

    All recordings differ, and lie in one window of 105 ms.
    """
    opened = open_set(made.folder)
    assert opened == made and opened.motions == motions_of("constant")
    assert len(made) == 150 and [len(shard) for shard in made] == [2, 2, 1] * 30
    assert sorted(files_of(made.folder)) == [*(path.name for path in made.shards), "set.json"]
    assert len({shard.recording(i).tobytes() for shard in made for i in range(len(shard))}) == len(
        made
    )
    # the last half microsecond would round up to 105,000, where the next window begins
    assert 104_900 < max(int(shard.t.max()) for shard in made) < 105_000


def test_a_damaged_manifest_is_refused_in_one_line(made, tmp_path):
    content = json.loads((made.folder / "set.json").read_text())
    elsewhere = json.dumps(content | {"shards": ["../elsewhere", *content["shards"][1:]]})
    for text in (elsewhere, elsewhere[:-1], "[]"):
        (tmp_path / "set.json").write_text(text)
        with pytest.raises(
            ValueError, match=r"set\.json: damaged, or not a set of this release: "
        ) as caught:
            open_set(tmp_path)
        assert "\n" not in str(caught.value)
