"""The compiled classifier: a model's network as a callable on volumes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .kernels.network import forward
from .kernels.strip import FILTERS, PLACES, TAPS
from .model import Model


class CompiledClassifier:
    """The network of a model, compiled: volume (C, H, W) -> logits (n_classes,).

    conv 3x3, ReLU, 2x2 average pool, twice; then two dense layers with a ReLU between (Wang 2019, section on
    the classifier). Equal to the torch reference to 1e-4. Holds scratch memory: one instance per thread.

    Raises
    ------
    ValueError : (when called) the volume's shape is not the model's.
    """

    def __init__(self, model: Model) -> None:
        self.shape = channels, height, width = model.config.shape
        w = model.weights
        conv1, conv2 = _pack_filters(w, "conv1"), _pack_filters(w, "conv2")
        self._layers = (*conv1, *conv2, *_transpose(w, "fc1"), *_transpose(w, "fc2"))
        f1, f2 = len(w["conv1.bias"]), len(w["conv2.bias"])
        half_h, half_w = height // 2, width // 2
        self._maps = (
            _framed(channels, height, width),
            np.zeros((conv1[1].size, _strips(height, width)), np.float32),
            _framed(f1, half_h, half_w),
            np.zeros((conv2[1].size, _strips(half_h, half_w)), np.float32),
            np.zeros((f2, (half_h // 2) * (half_w // 2)), np.float32),
            np.zeros(len(w["fc1.bias"]), np.float32),
            np.zeros(len(w["fc1.weight"].T) + len(w["fc1.bias"]), np.int64),
        )
        self._volume = np.zeros(self.shape, np.float32)
        self.n_classes = len(w["fc2.bias"])

    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """Logits of one volume: float32, shape (n_classes,), a new array."""
        if volume.shape != self.shape:
            raise ValueError(f"`volume` must have shape {self.shape}, got {volume.shape}")
        if not (volume.dtype == np.float32 and volume.flags.c_contiguous and not volume.flags.writeable):
            np.copyto(self._volume, volume)
            volume = self._volume.view()
            volume.flags.writeable = False  # as `TNTVolume.array` is: one compiled version
        logits = np.empty(self.n_classes, np.float32)
        forward(volume, self._layers, self._maps, logits)
        return logits


def _pack_filters(weights: Mapping[str, np.ndarray], layer: str) -> tuple[np.ndarray, np.ndarray]:
    """(F, C, 3, 3) -> (blocks, C, 9, 8), filled up with zero filters to a multiple of eight."""
    filters, bias = weights[f"{layer}.weight"], weights[f"{layer}.bias"]
    n_blocks = -(-len(filters) // FILTERS)
    packed = np.zeros((n_blocks * FILTERS, filters.shape[1], TAPS), np.float32)
    packed[: len(filters)] = filters.reshape(*filters.shape[:2], TAPS)
    packed_bias = np.zeros((n_blocks, FILTERS), np.float32)
    packed_bias.flat[: len(bias)] = bias
    blocks = packed.reshape(n_blocks, FILTERS, -1, TAPS).transpose(0, 2, 3, 1)
    return np.ascontiguousarray(blocks), packed_bias


def _transpose(weights: Mapping[str, np.ndarray], layer: str) -> tuple[np.ndarray, np.ndarray]:
    return np.ascontiguousarray(weights[f"{layer}.weight"].T), np.ascontiguousarray(weights[f"{layer}.bias"])


def _framed(channels: int, height: int, width: int) -> np.ndarray:
    """Maps with a frame of zeros, and what the last strip reads beyond them."""
    return np.zeros((channels, _strips(height, width) + 2 * (width + 2) + 2), np.float32)


def _strips(height: int, width: int) -> int:
    """Places of a map's rows with their frame, filled up to whole strips."""
    return -(-height * (width + 2) // PLACES) * PLACES
