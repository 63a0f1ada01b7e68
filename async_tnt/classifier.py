"""The compiled classifier: a model's network as a callable on volumes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .kernels.network import forward
from .maps import VolumeInput, framed_maps, output_maps, pack_filters
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
        conv1, conv2 = pack_filters(w, "conv1"), pack_filters(w, "conv2")
        self._layers = (*conv1, *conv2, *_transpose(w, "fc1"), *_transpose(w, "fc2"))
        f1, f2 = len(w["conv1.bias"]), len(w["conv2.bias"])
        half_h, half_w = height // 2, width // 2
        self._maps = (
            framed_maps(channels, height, width),
            output_maps(f1, height, width),
            framed_maps(f1, half_h, half_w),
            output_maps(f2, half_h, half_w),
            np.zeros((f2, (half_h // 2) * (half_w // 2)), np.float32),
            np.zeros(len(w["fc1.bias"]), np.float32),
            np.zeros(len(w["fc1.weight"].T) + len(w["fc1.bias"]), np.int64),
        )
        self._input = VolumeInput(self.shape)
        self.n_classes = len(w["fc2.bias"])

    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """Logits of one volume: float32, shape (n_classes,), a new array."""
        logits = np.empty(self.n_classes, np.float32)
        forward(self._input(volume), self._layers, self._maps, logits)
        return logits


def _transpose(weights: Mapping[str, np.ndarray], layer: str) -> tuple[np.ndarray, np.ndarray]:
    return np.ascontiguousarray(weights[f"{layer}.weight"].T), np.ascontiguousarray(weights[f"{layer}.bias"])
