"""NIR graphs of networks of ReLUs, computed by torch node by node."""

from __future__ import annotations

import nir
import numpy as np
import torch
from torch.nn import functional


def outputs_of(graph: nir.NIRGraph, volume: np.ndarray) -> np.ndarray:
    """What the graph's output is for a volume, in float64."""
    values = {}
    sources = {name: [a for a, b in graph.edges if b == name] for name in graph.nodes}
    waiting = dict(graph.nodes)
    while waiting:
        for name, node in list(waiting.items()):
            if not all(source in values for source in sources[name]):
                continue
            del waiting[name]
            if isinstance(node, nir.Input):
                values[name] = torch.tensor(volume, dtype=torch.float64)
            else:
                values[name] = _value(node, sum(values[source] for source in sources[name]))
    (output,) = [name for name, node in graph.nodes.items() if isinstance(node, nir.Output)]
    return values[output].numpy()


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.tensor(np.asarray(values), dtype=torch.float64)


def _value(node: nir.NIRNode, source: torch.Tensor) -> torch.Tensor:
    if isinstance(node, nir.Output):
        return source
    if isinstance(node, nir.IF):
        assert (node.r == 1).all()
        assert (node.v_threshold == 1).all()
        return functional.relu(source)
    if isinstance(node, nir.Flatten):
        return source.flatten()
    if isinstance(node, nir.Affine):
        return _tensor(node.weight) @ source + _tensor(node.bias)
    if isinstance(node, nir.Linear):
        return _tensor(node.weight) @ source
    if isinstance(node, nir.Conv2d):
        how = (node.stride, node.padding, node.dilation, node.groups)
        weights = (_tensor(node.weight), _tensor(node.bias))
        return functional.conv2d(source[None], *weights, *how)[0]
    sides = [tuple(getattr(node, name)) for name in ("kernel_size", "stride", "padding")]
    pooled = functional.avg_pool2d(source[None], *sides)[0]
    if isinstance(node, nir.SumPool2d):
        return pooled * np.prod(sides[0])
    assert isinstance(node, nir.AvgPool2d)
    return pooled
