"""The network in training, the scale of its input, and its way into a model file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from tnt_reference import Classifier

from async_tnt.config import TNTConfig
from async_tnt.model import Model

from .batches import BatchVolumes
from .windows import Windows

FLOOR = 1e-3  # of the largest channel scale: bins that are nearly always empty are not blown up


def new_network(config: TNTConfig, n_classes: int, seed: int) -> Classifier:
    """The thesis' classifier with PyTorch's initial weights, a function of the seed alone.

    Torch's own generator is left as it was.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Classifier(config.channels, config.grid, n_classes)


def channel_scale(config: TNTConfig, windows: Windows, n: int = 512) -> np.ndarray:
    """1 / root mean square of each channel, over `n` windows spread evenly: float32, shape (C,).

    Cells are mostly zero and late TNT bins, where all events crowd in the middle, are far larger than early
    ones. A fixed factor per channel evens that out and is no part of the finished network: see `export`.
    """
    some = windows[np.unique(np.linspace(0, len(windows) - 1, min(n, len(windows))).astype(np.int64))]
    volumes = BatchVolumes(config)(some)
    mean_square = np.square(volumes, dtype=np.float64).mean(axis=(0, 2, 3))
    mean_square = np.maximum(mean_square, FLOOR * mean_square.max())
    return (1.0 / np.sqrt(np.maximum(mean_square, 1e-12))).astype(np.float32)


def export(
    network: Classifier,
    scale: np.ndarray,
    config: TNTConfig,
    classes: tuple[str, ...],
    record: Mapping[str, Any],
) -> Model:
    """The finished model: the first convolution absorbs the input's scale, so that it takes raw volumes.

    conv1(scale * V) = sum_c w_c * (scale_c V_c) = sum_c (scale_c w_c) * V_c
    """
    weights = {name: w.detach().cpu().numpy().copy() for name, w in network.state_dict().items()}
    weights["conv1.weight"] *= scale[None, :, None, None]
    return Model(config, weights, classes, record)


def network_before_export(model: Model, scale: np.ndarray) -> Classifier:
    """The inverse of `export`: a model's network for volumes that are multiplied by `scale`, to train it on."""
    network = network_of(model)
    with torch.no_grad():
        network.conv1.weight /= torch.from_numpy(scale)[None, :, None, None]
    return network


def network_of(model: Model) -> Classifier:
    """A model's network in torch. It takes raw volumes."""
    f1, f2, f3 = (len(model.weights[f"{layer}.bias"]) for layer in ("conv1", "conv2", "fc1"))
    network = Classifier(model.config.channels, model.config.grid, len(model.classes), (f1, f2, f3))
    network.load_state_dict({name: torch.from_numpy(w.copy()) for name, w in model.weights.items()})
    return network.eval()
