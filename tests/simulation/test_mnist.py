"""MNIST's IDX files: bytes by hand for every type, folders, and files that are not what they should be."""

import gzip
import tracemalloc

import numpy as np
import pytest
from small_sets import idx_bytes

from async_tnt.simulation.mnist import load_mnist, read_idx


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


IMAGES, LABELS = np.arange(3 * 784).reshape(3, 28, 28) % 256, np.arange(3)


def write_folder(folder, images=IMAGES, labels=LABELS):
    """The training images gzipped, the test images as they are."""
    for name, array in (("images-idx3-ubyte", images), ("labels-idx1-ubyte", labels)):
        (folder / f"train-{name}.gz").write_bytes(gzip.compress(idx_bytes(array)))
        (folder / f"t10k-{name}").write_bytes(idx_bytes(array))
    return folder


@pytest.mark.parametrize("split", ["train", "test"])
def test_a_folder_gzipped_or_not(tmp_path, split):
    images, labels = load_mnist(write_folder(tmp_path), split)
    np.testing.assert_array_equal(images, IMAGES)
    assert images.dtype == labels.dtype == np.uint8 and labels.tolist() == [0, 1, 2]
    images[0] = 0  # the caller's to change


def test_a_folder_that_is_not_mnist_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"must be uint8 of shape \(N, 28, 28\), got uint8 \(3, 27, 28\)"):
        load_mnist(write_folder(tmp_path, images=np.zeros((3, 27, 28))), "train")
    with pytest.raises(ValueError, match=r"labels must be in 0-9, got 10 at 1"):
        load_mnist(write_folder(tmp_path, labels=np.array([0, 10, 1])), "train")
