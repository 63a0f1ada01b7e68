"""The landmark network's weights and feature maps, laid out as the kernels read them (see `kernels.convolve`)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from async_tnt.checks import plain_array
from async_tnt.kernels.conv_rows import FILTERS, PLACES, TAPS


def pack_filters(weights: Mapping[str, np.ndarray], layer: str) -> tuple[np.ndarray, np.ndarray]:
    """(F, C, 3, 3) -> (blocks, C, 9, 8), filled up with zero filters to a multiple of eight; and the biases."""
    filters, bias = weights[f"{layer}.weight"], weights[f"{layer}.bias"]
    n_blocks = -(-len(filters) // FILTERS)
    packed = np.zeros((n_blocks * FILTERS, filters.shape[1], TAPS), np.float32)
    packed[: len(filters)] = filters.reshape(*filters.shape[:2], TAPS)
    packed_bias = np.zeros((n_blocks, FILTERS), np.float32)
    packed_bias.flat[: len(bias)] = bias
    blocks = packed.reshape(n_blocks, FILTERS, -1, TAPS).transpose(0, 2, 3, 1)
    return np.ascontiguousarray(blocks), packed_bias


def framed_maps(channels: int, height: int, width: int) -> np.ndarray:
    """Maps with a frame of zeros, and what the last strip reads beyond them."""
    return np.zeros((channels, n_places(height, width) + 2 * (width + 2) + 2), np.float32)


def output_maps(n_filters: int, height: int, width: int) -> np.ndarray:
    """Room for what a convolution with so many filters writes: whole blocks of filters."""
    return np.zeros((-(-n_filters // FILTERS) * FILTERS, n_places(height, width)), np.float32)


def n_places(height: int, width: int) -> int:
    """Places of a map's rows with their frame, filled up to whole strips."""
    return -(-height * (width + 2) // PLACES) * PLACES


class VolumeInput:
    """Hands volumes to a kernel in one form, that of `TNTVolume.array`, so that it is compiled only once."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.shape = shape
        self._copy = np.zeros(shape, np.float32)

    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """float32, contiguous, read-only: the volume itself where it is so, else a copy, valid until the next call.

        Raises
        ------
        ValueError : another shape.
        """
        volume = plain_array("volume", volume)
        if volume.shape != self.shape:
            raise ValueError(f"`volume` must have shape {self.shape}, got {volume.shape}")
        if volume.dtype == np.float32 and volume.flags.c_contiguous and not volume.flags.writeable:
            return volume
        np.copyto(self._copy, volume)
        view = self._copy.view()
        view.flags.writeable = False
        return view
