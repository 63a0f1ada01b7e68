"""Statistics of a damaged file are refused in one line."""

import json

import numpy as np
import pytest
from safetensors import safe_open

from async_tnt import load_model
from async_tnt.networks.models.model_file import checksum_of, tensor_bytes
from async_tnt.networks.teaching.statistics import STATISTICS_PREFIX


def opened(path):
    with safe_open(path, "numpy") as file:
        metadata = file.metadata()
        return {name: file.get_tensor(name) for name in sorted(metadata and file.keys())}, metadata


def rewrite(path, tensors, metadata, **description):
    """Write a file whose checksum is right."""
    statistics = json.loads(metadata["statistics"]) | description
    metadata = {**metadata, "statistics": json.dumps(statistics)}
    metadata["sha256"] = checksum_of(tensors, {k: v for k, v in metadata.items() if k != "sha256"})
    path.write_bytes(tensor_bytes(tensors, metadata))


def without_windows(counts, entry):
    assert len(counts) == 5
    return np.where(np.arange(5) == entry, 0, counts)


@pytest.fixture
def file(tmp_path, taught):
    path = taught.save(tmp_path / "m.safetensors")
    return path, *opened(path)


def test_a_file_that_is_written_again_is_read(file):
    path, tensors, metadata = file
    rewrite(path, tensors, metadata)
    assert load_model(path).classes == ("a", "b", "c", "d")


@pytest.mark.parametrize(
    ("description", "message"),
    [
        ({"layer": None}, "its statistics must name layers and classes"),
        ({"layer": "nose"}, "statistics must be of layers with"),
        ({"trained": "abc"}, "its statistics must name layers and classes"),
        ({"trained": ["a", "b"]}, "statistics must be of layers with"),
        ({"classes": ["a", "a", "c", "d"]}, "its statistics must be of different classes"),
        ({"classes": ["a", "b", "c"]}, "its statistics must be of different classes"),
        ({"classes": ["a", "b", "x", "d"]}, "statistics must be of the classes a, b, c, d, got a"),
        ({"margins": {}}, "statistics must be of the classes a, b, c, d, got a, b, c"),
        ({"margins": {"d": "8"}}, "statistics must have positive margins"),
        ({"margins": {"d": 0.0}}, "statistics must have positive margins"),
        ({"margins": {"d": float("inf")}}, "statistics must have positive margins"),
        ({"margins": [8.0]}, "its statistics must name layers and classes"),
    ],
)
def test_a_wrong_description(file, description, message):
    path, tensors, metadata = file
    rewrite(path, tensors, metadata, **description)
    with pytest.raises(ValueError, match=message):
        load_model(path)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("counts", lambda one: one[:-1], "statistics' means must be of shape"),
        # of the first class, of the taught one, and of windows that show no class
        (
            "counts",
            lambda one: without_windows(one, 0),
            "statistics must be of at least one window",
        ),
        (
            "counts",
            lambda one: without_windows(one, 3),
            "statistics must be of at least one window",
        ),
        (
            "counts",
            lambda one: without_windows(one, 4),
            "statistics must be of at least one window",
        ),
        ("counts", lambda one: one.astype(np.float32), "numbers of another type"),
        ("means", lambda one: one[:, :-1], "statistics' means must be of shape"),
        ("means", lambda one: one * np.nan, "statistics must be finite numbers"),
        ("scatters", lambda one: one[:, :-1], "statistics' scatters must be of shape"),
        ("scatters", lambda one: one.astype(np.float64), "numbers of another type"),
        ("projection", lambda one: one[:-1], "statistics' center must be of shape"),
        ("projection", lambda one: one[:, 0], "must be of shape"),
        ("projection", lambda one: one[:, :-1], "statistics' means must be of shape"),
        ("center", lambda one: one[:0], "statistics' center must be of shape"),
    ],
)
def test_wrong_tensors(file, name, change, message):
    path, tensors, metadata = file
    tensors = {
        **tensors,
        STATISTICS_PREFIX + name: np.ascontiguousarray(change(tensors[STATISTICS_PREFIX + name])),
    }
    rewrite(path, tensors, metadata)
    with pytest.raises(ValueError, match=message):
        load_model(path)


@pytest.mark.parametrize("name", ["counts", "means", "scatters", "projection", "center"])
def test_a_missing_tensor(file, name):
    path, tensors, metadata = file
    rewrite(
        path, {key: t for key, t in tensors.items() if key != STATISTICS_PREFIX + name}, metadata
    )
    with pytest.raises(ValueError, match=f"its statistics have no '{STATISTICS_PREFIX}{name}'"):
        load_model(path)


def test_a_bit_that_flips(file):
    path, *_ = file
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match="its checksum differs"):
        load_model(path)
