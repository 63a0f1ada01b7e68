"""Read MNIST's IDX files of uint8 values, gzipped or not.

    bytes 0-3   0, 0, 8 (uint8), number of dimensions
    then        one big-endian uint32 per dimension, then the values, last dimension fastest

LeCun, Cortes, Burges, The MNIST Database of Handwritten Digits, section "File formats".
"""

from __future__ import annotations

import gzip
import math
import os
import zlib
from pathlib import Path

import numpy as np

_PREFIX = {"train": "train", "test": "t10k"}
"""Split -> how the names of its files begin."""


def load_mnist(folder: str | os.PathLike[str], split: str) -> tuple[np.ndarray, np.ndarray]:
    """MNIST's images and labels.

    Images are uint8 of shape (N, 28, 28), 255 = stroke. Labels are uint8 of shape (N,), 0-9.

    Parameters
    ----------
    folder : has `train-images-idx3-ubyte[.gz]` and its companions.
    split : "train" (60,000 images) or "test" (10,000).

    Raises
    ------
    ValueError : unknown split, or damaged files.
    FileNotFoundError : no such files in the folder.
    """
    if split not in _PREFIX:
        raise ValueError(f"`split` must be one of {', '.join(map(repr, _PREFIX))}, got {split!r}")
    images_path, images = _read(Path(folder), f"{_PREFIX[split]}-images-idx3-ubyte")
    labels_path, labels = _read(Path(folder), f"{_PREFIX[split]}-labels-idx1-ubyte")
    if images.ndim != 3 or images.shape[1:] != (28, 28):
        raise ValueError(
            f"{images_path}: MNIST images must have shape (N, 28, 28), got {images.shape}"
        )
    if labels.shape != images.shape[:1] or labels.max(initial=0) > 9:
        raise ValueError(
            f"{labels_path}: expected {len(images)} labels in 0-9, one per image of "
            f"{images_path.name}"
        )
    return images, labels


def _read(folder: Path, name: str) -> tuple[Path, np.ndarray]:
    """The path of an IDX file, gzipped or not, and the array in it."""
    candidates = (folder / f"{name}.gz", folder / name)
    path = next((path for path in candidates if path.exists()), None)
    if path is None:
        raise FileNotFoundError(
            f"{folder}: has neither {name}.gz nor {name}; expected MNIST's IDX files there"
        )
    raw = path.read_bytes()
    try:
        raw = gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: damaged gzip file: {error}") from error
    if len(raw) < 4 or raw[:3] != b"\0\0\x08" or not 0 < raw[3] <= 3 or len(raw) < 4 + 4 * raw[3]:
        raise ValueError(
            f"{path}: not an IDX file of uint8 values, it begins with "
            f"{raw[:4].hex(' ') or 'nothing'}"
        )
    shape = np.frombuffer(raw, ">u4", raw[3], 4).tolist()
    values = np.frombuffer(raw, np.uint8, offset=4 + 4 * raw[3])
    if len(values) != math.prod(shape):
        raise ValueError(
            f"{path}: damaged IDX file: shape {tuple(shape)} takes {math.prod(shape)} bytes, got "
            f"{len(values)}"
        )
    return path, values.reshape(shape)
