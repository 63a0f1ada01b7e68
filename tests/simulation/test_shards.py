"""Shards: what is written is read, and what breaks the format's rules is neither written nor read."""

import json

import numpy as np
import pytest
from made import random_events
from safetensors.numpy import load_file, save, save_file

from async_tnt.events import EVENT_DTYPE
from async_tnt.simulation.shards import COLUMNS, open_shard, write_shard

DURATION_US = 1_000


def recordings_of(sensor=(34, 34)):
    return [random_events(n, seed=i, duration_us=DURATION_US, sensor=sensor) for i, n in enumerate((5, 0, 9, 3))]


def write(path, recordings=None, *, sensor=(34, 34), **changes):
    recordings = recordings_of(sensor=sensor) if recordings is None else recordings
    n = len(recordings)
    arguments = {
        "labels": np.arange(n) % 10,
        "image": 100 + np.arange(n),
        "flow": np.arange(2.0 * n).reshape(n, 1, 2),
        "flow_times_us": [DURATION_US // 2],
        "sensor": sensor,
        "duration_us": DURATION_US,
        "metadata": {"motion": {"name": "still"}, "seed": 7},
        **changes,
    }
    return write_shard(path, recordings, **arguments)


@pytest.mark.parametrize(
    ("sensor", "pixel"), [((34, 34), "u1"), ((256, 256), "u1"), ((257, 10), "u2"), ((9, 720), "u2")]
)
def test_round_trip(tmp_path, sensor, pixel):
    shard = open_shard(write(tmp_path / "a.safetensors", sensor=sensor))
    assert len(shard) == 4 and shard.n_events == 17
    for i, events in enumerate(recordings_of(sensor=sensor)):
        assert shard.recording(i).dtype == EVENT_DTYPE
        np.testing.assert_array_equal(shard.recording(i), events)
        np.testing.assert_array_equal(shard.recording(i - 4), events)
    assert [shard.t.dtype, shard.x.dtype, shard.y.dtype, shard.p.dtype] == ["i4", pixel, pixel, "u1"]
    assert shard.offsets.tolist() == [0, 5, 5, 14, 17] and shard.offsets.dtype == np.int64
    assert shard.labels.tolist() == [0, 1, 2, 3] and shard.image.tolist() == [100, 101, 102, 103]
    assert shard.flow.tolist() == [[[0, 1]], [[2, 3]], [[4, 5]], [[6, 7]]] and shard.flow.dtype == np.float32
    assert shard.flow_times_us.tolist() == [500]
    assert shard.sensor == sensor and shard.duration_us == DURATION_US
    assert shard.metadata["motion"] == {"name": "still"} and shard.metadata["seed"] == 7
    for name, column in load_file(tmp_path / "a.safetensors").items():  # as other programs read it
        np.testing.assert_array_equal(column, getattr(shard, name))


def test_columns_are_aligned_and_read_only_and_recordings_are_copies(tmp_path):
    shard = open_shard(write(tmp_path / "a.safetensors"))
    for column in (getattr(shard, name) for name in COLUMNS):
        assert column.flags.aligned and column.flags.c_contiguous and not column.flags.writeable
    shard.recording(2)["t"] = 0
    assert shard.t[5:14].any()
    with pytest.raises(IndexError, match=r"must be in \[-4, 4\), got 4"):
        shard.recording(4)
    assert len(open_shard(write(tmp_path / "b", []))) == 0


def test_the_same_arguments_give_the_same_bytes_and_a_failure_leaves_the_old_file(tmp_path):
    before = write(tmp_path / "a.safetensors").read_bytes()
    assert write(tmp_path / "b.safetensors").read_bytes() == before
    with pytest.raises(ValueError):
        write(tmp_path / "a.safetensors", labels=[1])
    assert (tmp_path / "a.safetensors").read_bytes() == before and len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"labels": [0, 1, 2, 256]}, r"`labels` must be in \[0, 255\], got 0 to 256"),
        ({"labels": [0.0, 1.0, 2.0, 3.0]}, "`labels` must be whole numbers, got float64"),
        ({"flow_times_us": [5, 5], "flow": np.zeros((4, 2, 2))}, "each later than the one before"),
        ({"recordings": [recordings_of()[0][::-1]]}, "`t` must not decrease within a recording, got"),
    ],
)
def test_what_breaks_a_rule_is_not_written(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        write(tmp_path / "a.safetensors", **changes)
    assert not list(tmp_path.iterdir())


def with_value(index, value):
    def change(array):
        array[index] = value
        return array

    return change


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("t", with_value(0, -1), r"`t` must be in \[0, 1000\), got -1 at 0"),
        ("t", with_value(8, 0), "`t` must not decrease within a recording, got 0 after [0-9]+ at event 8"),
        ("t", lambda t: t.astype(np.int64), "`t` must be int32, got int64"),
        ("x", with_value(3, 34), r"`x` must be in \[0, 34\), got 34 at 3"),
        ("offsets", with_value(2, 4), "`offsets` must rise from 0 to 17"),
        ("flow", lambda flow: flow[:, 0], r"`flow` must have shape \(4, 1, 2\), got \(4, 2\)"),
        ("more", lambda _: np.zeros(3, np.int64), "must hold t, x, y, p, .*got.*more"),
    ],
)
def test_columns_that_break_a_rule_are_not_read(tmp_path, name, change, message):
    shard = open_shard(write(tmp_path / "a"))
    tensors = {column: np.array(getattr(shard, column)) for column in COLUMNS}
    tensors[name] = change(tensors.get(name))
    save_file(tensors, tmp_path / "b", metadata={"shard": json.dumps(shard.metadata)})
    with pytest.raises(ValueError, match=rf"b: not a shard, or a damaged one: .*{message}"):
        open_shard(tmp_path / "b")


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ("[" * 100_000, "its metadata is not JSON"),
        ('{"format": "async_tnt.shard", "version": 2}', "reads version 1 of the format, got 2"),
        ('{"format": "async_tnt.shard", "version": 1, "sensor": [34, true]}', "`sensor` must be a width and a height"),
    ],
)
def test_metadata_that_breaks_a_rule_is_not_read(tmp_path, metadata, message):
    (tmp_path / "b").write_bytes(save({}, metadata={"shard": metadata}))
    with pytest.raises(ValueError, match=message):
        open_shard(tmp_path / "b")
