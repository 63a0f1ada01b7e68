"""Shards: what is written is read, and no damage goes unnoticed."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import random_events
from safetensors.numpy import load_file, save

from async_tnt.events import EVENT_DTYPE
from async_tnt.simulation.shards import open_shard, write_shard

DURATION_US = 1_000


def recordings_of(sizes=(5, 0, 9, 3), sensor=(34, 34)):
    return [random_events(n, seed=i, duration_us=DURATION_US, sensor=sensor) for i, n in enumerate(sizes)]


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
    recordings = recordings_of(sensor=sensor)
    shard = open_shard(write(tmp_path / "a.safetensors", sensor=sensor))
    assert len(shard) == 4 and shard.n_events == 17
    for i, events in enumerate(recordings):
        assert shard.recording(i).dtype == EVENT_DTYPE
        np.testing.assert_array_equal(shard.recording(i), events)
        np.testing.assert_array_equal(shard.recording(i - 4), events)
        for name, column in zip("txyp", shard.columns(i), strict=True):
            np.testing.assert_array_equal(column, events[name])
    assert [shard.t.dtype, shard.x.dtype, shard.y.dtype, shard.p.dtype] == ["i4", pixel, pixel, "u1"]
    assert shard.offsets.tolist() == [0, 5, 5, 14, 17] and shard.offsets.dtype == np.int64
    assert shard.labels.tolist() == [0, 1, 2, 3] and shard.image.tolist() == [100, 101, 102, 103]
    assert shard.flow.tolist() == [[[0, 1]], [[2, 3]], [[4, 5]], [[6, 7]]] and shard.flow.dtype == np.float32
    assert shard.flow_times_us.tolist() == [500]
    assert shard.sensor == sensor and shard.duration_us == DURATION_US
    assert shard.metadata["motion"] == {"name": "still"} and shard.metadata["seed"] == 7
    assert "4 recordings, 17 events" in repr(shard)


def test_columns_are_aligned_and_read_only(tmp_path):
    shard = open_shard(write(tmp_path / "a.safetensors"))
    for column in (*shard.columns(2), shard.offsets, shard.labels, shard.image, shard.flow, shard.flow_times_us):
        assert column.flags.aligned and column.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            column[...] = 0
    shard.recording(2)["t"] = 0  # a copy, the caller's to change
    assert shard.t[5:14].any()


def test_other_programs_read_it_by_the_library(tmp_path):
    shard = open_shard(write(tmp_path / "a.safetensors"))
    for name, column in load_file(tmp_path / "a.safetensors").items():
        np.testing.assert_array_equal(column, getattr(shard, name))


@pytest.mark.parametrize("sizes", [(), (0,), (0, 0, 0)])
def test_nothing_is_a_shard_too(tmp_path, sizes):
    shard = open_shard(write(tmp_path / "a.safetensors", recordings_of(sizes)))
    assert len(shard) == len(sizes) and shard.n_events == 0
    assert all(len(shard.recording(i)) == 0 for i in range(len(shard)))


def test_recordings_that_are_not_there(tmp_path):
    shard = open_shard(write(tmp_path / "a.safetensors"))
    for i in (4, -5):
        with pytest.raises(IndexError, match=rf"must be in \[-4, 4\), got {i}"):
            shard.recording(i)


def test_same_arguments_same_bytes_and_a_failure_leaves_the_old_file(tmp_path):
    before = write(tmp_path / "a.safetensors").read_bytes()
    assert write(tmp_path / "b.safetensors").read_bytes() == before
    (tmp_path / "folder.safetensors").mkdir()
    with pytest.raises(OSError):
        write(tmp_path / "folder.safetensors")
    with pytest.raises(ValueError):
        write(tmp_path / "a.safetensors", labels=[1])
    assert (tmp_path / "a.safetensors").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.safetensors", "b.safetensors", "folder.safetensors"]


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"labels": [1, 2, 3]}, r"`offsets` must have shape \(4,\), got \(5,\)"),
        ({"labels": [0, 1, 2, 256]}, r"`labels` must be in \[0, 255\], got 0 to 256"),
        ({"labels": [0.0, 1.0, 2.0, 3.0]}, "`labels` must be whole numbers, got float64"),
        ({"image": [0, 1, 2, -1]}, r"`image` must be in \[0, 2147483648\), got -1 at 3"),
        ({"flow": np.zeros((4, 2))}, r"`flow` must have shape \(4, 1, 2\), got \(4, 2\)"),
        ({"flow": np.full((4, 1, 2), np.nan)}, "`flow` must be finite"),
        ({"flow": np.full((4, 1, 2), 1e300)}, "`flow` must be finite"),
        ({"flow_times_us": [], "flow": np.zeros((4, 0, 2))}, "`flow_times_us` must hold at least one time"),
        ({"flow_times_us": [5, 5], "flow": np.zeros((4, 2, 2))}, "each later than the one before"),
        ({"flow_times_us": [1_001]}, r"`flow_times_us` must be in \[0, 1001\), got 1001 at 0"),
        ({"sensor": (0, 34), "recordings": recordings_of()}, r"`sensor` must be a width and .*, got \[0, 34\]"),
        ({"duration_us": 0}, "`duration_us` must be a whole number in"),
        ({"duration_us": 10}, r"`t` must be in \[0, 10\), got"),
        ({"sensor": (20, 34), "recordings": recordings_of()}, r"`x` must be in \[0, 20\), got"),
        ({"recordings": [recordings_of()[0][::-1]]}, "`t` must not decrease within a recording, got"),
    ],
)
def test_what_breaks_the_rules_is_not_written(tmp_path, changes, complaint):
    with pytest.raises(ValueError, match=complaint):
        write(tmp_path / "a.safetensors", **changes)
    assert not list(tmp_path.iterdir())


def test_truncation_at_every_byte(tmp_path):
    whole = write(tmp_path / "a.safetensors", recordings_of((2, 1))).read_bytes()
    assert len(open_shard(tmp_path / "a.safetensors")) == 2
    for size in range(len(whole)):
        (tmp_path / "cut").write_bytes(whole[:size])
        with pytest.raises(ValueError, match="cut: not a shard, or a damaged one: "):
            open_shard(tmp_path / "cut")
    (tmp_path / "cut").write_bytes(whole + b"\0")
    with pytest.raises(ValueError, match="cut: not a shard, or a damaged one: "):
        open_shard(tmp_path / "cut")


def assert_rules(shard):
    """The format's rules, written a second time."""
    width, height = shard.sensor
    assert shard.offsets[0] == 0 and shard.offsets[-1] == len(shard.t)
    assert len(shard.t) == len(shard.x) == len(shard.y) == len(shard.p)
    assert len(shard.offsets) == len(shard.labels) + 1 == len(shard.image) + 1 == len(shard.flow) + 1
    total = 0
    for i in range(len(shard)):
        events = shard.recording(i)
        total += len(events)
        assert all(a <= b for a, b in zip(events["t"], events["t"][1:], strict=False))
        assert ((events["t"] >= 0) & (events["t"] < shard.duration_us)).all()
        assert (events["x"] < width).all() and (events["y"] < height).all() and (events["p"] <= 1).all()
    assert total == len(shard.t) and (shard.image >= 0).all()
    assert shard.flow.shape == (len(shard), len(shard.flow_times_us), 2) and np.isfinite(shard.flow).all()


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_random_damage_gives_one_clear_error_or_data_that_respects_the_rules(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "fuzz-shard"
    raw = bytearray(write(path, recordings_of((2, 0, 3))).read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(raw) - 1))
        kind = data.draw(st.sampled_from(["flip", "set", "cut", "insert"]))
        if kind == "flip":
            raw[place] ^= 1 << data.draw(st.integers(0, 7))
        elif kind == "set":
            raw[place] = data.draw(st.sampled_from(b'\x00\xff09-[]{}",:.eI '))
        elif kind == "cut":
            del raw[place : place + data.draw(st.integers(1, 16))]
        else:
            raw[place:place] = data.draw(st.binary(min_size=1, max_size=8))
        if not raw:
            break
    path.write_bytes(raw)
    try:
        shard = open_shard(path)
    except ValueError as error:
        assert "fuzz-shard: not a shard, or a damaged one: " in str(error) and "\n" not in str(error)
    else:
        assert_rules(shard)


def tensors_of(path):
    shard = open_shard(write(path))
    names = ("t", "x", "y", "p", "offsets", "labels", "image", "flow", "flow_times_us")
    return {name: np.array(getattr(shard, name)) for name in names}, dict(shard.metadata)


def changed(index, value):
    def change(array):
        array[index] = value
        return array

    return change


@pytest.mark.parametrize(
    ("name", "change", "complaint"),
    [
        ("t", changed(0, -1), r"`t` must be in \[0, 1000\), got -1 at 0"),
        ("t", changed(16, 1_000), r"`t` must be in \[0, 1000\), got 1000 at 16"),
        ("t", changed(8, 0), "`t` must not decrease within a recording, got 0 after [0-9]+ at event 8"),
        ("t", lambda t: t.astype(np.int64), "`t` must be int32, got int64"),
        ("x", changed(3, 34), r"`x` must be in \[0, 34\), got 34 at 3"),
        ("x", lambda x: x.astype(np.uint16), "`x` must be uint8, got uint16"),
        ("y", lambda y: y[1:], r"`y` must have shape \(17,\), got \(16,\)"),
        ("p", changed(5, 2), r"`p` must be in \[0, 2\), got 2 at 5"),
        ("offsets", changed(0, 1), "`offsets` must rise from 0 to 17"),
        ("offsets", changed(4, 16), "`offsets` must rise from 0 to 17"),
        ("offsets", changed(2, 4), "`offsets` must rise from 0 to 17"),
        ("offsets", lambda offsets: offsets[:-1], r"`offsets` must have shape \(5,\), got \(4,\)"),
        ("labels", lambda labels: labels[:, None], r"`labels` must have shape \(4,\), got \(4, 1\)"),
        ("image", changed(1, -3), "`image` must be in"),
        ("flow", changed(0, np.inf), "`flow` must be finite"),
        ("flow", lambda flow: flow.astype(np.float64), "`flow` must be float32, got float64"),
        ("flow_times_us", changed(0, -1), "`flow_times_us` must be in"),
        ("more", lambda _: np.zeros(3, np.int64), "must hold t, x, y, p, .*got.*more"),
    ],
)
def test_columns_that_break_a_rule_are_refused(tmp_path, name, change, complaint):
    tensors, metadata = tensors_of(tmp_path / "a")
    tensors[name] = change(tensors.get(name))
    (tmp_path / "b").write_bytes(save(tensors, metadata={"shard": json.dumps(metadata)}))
    with pytest.raises(ValueError, match=rf"b: not a shard, or a damaged one: .*{complaint}"):
        open_shard(tmp_path / "b")


@pytest.mark.parametrize(
    ("metadata", "complaint"),
    [
        (None, "no `shard` in its metadata"),
        ("{", "its metadata is not JSON"),
        ("[" * 100_000, "its metadata is not JSON"),
        ("[]", "must have the format 'async_tnt.shard'"),
        ('{"format": "x"}', "must have the format 'async_tnt.shard'"),
        ('{"format": "async_tnt.shard", "version": 2}', "reads version 1 of the format, got 2"),
        ('{"format": "async_tnt.shard", "version": 1}', "`sensor` must be a width and a height"),
        ('{"format": "async_tnt.shard", "version": 1, "sensor": [34, true]}', "`sensor` must be a width and a height"),
        (
            '{"format": "async_tnt.shard", "version": 1, "sensor": [34, 34], "duration_us": 1e3}',
            "must be a whole number",
        ),
    ],
)
def test_metadata_that_breaks_a_rule_is_refused(tmp_path, metadata, complaint):
    tensors, _ = tensors_of(tmp_path / "a")
    (tmp_path / "b").write_bytes(save(tensors, metadata=None if metadata is None else {"shard": metadata}))
    with pytest.raises(ValueError, match=complaint):
        open_shard(tmp_path / "b")


@pytest.mark.parametrize(
    "header",
    [
        b"\xff",
        b"[" * 50_000,
        b"[]",
        b'{"__metadata__": {"a": 1}}',
        b'{"t": 3}',
        b'{"t": {"dtype": "U8", "shape": [-4], "data_offsets": [0, 4]}}',
        b'{"t": {"dtype": "U8", "shape": [0, 1180591620717411303424], "data_offsets": [0, 0]}}',
        b'{"t": {"dtype": "U8", "shape": [0, 99999999999999, 99999999999999], "data_offsets": [0, 0]}}',
        b'{"t": {"dtype": "U8", "shape": [4], "data_offsets": [4, 0]}}',
        b'{"t": {"dtype": "I32", "shape": [2], "data_offsets": [0, 4]}}',
        b'{"t": {"dtype": "U8", "shape": [2], "data_offsets": [2, 4]}}',
        b'{"t": {"dtype": "U8", "shape": [3], "data_offsets": [0, 3]}}',
        b'{"t": {"dtype": "BF16", "shape": [2], "data_offsets": [0, 4]}}',
    ],
)
def test_damaged_headers_are_refused(tmp_path, header):
    (tmp_path / "a").write_bytes(len(header).to_bytes(8, "little") + header + bytes(4))
    with pytest.raises(ValueError, match="a: not a shard, or a damaged one: "):
        open_shard(tmp_path / "a")


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(FileNotFoundError):
        open_shard(tmp_path / "nowhere")
    with pytest.raises((OSError, ValueError)):
        open_shard(tmp_path)
