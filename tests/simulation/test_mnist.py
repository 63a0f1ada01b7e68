"""MNIST's IDX files: bytes by hand, every type, folders, and files that are not what they should be."""

import gzip
import tracemalloc

import numpy as np
import pytest
from small_sets import idx_bytes

from async_tnt.simulation.mnist import load_mnist, read_idx


def test_bytes_by_hand(tmp_path):
    (tmp_path / "a").write_bytes(bytes([0, 0, 8, 2, 0, 0, 0, 2, 0, 0, 0, 3, 1, 2, 3, 4, 5, 255]))
    np.testing.assert_array_equal(read_idx(tmp_path / "a"), np.array([[1, 2, 3], [4, 5, 255]], np.uint8))


@pytest.mark.parametrize(
    ("code", "dtype"), [(0x08, "u1"), (0x09, "i1"), (0x0B, "i2"), (0x0C, "i4"), (0x0D, "f4"), (0x0E, "f8")]
)
def test_every_type_of_value(tmp_path, code, dtype):
    array = np.arange(24).reshape(2, 3, 4).astype(dtype)
    header = bytes([0, 0, code, 3, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0, 4])
    (tmp_path / "a").write_bytes(header + array.astype(f">{dtype}").tobytes())
    values = read_idx(tmp_path / "a")
    assert values.dtype == np.dtype(dtype) and values.dtype.isnative
    np.testing.assert_array_equal(values, array)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (idx_bytes(np.zeros((2, 3))) + b"x", r"shape \(2, 3\) of uint8 takes 18 bytes, got more"),
        (bytes([0, 0, 8, 3]) + b"\xff" * 12, "takes 79228162458924105385300197391 bytes, got 16"),  # beyond 64 bits
        (b"\x89PNG....", r"a: not an IDX file: must begin with 00 00.* got 89 50 4e 47"),
    ],
)
def test_files_that_contradict_themselves_are_refused(tmp_path, raw, message):
    (tmp_path / "a").write_bytes(raw)
    with pytest.raises(ValueError, match=message):
        read_idx(tmp_path / "a")


def test_no_more_is_unpacked_than_the_header_states(tmp_path):
    (tmp_path / "a.gz").write_bytes(gzip.compress(idx_bytes(np.zeros((2, 3))) + bytes(50_000_000)))
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"shape \(2, 3\) of uint8 takes 18 bytes, got more"):
            read_idx(tmp_path / "a.gz")
        assert tracemalloc.get_traced_memory()[1] < 5e6
    finally:
        tracemalloc.stop()


def write_folder(folder, images=None, labels=None, suffix=".gz"):
    images = np.arange(3 * 784).reshape(3, 28, 28) % 256 if images is None else images
    labels = np.arange(3) if labels is None else labels
    for prefix in ("train", "t10k"):
        for name, array in (("images-idx3-ubyte", images), ("labels-idx1-ubyte", labels)):
            raw = idx_bytes(array)
            (folder / f"{prefix}-{name}{suffix}").write_bytes(gzip.compress(raw) if suffix else raw)
    return folder


@pytest.mark.parametrize(("split", "suffix"), [("train", ".gz"), ("test", "")])
def test_a_folder_gzipped_or_not(tmp_path, suffix, split):
    images, labels = load_mnist(write_folder(tmp_path, suffix=suffix), split)
    assert images.shape == (3, 28, 28) and images.dtype == labels.dtype == np.uint8
    assert images[1, 0, 1] == (784 + 1) % 256 and labels.tolist() == [0, 1, 2]
    images[0] = 0  # the caller's to change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"images": np.zeros((3, 27, 28))}, r"must be uint8 of shape \(N, 28, 28\), got uint8 \(3, 27, 28\)"),
        ({"labels": np.zeros(4)}, r"expected 3 uint8 labels.*got uint8 \(4,\)"),
        ({"labels": np.array([0, 10, 1])}, r"labels must be in 0-9, got 10 at 1"),
    ],
)
def test_folders_that_are_not_mnist_are_refused(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        load_mnist(write_folder(tmp_path, **change), "train")


def test_missing_files_and_unknown_splits_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"neither train-images-idx3-ubyte\.gz nor train-images-idx3-ubyte;"):
        load_mnist(tmp_path, "train")
    with pytest.raises(ValueError, match=r"`split` must be one of 'train', 'test', got 'val'"):
        load_mnist(tmp_path, "val")
