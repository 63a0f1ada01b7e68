"""Read MNIST's IDX files.

    bytes 0-1   zero
    byte 2      type of the values: 8 uint8, 9 int8, 11 int16, 12 int32, 13 float32, 14 float64
    byte 3      number of dimensions
    then        one big-endian uint32 per dimension, then the values, big-endian, last dimension fastest

References
----------
LeCun, Cortes, Burges, The MNIST Database of Handwritten Digits, section "File formats".
"""

from __future__ import annotations

import gzip
import math
import os
import zlib
from pathlib import Path
from typing import IO

import numpy as np

_TYPES = {0x08: ">u1", 0x09: ">i1", 0x0B: ">i2", 0x0C: ">i4", 0x0D: ">f4", 0x0E: ">f8"}
_PREFIX = {"train": "train", "test": "t10k"}


def read_idx(path: str | os.PathLike[str]) -> np.ndarray:
    """Read one IDX file at `path`, plain or gzipped (recognised by its first two bytes, not by its name).

    Returns
    -------
    Array of the shape and type that the file states, in native byte order, writeable.

    Raises
    ------
    ValueError : damaged, or not an IDX file; the message names the file.
    OSError : missing or not readable.
    """
    path = Path(path)
    with path.open("rb") as file:
        if file.peek(2)[:2] != b"\x1f\x8b":
            return _read_idx(path, file)
        try:
            with gzip.GzipFile(fileobj=file) as unpacked:
                return _read_idx(path, unpacked)
        except (OSError, EOFError, zlib.error) as error:
            raise ValueError(f"{path}: damaged gzip file: {error}") from error


def _read_idx(path: Path, file: IO[bytes] | gzip.GzipFile) -> np.ndarray:
    raw = _read_up_to(file, 4)
    if len(raw) < 4 or raw[0] or raw[1] or raw[2] not in _TYPES:
        raise ValueError(
            f"{path}: not an IDX file: must begin with 00 00, a type in {[hex(code) for code in _TYPES]} and "
            f"the number of dimensions, got {raw[:4].hex(' ') or 'nothing'}"
        )
    dtype, n_dims = np.dtype(_TYPES[raw[2]]), raw[3]
    n_header = 4 + 4 * n_dims
    raw += _read_up_to(file, 4 * n_dims)
    if len(raw) < n_header:
        raise ValueError(f"{path}: damaged IDX file: the header takes {n_header} bytes, got {len(raw)}")
    shape = tuple(int(n) for n in np.frombuffer(raw, ">u4", n_dims, offset=4))
    n_expected = n_header + math.prod(shape) * dtype.itemsize  # in Python integers: these cannot wrap
    raw += _read_up_to(file, n_expected + 1 - n_header)
    if len(raw) != n_expected:
        got = "more" if len(raw) > n_expected else len(raw)
        raise ValueError(f"{path}: damaged IDX file: shape {shape} of {dtype.name} takes {n_expected} bytes, got {got}")
    try:
        values = np.frombuffer(raw, dtype, offset=n_header).reshape(shape)
    except ValueError as error:  # over 64 dimensions, or a size of 0 with others beyond numpy's limits
        raise ValueError(f"{path}: damaged IDX file: numpy cannot hold the stated shape: {error}") from error
    return values.astype(dtype.newbyteorder("="))


def _read_up_to(file: IO[bytes] | gzip.GzipFile, n: int) -> bytearray:
    """At most n bytes, in pieces: the file states n, and `read(n)` would allocate them at once."""
    data = bytearray()
    while len(data) < n and (piece := file.read(min(n - len(data), 1 << 20))):
        data += piece
    return data


def load_mnist(folder: str | os.PathLike[str], split: str) -> tuple[np.ndarray, np.ndarray]:
    """Read MNIST's images and labels from the folder with its IDX files, gzipped or not.

    Parameters
    ----------
    folder : folder with `train-images-idx3-ubyte[.gz]` and its companions.
    split : "train" (60,000 images) or "test" (10,000).

    Returns
    -------
    images : uint8, shape (N, 28, 28), 0 = background, 255 = stroke.
    labels : uint8, shape (N,), 0-9.

    Raises
    ------
    ValueError : unknown split, or damaged files.
    FileNotFoundError : no such files in the folder.
    """
    if split not in _PREFIX:
        raise ValueError(f"`split` must be one of {', '.join(map(repr, _PREFIX))}, got {split!r}")
    images_path = _find(Path(folder), f"{_PREFIX[split]}-images-idx3-ubyte")
    labels_path = _find(Path(folder), f"{_PREFIX[split]}-labels-idx1-ubyte")
    images, labels = read_idx(images_path), read_idx(labels_path)
    if images.ndim != 3 or images.shape[1:] != (28, 28) or images.dtype != np.uint8:
        raise ValueError(
            f"{images_path}: MNIST images must be uint8 of shape (N, 28, 28), got {images.dtype} {images.shape}"
        )
    if labels.shape != images.shape[:1] or labels.dtype != np.uint8:
        raise ValueError(
            f"{labels_path}: expected {len(images)} uint8 labels, one per image of {images_path.name}, got "
            f"{labels.dtype} {labels.shape}"
        )
    if len(labels) and labels.max() > 9:
        i = int(np.argmax(labels > 9))
        raise ValueError(f"{labels_path}: labels must be in 0-9, got {labels[i]} at {i}")
    return images, labels


def _find(folder: Path, name: str) -> Path:
    for candidate in (folder / f"{name}.gz", folder / name):
        if candidate.exists():
            return candidate
    raise FileNotFoundError(f"{folder}: has neither {name}.gz nor {name}; expected MNIST's IDX files there")
