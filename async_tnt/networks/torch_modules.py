"""A model's networks as the torch modules of the reference: for training, the engine `torch` and comparisons.

torch and `tnt_reference` are imported only when something is asked.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from async_tnt.networks.model import Model

if TYPE_CHECKING:
    import tnt_reference
    import torch

REGRESSOR = "regressor."


def torch_classifier(model: Model) -> tnt_reference.Classifier:
    """A model's classifier: volumes (N, C, H, W) -> logits (N, n_classes), in eval mode."""
    from tnt_reference import Classifier

    f1, f2, f3 = (len(model.weights[f"{layer}.bias"]) for layer in ("conv1", "conv2", "fc1"))
    network = Classifier(model.config.channels, model.config.grid, len(model.classes), (f1, f2, f3))
    network.load_state_dict(_tensors(model, ""))
    return network.eval()


def torch_regressor(model: Model) -> tnt_reference.LandmarkRegressor | None:
    """A model's landmark network: raw volumes (N, C, H, W) -> (N, 2) in grid pixels, in eval mode; None without one."""
    if not model.config.needs_regressor:
        return None
    from tnt_reference import LandmarkRegressor
    from torch import nn

    weights = _tensors(model, REGRESSOR)
    network = LandmarkRegressor(model.config.channels, model.config.grid)
    for layer in ("conv1", "conv2", "conv3", "heatmap"):  # of the model's widths, which need not be equal
        n_filters, channels, side, _ = weights[f"{layer}.weight"].shape
        convolution = nn.Conv2d(channels, n_filters, side, padding="same", bias=f"{layer}.bias" in weights)
        setattr(network, layer, convolution)
    network.load_state_dict(weights)
    return network.eval()


def landmark_function(model: Model) -> Callable[[np.ndarray], tuple[float, float]]:
    """`torch_regressor` as a function of one raw volume (C, H, W): the landmark (x, y) in grid pixels."""
    import torch

    network = torch_regressor(model)
    assert network is not None

    def landmark(raw_volume: np.ndarray) -> tuple[float, float]:
        with torch.inference_mode():
            x, y = network(torch.tensor(raw_volume)).tolist()
        return x, y

    return landmark


def _tensors(model: Model, prefix: str) -> dict[str, torch.Tensor]:
    """Copies of the weights of one of the model's networks."""
    import torch

    return {
        name.removeprefix(prefix): torch.tensor(w)
        for name, w in model.weights.items()
        if name.startswith(REGRESSOR) == bool(prefix)
    }
