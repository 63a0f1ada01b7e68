"""MNIST's IDX files: hand-worked bytes, made folders, damage."""

import gzip
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from async_tnt.simulation.mnist import load_mnist, read_idx


def idx_bytes(array, code=0x08, dtype=">u1"):
    header = bytes([0, 0, code, array.ndim]) + b"".join(n.to_bytes(4, "big") for n in array.shape)
    return header + array.astype(dtype).tobytes()


def mnist_folder(folder, n=3, compress=True, images=None, labels=None):
    images = np.arange(n * 784).reshape(n, 28, 28) % 256 if images is None else images
    labels = np.arange(n) % 10 if labels is None else labels
    for prefix in ("train", "t10k"):
        for name, array in (("images-idx3-ubyte", images), ("labels-idx1-ubyte", labels)):
            raw = idx_bytes(np.asarray(array))
            path = folder / f"{prefix}-{name}{'.gz' if compress else ''}"
            path.write_bytes(gzip.compress(raw) if compress else raw)
    return folder


def test_bytes_by_hand(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(bytes([0, 0, 8, 2, 0, 0, 0, 2, 0, 0, 0, 3, 1, 2, 3, 4, 5, 255]))
    np.testing.assert_array_equal(read_idx(path), np.array([[1, 2, 3], [4, 5, 255]], np.uint8))


@pytest.mark.parametrize(
    ("code", "dtype"), [(0x08, "u1"), (0x09, "i1"), (0x0B, "i2"), (0x0C, "i4"), (0x0D, "f4"), (0x0E, "f8")]
)
def test_every_type_of_value(tmp_path, code, dtype):
    array = np.arange(24).reshape(2, 3, 4).astype(dtype)
    (tmp_path / "a").write_bytes(idx_bytes(array, code, f">{dtype}"))
    values = read_idx(tmp_path / "a")
    assert values.dtype == np.dtype(dtype) and values.dtype.isnative
    np.testing.assert_array_equal(values, array)


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize("split", ["train", "test"])
def test_folder_gzipped_or_not(tmp_path, compress, split):
    images, labels = load_mnist(mnist_folder(tmp_path, compress=compress), split)
    assert images.shape == (3, 28, 28) and images.dtype == labels.dtype == np.uint8
    assert images[1, 0, 1] == (784 + 1) % 256 and labels.tolist() == [0, 1, 2]
    images[0] = 0  # the caller's to change


@pytest.mark.parametrize("size", range(18))
def test_truncation_at_every_byte(tmp_path, size):
    (tmp_path / "cut").write_bytes(bytes([0, 0, 8, 2, 0, 0, 0, 2, 0, 0, 0, 3, 1, 2, 3, 4, 5, 6])[:size])
    with pytest.raises(ValueError, match=r"cut: (not an|damaged) IDX file"):
        read_idx(tmp_path / "cut")


def test_sizes_that_do_not_fit_are_refused(tmp_path):
    (tmp_path / "a").write_bytes(idx_bytes(np.zeros((2, 3))) + b"x")
    with pytest.raises(ValueError, match=r"shape \(2, 3\) of uint8 takes 18 bytes, got more"):
        read_idx(tmp_path / "a")


def test_no_more_is_unpacked_than_the_header_says(tmp_path):
    (tmp_path / "a.gz").write_bytes(gzip.compress(idx_bytes(np.zeros((2, 3))) + bytes(50_000_000)))
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"shape \(2, 3\) of uint8 takes 18 bytes, got more"):
            read_idx(tmp_path / "a.gz")
        assert tracemalloc.get_traced_memory()[1] < 5e6
    finally:
        tracemalloc.stop()


def test_sides_whose_product_passes_64_bits_are_refused(tmp_path):
    (tmp_path / "a").write_bytes(bytes([0, 0, 8, 3]) + b"\xff" * 12)
    with pytest.raises(ValueError, match=r"takes 79228162458924105385300197391 bytes, got 16"):
        read_idx(tmp_path / "a")


def test_other_files_are_refused(tmp_path):
    (tmp_path / "a").write_bytes(b"\x89PNG....")
    with pytest.raises(ValueError, match=r"a: not an IDX file: must begin with 00 00.* got 89 50 4e 47"):
        read_idx(tmp_path / "a")
    with pytest.raises(FileNotFoundError):
        read_idx(tmp_path / "nowhere")


@settings(max_examples=200, deadline=None)
@given(data=st.data(), compress=st.booleans())
def test_damage_gives_one_clear_error_or_an_array(tmp_path_factory, data, compress):
    path = tmp_path_factory.getbasetemp() / "fuzz-idx"
    raw = idx_bytes(np.arange(60).reshape(3, 4, 5))
    raw = bytearray(gzip.compress(raw, mtime=0) if compress else raw)
    if data.draw(st.booleans()):
        del raw[data.draw(st.integers(0, len(raw) - 1)) :]
    else:
        raw[data.draw(st.integers(0, len(raw) - 1))] ^= data.draw(st.integers(1, 255))
    path.write_bytes(raw)
    try:
        values = read_idx(path)
    except ValueError as error:
        assert "fuzz-idx" in str(error)
    else:
        assert values.size == 60 or values.nbytes == 60


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"images": np.zeros((3, 27, 28))}, r"must be uint8 of shape \(N, 28, 28\), got uint8 \(3, 27, 28\)"),
        ({"labels": np.zeros(4)}, r"expected 3 uint8 labels.*got uint8 \(4,\)"),
        ({"labels": np.array([0, 10, 1])}, r"labels must be in 0-9, got 10 at 1"),
    ],
)
def test_folders_that_are_not_mnist_are_refused(tmp_path, change, complaint):
    with pytest.raises(ValueError, match=complaint):
        load_mnist(mnist_folder(tmp_path, **change), "train")


def test_missing_files_and_unknown_splits_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"neither train-images-idx3-ubyte\.gz nor train-images-idx3-ubyte;"):
        load_mnist(tmp_path, "train")
    with pytest.raises(ValueError, match=r"`split` must be one of 'train', 'test', got 'val'"):
        load_mnist(tmp_path, "val")
