"""Calibration: one factor on all logits.

After it, nine of ten decisions with probability .9 are right.

    p = softmax(z / T)        T minimizes the negative log likelihood on held-out windows

No decision changes, only its probability. The factor goes into the weights of the last layer, so a
calibrated model is like any other.

If all of a few windows are right, the best T is 0: certainty. So the loss counts one decision more
for each class, whatever is shown (the rule of succession, as in Platt's scaling).

References: Guo, Pleiss, Sun, Weinberger 2017, arXiv:1706.04599; Platt 1999, Probabilistic outputs
for support vector machines.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from async_tnt.networks.layers.graph import CLASSIFIER
from async_tnt.networks.models.model import Model

LEAST = 0.2
"""The lowest temperature that is tried."""
MOST = 5.0
"""The highest temperature that is tried. Beyond, none makes up for what the network lacks."""
HALVINGS = 60
"""Halvings of the range of the logarithm of 1 / T, down to the precision of float64."""


def fit_temperature(probabilities: np.ndarray, labels: np.ndarray) -> float:
    """The temperature T that gives these windows the smallest loss.

    Parameters
    ----------
    probabilities : float64, shape (N, n_classes): softmax(z).
    labels : int64, shape (N,).

    Examples
    --------
    Six of eight decisions at .9 are right. With one more for each class, seven of ten are:

    >>> T = fit_temperature(np.array([[0.9, 0.1]] * 8), np.array([0] * 6 + [1] * 2))
    >>> z = np.log([0.9, 0.1]) / T
    >>> round(float(np.exp(z[0]) / np.exp(z).sum()), 6)
    0.7
    """
    n, n_classes = probabilities.shape
    z = np.log(np.maximum(probabilities, np.finfo(np.float64).tiny))
    of_truth = (n * z[np.arange(n), labels] + z.sum(1)) / (n + n_classes)

    def slope(beta: float) -> float:
        """The slope of the loss in beta = 1 / T: the mean of E_p[z] - z_truth.

        The loss is convex in beta.
        """
        p = np.exp(beta * (z - z.max(1, keepdims=True)))
        return float(((p * z).sum(1) / p.sum(1) - of_truth).mean())

    low = np.log(1 / MOST)
    high = np.log(1 / LEAST)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        if slope(float(np.exp(middle))) > 0:
            high = middle
        else:
            low = middle
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
    """The model with its logits divided by `temperature`, and the temperature that it has now.

    A network stays as it is, with temperature 1, if it ends in neither a dense layer nor a
    convolution, or if its last layer shares its weights with another.
    """
    *others, last = model.network[CLASSIFIER]
    shared = {name for layer in others for name in layer.get("weights", {}).values()}
    if last["op"] not in ("dense", "conv") or shared & {*last["weights"].values()}:
        return model, 1.0
    scaled = {
        name: model.weights[name] / np.float32(temperature) for name in last["weights"].values()
    }
    return replace(model, weights={**model.weights, **scaled}), temperature
