"""Which windows of a test a network had right: an array, and its text for JSON.

The array is int8, shape (motions, digits): 1 is right, 0 is wrong, and -1 means that the digit has
no window in the motion. A digit is a recording of N-MNIST or an image that was simulated.
"""

from __future__ import annotations

import base64
from typing import Any

import numpy as np


def packed(right: np.ndarray) -> dict[str, Any]:
    """An array as JSON can hold it: its shape, and its bits in base64, row by row.

    The bits "right" are 1 for windows that are right. If digits have no window in a motion, the
    bits "windows" are 1 for those that have.
    """
    text = {"shape": list(right.shape), "right": _text(right == 1)}
    if (right < 0).any():
        text["windows"] = _text(right >= 0)
    return text


def unpacked(text: dict[str, Any]) -> np.ndarray:
    """The array that `packed` has made into text."""
    shape = tuple(text["shape"])
    right = _bits(text["right"], shape).astype(np.int8)
    if "windows" in text:
        right[~_bits(text["windows"], shape)] = -1
    return right


def _text(bits: np.ndarray) -> str:
    return base64.b64encode(np.packbits(bits).tobytes()).decode("ascii")


def _bits(text: str, shape: tuple[int, ...]) -> np.ndarray:
    packed_bits = np.frombuffer(base64.b64decode(text), np.uint8)
    bits: np.ndarray = np.unpackbits(packed_bits, count=int(np.prod(shape))).astype(bool)
    return bits.reshape(shape)
