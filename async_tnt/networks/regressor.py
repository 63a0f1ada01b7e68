"""The compiled landmark regressor: a model's landmark network as a callable on raw volumes."""

from __future__ import annotations

import numpy as np

from async_tnt.kernels.heatmap import find_landmark
from async_tnt.networks.layout import VolumeInput, regressor_arrays
from async_tnt.networks.model import Model


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
        config = model.config
        if not config.needs_regressor:
            raise ValueError(
                'the model has no regressor: that needs landmark="regressor" and transform="tnt", '
                f"got landmark={config.landmark!r}, transform={config.transform!r}"
            )
        self.shape = config.shape
        self._layers, self._maps = regressor_arrays(model)
        self._input = VolumeInput(self.shape)

    def __call__(self, volume: np.ndarray) -> tuple[float, float]:
        """The landmark of one raw volume, float64; nan where the network's float32 numbers overflow."""
        x, y = find_landmark(self._input(volume), self._layers, self._maps)
        return x, y
