"""The compiled landmark regressor: a model's landmark network as a callable on raw volumes."""

from __future__ import annotations

import numpy as np

from async_tnt.kernels.heatmap import find_landmark
from async_tnt.networks.feature_maps import VolumeInput, framed_maps, n_places, output_maps, pack_filters
from async_tnt.networks.model import HEATMAP, REGRESSOR_LAYERS, Model


class CompiledRegressor:
    """The landmark network of a model, compiled: raw volume (C, H, W) -> landmark (x, y) in grid pixels.

    Three convolutions 3x3 with ReLU and one 1x1 draw a heatmap; the landmark is the centroid of its exponential,
    in float64 (Wang 2019, the landmark regression network). Equal to the torch reference to 1e-4 pixels. For the
    volume alone: `TNTVolume(model.config, regressor=CompiledRegressor(model))`; `Processor(model)` makes its own.
    Holds scratch memory: one instance per thread.

    Raises
    ------
    ValueError : the model has no regressor; (when called) the volume's shape is not the model's.
    """

    def __init__(self, model: Model) -> None:
        config, w = model.config, model.weights
        if not config.needs_regressor:
            raise ValueError(
                'the model has no regressor: that needs landmark="regressor" and transform="tnt", '
                f"got landmark={config.landmark!r}, transform={config.transform!r}"
            )
        self.shape = channels, height, width = config.shape
        packed = [pack_filters(w, layer) for layer in REGRESSOR_LAYERS]
        self._layers = (*packed[0], *packed[1], *packed[2], w[HEATMAP].reshape(-1))
        widths = [len(w[f"{layer}.bias"]) for layer in REGRESSOR_LAYERS]
        self._maps = (
            framed_maps(channels, height, width),
            framed_maps(widths[0], height, width),
            framed_maps(widths[1], height, width),
            output_maps(max(widths), height, width),
            np.zeros(n_places(height, width), np.float32),
        )
        self._input = VolumeInput(self.shape)

    def __call__(self, volume: np.ndarray) -> tuple[float, float]:
        """The landmark of one raw volume, float64; nan where the network's float32 numbers overflow."""
        x, y = find_landmark(self._input(volume), self._layers, self._maps)
        return x, y
