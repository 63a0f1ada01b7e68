"""Calibration: one factor on all logits, so that of the decisions at probability .9, nine of ten
are right.

    p = softmax(z / T)        T minimizes the negative log likelihood on held-out windows

No decision changes, only its probability. The factor goes into the weights of the last layer, so a
calibrated model is like any other.

A few windows that are all right would ask for certainty, T = 0. So one decision more is counted of
each class, whatever is shown (the rule of succession, as in Platt's scaling).

References: Guo, Pleiss, Sun, Weinberger 2017, arXiv:1706.04599; Platt 1999, Probabilistic outputs
for support vector machines.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from async_tnt.networks.layers.graph import CLASSIFIER
from async_tnt.networks.models.model import Model

LEAST, MOST = 0.2, 5.0
"""Beyond them, no temperature makes up for what the network lacks."""
HALVINGS = 60


def fit_temperature(probabilities: np.ndarray, labels: np.ndarray) -> float:
    """The temperature T that gives these windows the smallest loss.

    Parameters
    ----------
    probabilities : float64, shape (N, n_classes): softmax(z).
    labels : int64, shape (N,).

    Examples
    --------
    Six of eight are right at .9; counting one more of each class, seven of ten:

    >>> T = fit_temperature(np.array([[0.9, 0.1]] * 8), np.array([0] * 6 + [1] * 2))
    >>> z = np.log([0.9, 0.1]) / T
    >>> round(float(np.exp(z[0]) / np.exp(z).sum()), 6)
    0.7
    """
    n, n_classes = probabilities.shape
    z = np.log(np.maximum(probabilities, np.finfo(np.float64).tiny))
    of_truth = (n * z[np.arange(n), labels] + z.sum(1)) / (n + n_classes)

    def slope(beta: float) -> float:
        """Of the loss, which is convex in beta = 1 / T: mean of E_p[z] - z_truth."""
        p = np.exp(beta * (z - z.max(1, keepdims=True)))
        return float(((p * z).sum(1) / p.sum(1) - of_truth).mean())

    low, high = np.log(1 / MOST), np.log(1 / LEAST)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if slope(float(np.exp(middle))) > 0 else (middle, high)
    return float(np.exp(-(low + high) / 2))


def softened(probabilities: np.ndarray, temperature: float) -> np.ndarray:
    """softmax(z / T) from softmax(z), along the last axis.

    Examples
    --------
    >>> softened(np.array([0.9, 0.1]), 2.0).round(6)
    array([0.75, 0.25])
    """
    powers: np.ndarray = (probabilities / probabilities.max(-1, keepdims=True)) ** (1 / temperature)
    shares: np.ndarray = powers / powers.sum(-1, keepdims=True)
    return shares


def calibrated(model: Model, temperature: float) -> tuple[Model, float]:
    """The model with its logits divided by `temperature`, and that temperature.

    A network that ends in neither a dense layer nor a convolution, or whose last layer shares its
    weights with another, stays as it is: 1.
    """
    *others, last = model.network[CLASSIFIER]
    shared = {name for layer in others for name in layer.get("weights", {}).values()}
    if last["op"] not in ("dense", "conv") or shared & {*last["weights"].values()}:
        return model, 1.0
    scaled = {
        name: model.weights[name] / np.float32(temperature) for name in last["weights"].values()
    }
    return replace(model, weights={**model.weights, **scaled}), temperature
