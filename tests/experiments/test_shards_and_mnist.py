"""Shards and MNIST's files are read as they were written.

Other or damaged files are refused by name, or keep the rules.
"""

import gzip

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import random_events

from experiments.digit_data.mnist import load_mnist
from experiments.digit_data.small_sets import idx_bytes
from experiments.moving_set.shards import open_shard, write_shard

RECORDINGS = [random_events(n, seed=n, duration_us=1_000) for n in (5, 0, 9, 3)]
FLOW = np.arange(8.0).reshape(4, 1, 2)


def write(path, recordings=RECORDINGS, **changes):
    about = {
        "labels": np.arange(4),
        "image": 100 + np.arange(4),
        "flow": FLOW,
        "flow_times_us": [500],
    }
    about |= {"sensor": (34, 34), "duration_us": 1_000, "metadata": {"seed": 7}, **changes}
    write_shard(path, recordings, **about)
    return path


def check(shard):
    """The format's rules, written a second time."""
    recordings = [shard.recording(i) for i in range(len(shard))]
    for events in recordings:
        assert (np.diff(events["t"]) >= 0).all() and (
            (events["t"] >= 0) & (events["t"] < 1_000_000)
        ).all()
        width, height = shard.metadata["sensor"]
        assert (events["x"] < width).all() and (events["y"] < height).all()
        assert (events["p"] <= 1).all()
    assert sum(map(len, recordings)) == len(shard.t) and np.isfinite(shard.flow).all()


def test_a_shard_has_what_was_written(tmp_path):
    shard = open_shard(write(tmp_path / "a.safetensors"))
    for i, events in enumerate(RECORDINGS):
        np.testing.assert_array_equal(shard.recording(i), events)
    assert [shard.t.dtype, shard.x.dtype, shard.y.dtype, shard.p.dtype] == ["i4", "u1", "u1", "u1"]
    assert shard.labels.tolist() == [0, 1, 2, 3] and shard.image.tolist() == [100, 101, 102, 103]
    assert shard.flow.tolist() == FLOW.tolist() and shard.flow_times_us.tolist() == [500]
    assert shard.metadata == {"seed": 7, "sensor": [34, 34], "duration_us": 1_000}
    assert write(tmp_path / "b.safetensors").read_bytes() == shard.path.read_bytes()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"labels": [0, 1, 2, 300]}, "`labels` must hold whole numbers that fit in uint8"),
        ({"sensor": (20, 34)}, r"`x` must be in \[0, 20\), got"),
        (
            {"recordings": [*RECORDINGS[:3], RECORDINGS[3][::-1]]},
            "`t` must not decrease within a recording",
        ),
        ({"flow": FLOW * np.nan}, "`flow` must be finite"),
        ({"flow": FLOW[:3]}, r"`flow` must have shape \(4, 1, 2\), got \(3, 1, 2\)"),
    ],
)
def test_what_breaks_a_rule_is_not_written(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        write(tmp_path / "a.safetensors", **changes)
    assert not list(tmp_path.iterdir())


@given(data=st.data())
def test_damaged_shards_are_refused_or_keep_the_rules(data, tmp_path_factory):
    whole = write(tmp_path_factory.getbasetemp() / "whole").read_bytes()
    path = tmp_path_factory.getbasetemp() / "damaged"
    raw = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, max(0, len(raw) - 1)))
        raw[place : place + data.draw(st.integers(0, 16))] = data.draw(
            st.binary(max_size=8) | st.just(b"9")
        )
    path.write_bytes(raw)
    try:
        shard = open_shard(path)
    except ValueError as error:
        assert "damaged: not a shard, or a damaged one" in str(error) and "\n" not in str(error)
    else:
        check(shard)


IMAGES = np.arange(3 * 784).reshape(3, 28, 28) % 256
LABELS = np.arange(3)


def write_mnist(folder, images, labels):
    """The training images gzipped, the test images as they are."""
    for name, content in (("images-idx3-ubyte", images), ("labels-idx1-ubyte", labels)):
        (folder / f"train-{name}.gz").write_bytes(gzip.compress(content))
        (folder / f"t10k-{name}").write_bytes(content)
    return folder


@pytest.mark.parametrize("split", ["train", "test"])
def test_mnist_is_read_gzipped_or_not(tmp_path, split):
    images, labels = load_mnist(write_mnist(tmp_path, idx_bytes(IMAGES), idx_bytes(LABELS)), split)
    np.testing.assert_array_equal(images, IMAGES)
    assert images.dtype == labels.dtype == np.uint8 and labels.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("images", "labels", "message"),
    [
        (
            idx_bytes(IMAGES[:, 1:]),
            idx_bytes(LABELS),
            r"must have shape \(N, 28, 28\), got \(3, 27, 28\)",
        ),
        (idx_bytes(IMAGES), idx_bytes(np.array([0, 10, 1])), "expected 3 labels in 0-9"),
        (idx_bytes(IMAGES), idx_bytes(LABELS)[:-1], r"shape \(3,\) takes 3 bytes, got 2"),
        (
            b"\x89PNG....",
            idx_bytes(LABELS),
            "not an IDX file of uint8 values, it begins with 89 50 4e 47",
        ),
        (b"\x1f\x8b\x08damaged", idx_bytes(LABELS), "damaged gzip file"),
    ],
)
def test_files_that_are_not_mnists_are_refused(images, labels, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        load_mnist(write_mnist(tmp_path, images, labels), "test")
