"""NIR graphs whose nodes stand in a row, as stages of torch modules and neurons.

They are read by the library `nir`, and not by the reader of `async_tnt`, so that a mistake of its
reader shows in a comparison.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import torch
from torch import nn

SENSOR = (34, 34)
"""Width and height of N-MNIST's sensor in pixels."""

Kind = Literal["IF", "LIF"]
"""A type of neurons in NIR: they integrate, or leak as well."""


@dataclass(frozen=True)
class Stage:
    """Neurons, and the linear layers before them.

    Parameters
    ----------
    name : name of the node of neurons.
    linear : the layers before the neurons, without biases.
    neurons : the node, a `nir.IF` or `nir.LIF`.
    """

    name: str
    linear: nn.Sequential
    neurons: Any


def stages_of(graph: Any, dtype: torch.dtype) -> list[Stage]:
    """The stages of a `nir.NIRGraph` whose nodes stand in a row.

    Raises
    ------
    ValueError : a node that has several successors, or a bias.
    NotImplementedError : a node of another type.
    """
    stages = []
    linear: list[nn.Module] = []
    for name, node in _in_a_row(graph):
        kind = type(node).__name__
        if kind in ("IF", "LIF"):
            stages.append(Stage(name, nn.Sequential(*linear).to(dtype), node))
            linear = []
        elif kind not in ("Input", "Output"):
            linear.append(_module(node, kind))
    return stages


def _in_a_row(graph: Any) -> list[tuple[str, Any]]:
    """Name and node of each node, from the input on."""
    next_of = dict(graph.edges)
    if len(next_of) != len(graph.edges):
        raise ValueError("a node of the graph has several successors")
    (name,) = (name for name in graph.nodes if name not in next_of.values())
    row = [(name, graph.nodes[name])]
    while name in next_of:
        name = next_of[name]
        row.append((name, graph.nodes[name]))
    return row


def _module(node: Any, kind: str) -> nn.Module:
    """The torch module of a linear node."""
    if np.any(getattr(node, "bias", 0)):
        raise ValueError("a node has a bias, which has no meaning at an event")
    if kind == "Flatten":
        return nn.Flatten()
    if kind == "SumPool2d":
        size = _pair(node.kernel_size)
        return nn.AvgPool2d(size, _pair(node.stride), _pair(node.padding), divisor_override=1)
    if kind not in ("Conv2d", "Affine", "Linear"):
        raise NotImplementedError(f"no torch module for a node of type {kind}")
    weight = torch.from_numpy(np.array(node.weight, np.float64))
    n_outputs, n_inputs = weight.shape[:2]
    if kind != "Conv2d":
        module: nn.Module = nn.Linear(n_inputs, n_outputs, bias=False)
    else:
        groups = int(node.groups)
        module = nn.Conv2d(
            n_inputs * groups,
            n_outputs,
            (weight.shape[2], weight.shape[3]),
            _pair(node.stride),
            _pair(node.padding),
            _pair(node.dilation),
            groups,
            bias=False,
        )
    module.weight = nn.Parameter(weight, requires_grad=False)
    return module


def _pair(value: Any) -> tuple[int, int]:
    """A number of NIR for rows and columns, which may be one for both."""
    rows, columns = np.broadcast_to(np.asarray(value).reshape(-1), (2,))
    return int(rows), int(columns)


# -- graphs with random weights --------------------------------------------------------------------


def random_paper_graph(rng: np.random.Generator) -> Any:
    """A graph with the layers of the NIR paper's network for N-MNIST, and random weights."""
    import nir

    def normal(*shape: int) -> np.ndarray:
        fan_in = int(np.prod(shape[1:]))
        return rng.normal(0.3 / np.sqrt(fan_in), 1 / np.sqrt(fan_in), shape).astype(np.float32)

    def neurons(*shape: int) -> Any:
        ones = np.ones(shape, np.float32)
        return nir.IF(r=ones, v_threshold=ones)

    return _row(
        nir.Conv2d(SENSOR, normal(16, 2, 5, 5), 2, 1, 1, 1, np.zeros(16)),
        neurons(16, 16, 16),
        nir.Conv2d((16, 16), normal(16, 16, 3, 3), 1, 1, 1, 1, np.zeros(16)),
        neurons(16, 16, 16),
        _sum_pool(),
        nir.Conv2d((8, 8), normal(8, 16, 3, 3), 1, 1, 1, 1, np.zeros(8)),
        neurons(8, 8, 8),
        _sum_pool(),
        _flatten((8, 4, 4)),
        nir.Linear(normal(256, 128)),
        neurons(256),
        nir.Linear(normal(10, 256)),
        neurons(10),
    )


def random_small_graph(kind: Kind, step_s: float, rng: np.random.Generator) -> Any:
    """A graph of two convolutions and a dense layer, with random weights, thresholds and times.

    What arrives at a neuron in one step is below its threshold, as simulators with at most one
    spike in a step need it.

    Parameters
    ----------
    step_s : time step in seconds. A neuron that leaks has a time constant of 200 to 2,000 steps.
    """
    import nir

    def weights(n_inputs: int, most_spikes: int, *shape: int) -> np.ndarray:
        """Weights with which at most 0.7 arrive at a neuron in one step.

        n_inputs, most_spikes : how many inputs of a neuron have spikes in one step, and how many
            spikes each has, at most.
        """
        drawn = rng.uniform(-0.5, 1.0, shape)
        by_neuron = np.sort(np.maximum(drawn, 0).reshape(len(drawn), -1), axis=1)
        most = most_spikes * by_neuron[:, -n_inputs:].sum(axis=1).max()
        return (0.7 / most * drawn).astype(np.float32)

    def neurons(*shape: int) -> Any:
        threshold = rng.uniform(0.8, 1.2, shape).astype(np.float32)
        if kind == "IF":
            reset = rng.uniform(-0.3, 0.1, shape).astype(np.float32)
            return nir.IF(np.ones(shape, np.float32), threshold, reset)
        tau = (step_s * rng.uniform(200, 2_000, shape)).astype(np.float32)
        zeros = np.zeros(shape, np.float32)
        # r dt / tau = 1: what arrives counts once
        return nir.LIF(tau, (tau / step_s).astype(np.float32), zeros, threshold, zeros)

    return _row(
        nir.Conv2d(SENSOR, weights(1, 1, 6, 2, 5, 5), 2, 1, 1, 1, np.zeros(6)),
        neurons(6, 16, 16),
        _sum_pool(),
        nir.Conv2d((8, 8), weights(54, 4, 8, 6, 3, 3), 1, 1, 1, 1, np.zeros(8)),
        neurons(8, 8, 8),
        _flatten((8, 8, 8)),
        # an event makes few of the 512 neurons fire
        nir.Linear(weights(32, 1, 10, 512)),
        neurons(10),
    )


def _sum_pool() -> Any:
    import nir

    two = np.array([2, 2])
    return nir.SumPool2d(two, two, np.array([0, 0]))


def _flatten(shape: tuple[int, int, int]) -> Any:
    import nir

    return nir.Flatten({"input": np.array(shape)}, 0, -1)


def _row(*nodes: Any) -> Any:
    """The graph of nodes that stand in a row, between an input of a sensor's size and an output."""
    import nir

    first = nir.Input({"input": np.array([2, *SENSOR[::-1]])})
    last = nir.Output({"output": np.array([10])})
    named = {"input": first, **{str(k): node for k, node in enumerate(nodes)}, "output": last}
    names = list(named)
    return nir.NIRGraph(named, list(pairwise(names)))
