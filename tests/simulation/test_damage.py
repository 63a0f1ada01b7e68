"""Damaged files: any damage gives one error that names the file, or data that still keeps the format's rules."""

import gzip

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import random_events
from small_sets import idx_bytes

from async_tnt.simulation.mnist import read_idx
from async_tnt.simulation.shards import open_shard, write_shard

IDX = idx_bytes(np.arange(60).reshape(3, 4, 5))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Format -> the bytes of a valid file."""
    recordings = [random_events(n, seed=n, duration_us=1_000) for n in (2, 0, 3)]
    flow, times = np.zeros((3, 1, 2)), [500]
    about = {"labels": [1, 2, 3], "image": [4, 5, 6], "flow": flow, "flow_times_us": times}
    path = write_shard(tmp_path_factory.mktemp("damage") / "a", recordings, sensor=(34, 34), duration_us=1_000, **about)
    return {"idx": IDX, "gzipped idx": gzip.compress(IDX, mtime=0), "shard": path.read_bytes()}


def check_idx(values):
    assert values.nbytes <= 80  # no more than the file could hold


def check_shard(shard):
    """The format's rules, written a second time."""
    width, height = shard.sensor
    recordings = [shard.recording(i) for i in range(len(shard))]
    for events in recordings:
        assert all(a <= b for a, b in zip(events["t"], events["t"][1:], strict=False))
        assert ((events["t"] >= 0) & (events["t"] < shard.duration_us)).all()
        assert (events["x"] < width).all() and (events["y"] < height).all() and (events["p"] <= 1).all()
    assert sum(map(len, recordings)) == len(shard.t) == len(shard.x) == len(shard.y) == len(shard.p)
    assert len(shard.offsets) == len(shard.labels) + 1 == len(shard.image) + 1 and (shard.image >= 0).all()
    assert shard.flow.shape == (len(shard), len(shard.flow_times_us), 2) and np.isfinite(shard.flow).all()


READERS = {
    "idx": (read_idx, check_idx, "(not an|damaged) IDX file"),
    "gzipped idx": (read_idx, check_idx, "(not an|damaged) (IDX|gzip) file"),
    "shard": (open_shard, check_shard, "not a shard, or a damaged one"),
}


@pytest.mark.parametrize("format", READERS)
def test_truncation(format, whole, tmp_path):
    read, check, message = READERS[format]
    path = tmp_path / "cut"
    n = len(whole[format])
    for size in sorted({*range(0, n, 7), *range(min(n, 40)), n - 1}):
        path.write_bytes(whole[format][:size])
        with pytest.raises(ValueError, match=f"cut: {message}"):
            read(path)
    path.write_bytes(whole[format])
    check(read(path))


@given(data=st.data())
def test_random_damage(data, whole, tmp_path_factory):
    format = data.draw(st.sampled_from(list(READERS)))
    read, check, _ = READERS[format]
    path, raw = tmp_path_factory.getbasetemp() / "damaged", bytearray(whole[format])
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, max(0, len(raw) - 1)))
        n = data.draw(st.integers(0, 16))  # bytes that go, in the place of which come
        raw[place : place + n] = data.draw(st.binary(max_size=8) | st.sampled_from([b"-", b"e", b"]", b'"', b"9"]))
    path.write_bytes(raw)
    try:
        found = read(path)
    except ValueError as error:
        assert "damaged: " in str(error) and "\n" not in str(error)
    else:
        check(found)
