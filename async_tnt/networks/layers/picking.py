"""Convolutions with weights of 0 and 1: some rows and columns of a map, the sum of its channels.

So these need no operations of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def picked(
    channels: int, start: Sequence[int], step: Sequence[int], dropped: Sequence[int] = (0, 0)
) -> tuple[np.ndarray, dict[str, Any]]:
    """The weight and the parameters of the convolution that takes some rows and columns.

    Row i of the result is row start + i step of the map. The kernel reaches over the rows before
    the first and behind the last one, so that as many rows are taken as there are.

    Parameters
    ----------
    start, step : y and x; `start` is from 0 on, `step` from 1 on.
    dropped : how many rows and columns behind the last one are not taken.
    """
    kernel = [start[0] + 1 + dropped[0], start[1] + 1 + dropped[1]]
    weight = np.zeros((channels, 1, *kernel), np.float32)
    weight[:, :, start[0], start[1]] = 1.0
    parameters = {
        "kernel": kernel,
        "stride": list(step),
        "padding": [0, 0, 0, 0],
        "dilation": [1, 1],
        "groups": channels,
    }
    return weight, parameters


def sum_weight(channels: int) -> tuple[np.ndarray, dict[str, Any]]:
    """The weight and the parameters of the convolution that adds all channels at each place."""
    parameters = {
        "kernel": [1, 1],
        "stride": [1, 1],
        "padding": [0, 0, 0, 0],
        "dilation": [1, 1],
        "groups": 1,
    }
    return np.ones((1, channels, 1, 1), np.float32), parameters
