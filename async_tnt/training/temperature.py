"""Calibration of probabilities: all logits z are divided by one number, the temperature T.

After calibration, nine of ten decisions with probability .9 are right.

    p = softmax(z / T)        T minimizes the negative log likelihood on held-out windows

Calibration changes no decision, only its probability. The weights of the last layer are divided by
T, so a calibrated model is like any other model.

If there are only a few windows and all are right, the likelihood is highest at T = 0, which means
certainty. So for each window and each class, the loss also counts an imagined decision with the
same probabilities, in which this class is the truth. All imagined decisions for a class together
weigh as much as one window (the rule of succession, as in Platt's scaling).

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
"""The highest temperature that is tried. A poor network gains nothing from a higher one."""
HALVINGS = 60
"""How often the range of log(1 / T) is halved, down to the precision of float64."""


def fit_temperature(probabilities: np.ndarray, labels: np.ndarray) -> float:
    """The temperature T with the smallest loss on these windows.

    Parameters
    ----------
    probabilities : float64, shape (N, n_classes): softmax(z).
    labels : int64, shape (N,).

    Examples
    --------
    Six of eight decisions with probability .9 are right. With an imagined decision for each of the
    two classes, seven of ten are right:

    >>> T = fit_temperature(np.array([[0.9, 0.1]] * 8), np.array([0] * 6 + [1] * 2))
    >>> z = np.log([0.9, 0.1]) / T
    >>> round(float(np.exp(z[0]) / np.exp(z).sum()), 6)
    0.7
    """
    n, n_classes = probabilities.shape
    z = np.log(np.maximum(probabilities, np.finfo(np.float64).tiny))
    # the logit of the truth, in the mean over the window's decision and the imagined decisions
    z_truth = (n * z[np.arange(n), labels] + z.sum(1)) / (n + n_classes)

    def slope(beta: float) -> float:
        """The slope of the loss in beta = 1 / T: the mean of E_p[z] - z_truth.

        p is softmax(beta z). The loss is convex in beta, so its slope grows with beta.
        """
        weights = np.exp(beta * (z - z.max(1, keepdims=True)))  # p without its denominator
        return float(((weights * z).sum(1) / weights.sum(1) - z_truth).mean())

    # halve the range of log(beta) in which the slope is 0
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
    """The probabilities softmax(z / T) from the probabilities softmax(z), along the last axis.

    Examples
    --------
    >>> softened(np.array([0.9, 0.1]), 2.0).round(6)
    array([0.75, 0.25])
    """
    powers: np.ndarray = (probabilities / probabilities.max(-1, keepdims=True)) ** (1 / temperature)
    shares: np.ndarray = powers / powers.sum(-1, keepdims=True)
    return shares


def calibrated(model: Model, temperature: float) -> tuple[Model, float]:
    """The model with its logits divided by `temperature`, and the temperature that was applied.

    A model stays as it is, with temperature 1, if its last layer is neither dense nor a
    convolution, or if another layer has the same weights.
    """
    *earlier_layers, last = model.network[CLASSIFIER]
    earlier_names = {name for layer in earlier_layers for name in layer.get("weights", {}).values()}
    if last["op"] not in ("dense", "conv"):
        return model, 1.0
    if earlier_names & {*last["weights"].values()}:
        return model, 1.0
    scaled = {
        name: model.weights[name] / np.float32(temperature) for name in last["weights"].values()
    }
    # statistics would be of other logits
    return replace(model, weights={**model.weights, **scaled}, statistics=None), temperature
