"""The set: every recording is what its seed says, however the work was shared out, cut or interrupted."""

import json
import shutil

import numpy as np
import pytest
from small_sets import idx_bytes

from async_tnt.simulation.digits import simulate_digit
from async_tnt.simulation.mnist import load_mnist
from async_tnt.simulation.motions import motions_of
from async_tnt.simulation.moving_mnist import build, open_set
from async_tnt.simulation.scene import Scene
from async_tnt.simulation.shards import open_shard
from async_tnt.simulation.trajectories import ConstantVelocity

QUICK = {"digits": 5, "recordings_per_shard": 2, "frame_us": 5_250.0, "workers": 1}


def files_of(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def made(mnist, tmp_path_factory):
    return build(mnist, tmp_path_factory.mktemp("made"), **QUICK)


@pytest.fixture
def copied(made, tmp_path):
    return shutil.copytree(made.folder, tmp_path / "set")


def test_a_shard_for_each_motion_and_two_images(made):
    assert len(made) == 150 and len(made.shards) == 90 and made.sensor == (34, 34)
    names = [path.name for path in made.shards]
    assert names[:4] == [f"000deg-{name}.safetensors" for name in ("3px_00000", "3px_00002", "3px_00004", "5px_00000")]
    assert names == sorted(names)
    assert sorted(files_of(made.folder)) == sorted([*names, "set.json"])
    assert [len(shard) for shard in made][:6] == [2, 2, 1, 2, 2, 1]


def test_each_recording_is_simulated_with_its_own_seed(mnist, made):
    images, labels = load_mnist(mnist, "test")
    for index, image in ((0, 0), (7, 3), (29, 4)):
        motion = motions_of("constant")[index]
        angle, speed = np.radians(motion.direction_deg), motion.distance_px / 0.105
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


def test_recordings_differ_and_lie_in_one_window_of_105_ms(made):
    """The last half microsecond would round up to 105,000, where the next window begins."""
    assert len({shard.recording(i).tobytes() for shard in made for i in range(len(shard))}) == len(made)
    assert 104_900 < max(int(shard.t.max()) for shard in made) < 105_000


def test_workers_and_the_size_of_shards_change_no_recording(mnist, made, tmp_path):
    build(mnist, tmp_path / "two workers", **QUICK | {"workers": 2})
    assert files_of(tmp_path / "two workers") == files_of(made.folder)
    other = build(mnist, tmp_path / "larger", **QUICK | {"recordings_per_shard": 3})
    assert len(other.shards) == 60
    for index, image in ((0, 0), (11, 2), (11, 3), (29, 4)):
        (path, place), (other_path, other_place) = made.locate(index, image), other.locate(index, image)
        one, same = open_shard(path), open_shard(other_path)
        assert one.recording(place).tolist() == same.recording(other_place).tolist()
        assert one.image[place] == same.image[other_place] == image


def test_seed_scene_and_motion_decide(mnist, made, tmp_path):
    def first_recording(**change):
        other = build(mnist, tmp_path / str(change), **QUICK | {"digits": 1} | change)
        return open_shard(other.shards[0]).recording(0).tolist()

    of_made = open_shard(made.shards[0]).recording(0).tolist()
    assert of_made != first_recording(seed=1) and of_made != first_recording(scene=Scene(contrast=3.0))
    images, _ = load_mnist(mnist, "test")
    expected = simulate_digit(images[0], np.random.default_rng((0, 0, 0)), frame_us=5_250.0)  # of N-MNIST's motion
    assert first_recording(kind="nmnist") == expected[expected["t"] < 308_000].tolist()


def test_what_is_there_is_kept_and_what_is_missing_or_damaged_is_made(mnist, made, copied):
    missing, cut, flipped = (copied / path.name for path in made.shards[3:6])
    missing.unlink()
    cut.write_bytes(cut.read_bytes()[:-1])
    flipped.write_bytes(flipped.read_bytes()[:-1] + bytes([flipped.read_bytes()[-1] ^ 0xFF]))
    (copied / f"{missing.name}.123.part").write_bytes(b"left by a killed process")
    times = {path.name: path.stat().st_mtime_ns for path in copied.iterdir()}
    build(mnist, copied, **QUICK)
    assert files_of(copied) == files_of(made.folder)
    kept = {path.name for path in copied.iterdir() if times.get(path.name) == path.stat().st_mtime_ns}
    assert kept == set(times) - {missing.name, cut.name, flipped.name, f"{missing.name}.123.part"}


@pytest.mark.parametrize(
    ("change", "message"),
    [({"seed": 1}, "seed is 0, requested 1"), ({"frame_us": 1_000.0}, "simulator is .*5250.*, requested .*1000.*")],
)
def test_a_set_made_with_other_parameters_is_refused_and_left_alone(mnist, made, change, message):
    before = files_of(made.folder)
    with pytest.raises(ValueError, match=rf"set\.json: made with other parameters: {message}\. Give the same, or "):
        build(mnist, made.folder, **QUICK | change)
    assert files_of(made.folder) == before


def test_shards_and_images_of_another_set_are_refused(mnist, made, tmp_path):
    """As when someone copies files between folders, or loses set.json."""
    (tmp_path / made.shards[0].name).write_bytes(made.shards[0].read_bytes())
    with pytest.raises(ValueError, match=r"3px_00000\.safetensors: made with other .*: seed is 0, requested 3"):
        build(mnist, tmp_path, **QUICK | {"seed": 3})
    other = shutil.copytree(mnist, tmp_path / "mnist")
    images, _ = load_mnist(mnist, "test")
    (other / "t10k-images-idx3-ubyte.gz").write_bytes(idx_bytes(255 - images))
    with pytest.raises(ValueError, match="made with other parameters: mnist_sha256"):
        build(other, made.folder, **QUICK)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "circles"}, "`kind` of motion must be one of"),
        ({"digits": 25}, "`digits` must be at most 24, the images of split 'test', got 25"),
        ({"digits": 0}, "`digits` must be at least 1, got 0"),
        ({"seed": -1}, "`seed` must be at least 0, got -1"),
    ],
)
def test_invalid_arguments_are_refused_before_anything_is_written(mnist, tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        build(mnist, tmp_path / "set", **QUICK | change)
    assert not (tmp_path / "set").exists()


def test_open_set_gives_what_build_gave(made):
    opened = open_set(made.folder)
    assert opened == made and opened.motions == motions_of("constant") and opened.missing == 0
    assert opened.parameters["simulator"]["pixels"]["threshold_on"] > 0
    for motion, image in ((30, 0), (0, 5), (-1, 0)):
        with pytest.raises(IndexError, match=r"motion must be in \[0, 30\) and image in \[0, 5\), got"):
            opened.locate(motion, image)


def test_an_incomplete_set_is_refused_with_the_command_to_resume(made, copied):
    for path in made.shards[10:13]:
        (copied / path.name).unlink()
    command = f"async-tnt simulate --mnist MNIST --out {copied} --split test --motions constant --digits 5 --seed 0"
    with pytest.raises(ValueError, match=f"3 of 90 shards are missing. Resume with: {command}"):
        open_set(copied)
    opened = open_set(copied, allow_incomplete=True)
    assert opened.missing == 3 and len(opened.shards) == 90 and sum(1 for _ in opened) == 87


def without(name):
    return lambda content: {key: value for key, value in content.items() if key != name}


def with_parameter(name, value):
    return lambda content: content | {"parameters": content["parameters"] | {name: value}}


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: [],
        without("parameters"),
        lambda content: content | {"version": 2},
        lambda content: content | {"motions": content["motions"][1:]},
        lambda content: content | {"motions": ["000deg-3px"]},
        lambda content: content | {"shards": ["../elsewhere", *content["shards"][1:]]},
        with_parameter("digits", 5.0),
        with_parameter("recordings_per_shard", 0),
        with_parameter("sensor", None),
        lambda content: content | {"parameters": without("simulator")(content["parameters"])},
    ],
)
def test_a_damaged_manifest_is_refused_in_one_line(made, tmp_path, damage):
    content = json.dumps(damage(json.loads((made.folder / "set.json").read_text())))
    for text in (content, content[:-1]):
        (tmp_path / "set.json").write_text(text)
        with pytest.raises(ValueError, match=r"set\.json: damaged, or not a set of this release: ") as caught:
            open_set(tmp_path, allow_incomplete=True)
        assert "\n" not in str(caught.value)
