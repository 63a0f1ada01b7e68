"""Small random NIR graphs that the package reads."""

from __future__ import annotations

from typing import Any

import nir
import numpy as np

MAP_NODES = (
    "Conv2d",
    "SumPool2d",
    "AvgPool2d",
    "Scale",
    "IF",
    "LIF",
    "CubaLIF",
    "Threshold",
    "add",
)

LINE_NODES = ("Conv1d", "Scale", "IF", "LIF", "CubaLIF", "Threshold", "add")


class RandomGraph:
    """A graph that grows node by node.

    Attributes
    ----------
    graph : the `nir.NIRGraph`.
    meaning : the other arguments of `Model.from_nir`.
    """

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._nodes: dict[str, Any] = {}
        self._edges: list[tuple[str, str]] = []
        self._reset = str(self._rng.choice(["subtract", "value"]))
        rng = self._rng
        n_axes = int(rng.choice([1, 2, 3, 3]))
        sides = rng.integers(2, 9, max(n_axes - 1, 1)).tolist()
        self._shape = tuple(sides) if n_axes == 1 else (int(rng.integers(1, 3)), *sides)
        self._name = self._add("input", nir.Input(np.array(self._shape)), None)
        nodes = {1: ("Scale", "IF", "LIF"), 2: LINE_NODES, 3: MAP_NODES}[n_axes]
        for _ in range(rng.integers(0, 4)):
            self._add_node(str(rng.choice(nodes)))
        if rng.integers(2):
            self._add_dense(flat=n_axes == 1)
        self._add_neurons(str(rng.choice(["IF", "LIF", "CubaLIF", "LI", "CubaLI"])))
        self._add("output", nir.Output(np.array(self._shape)), self._name)
        self.graph = nir.NIRGraph(self._nodes, self._edges, type_check=False)
        self.meaning = {
            "reset": self._reset,
            "dt": float(rng.choice([1e-4, 1e-3])),
            "polarity": str(rng.choice(["off_first", "on_first"])),
        }

    def _add(self, name: str, node: Any, source: str | None) -> str:
        if name in self._nodes:
            name = f"{name}_{len(self._nodes)}"
        self._nodes[name] = node
        if source is not None:
            self._edges.append((source, name))
        return name

    def _floats(self, *shape: int) -> np.ndarray:
        return self._rng.normal(size=shape).astype(np.float32)

    def _positive(self, *shape: int) -> np.ndarray:
        return self._rng.uniform(0.1, 2.0, shape).astype(np.float32)

    def _add_node(self, kind: str) -> None:
        """Add a node that reads and computes numbers of as many axes as the input has."""
        if kind in ("Conv1d", "Conv2d"):
            self._add_conv()
        elif kind in ("SumPool2d", "AvgPool2d"):
            self._add_pool(kind)
        elif kind == "Scale":
            self._name = self._add("scale", nir.Scale(self._floats(*self._shape)), self._name)
        elif kind == "add":
            self._add_branches()
        else:
            self._add_neurons(kind)

    def _add_conv(self) -> None:
        rng = self._rng
        channels, *before = self._shape
        groups = int(rng.choice([1, channels]))
        n_filters = groups * int(rng.integers(1, 3))
        kernel = [int(rng.integers(1, min(4, side + 1))) for side in before]
        weight = self._floats(n_filters, channels // groups, *kernel)
        stride = rng.integers(1, 3, len(before)).tolist()
        padding: Any = rng.integers(0, 2, len(before)).tolist()
        dilation = 1
        sides = [
            (side + 2 * pad - k) // step + 1
            for side, pad, k, step in zip(before, padding, kernel, stride, strict=True)
        ]
        how = rng.integers(4)
        if how == 0:
            padding = "same"
            stride = [1] * len(before)
            dilation = 2
            sides = before
        elif how == 1:
            padding = "valid"
            stride = [1] * len(before)
            sides = [side - k + 1 for side, k in zip(before, kernel, strict=True)]
        bias = np.zeros(n_filters, np.float32)
        if len(before) == 1:
            along = padding if isinstance(padding, str) else padding[0]
            node = nir.Conv1d(before[0], weight, stride[0], along, dilation, groups, bias)
        else:
            both = padding if isinstance(padding, str) else tuple(padding)
            node = nir.Conv2d(tuple(before), weight, tuple(stride), both, dilation, groups, bias)
        self._name = self._add("conv", node, self._name)
        self._shape = (n_filters, *sides)

    def _add_pool(self, kind: str) -> None:
        channels, *sides = self._shape
        kernel = [int(self._rng.integers(1, min(3, side) + 1)) for side in sides]
        stride = self._rng.integers(1, 3, 2)
        node = getattr(nir, kind)(np.array(kernel), stride, np.zeros(2, int))
        self._name = self._add("pool", node, self._name)
        sides = [(side - k) // int(s) + 1 for side, k, s in zip(sides, kernel, stride, strict=True)]
        self._shape = (channels, *sides)

    def _add_branches(self) -> None:
        """Two nodes read this value, and the next node reads both."""
        ends = [
            self._add("branch", nir.Scale(self._floats(*self._shape)), self._name) for _ in range(2)
        ]
        neurons = nir.IF(self._positive(*self._shape), self._positive(*self._shape))
        self._name = self._add("both", neurons, ends[0])
        self._edges.append((ends[1], self._name))

    def _add_neurons(self, kind: str) -> None:
        # one number for each channel, or for each place
        n_axes = int(self._rng.choice([1, len(self._shape)]))
        shape = self._shape[:n_axes]
        gain = self._floats(*shape)
        threshold = self._positive(*shape)
        if kind == "IF":
            node = nir.IF(gain, threshold, self._reset_to(shape))
        elif kind == "LIF":
            tau = self._positive(*shape)
            leak = -self._positive(*shape)
            node = nir.LIF(tau, gain, leak, threshold, self._reset_to(shape))
        elif kind == "CubaLIF":
            taus = self._positive(*shape), self._positive(*shape)
            reset_to = self._reset_to(shape)
            leak = -self._positive(*shape)
            node = nir.CubaLIF(*taus, gain, leak, threshold, reset_to, self._floats(*shape))
        elif kind == "CubaLI":
            taus = self._positive(*shape), self._positive(*shape)
            node = nir.CubaLI(*taus, gain, self._floats(*shape), self._floats(*shape))
        elif kind == "Threshold":
            node = nir.Threshold(threshold)
        else:
            node = nir.LI(self._positive(*shape), gain, self._floats(*shape))
        self._name = self._add(kind.lower(), node, self._name)

    def _reset_to(self, shape: tuple[int, ...]) -> np.ndarray | None:
        if self._reset == "subtract":
            return None
        return -self._positive(*shape)

    def _add_dense(self, flat: bool) -> None:
        """Add a dense layer. Unless the numbers are `flat`, they are flattened before."""
        shape = np.array(self._shape)
        if not flat:
            self._name = self._add("flatten", nir.Flatten({"input": shape}, 0, -1), self._name)
        weight = self._floats(int(self._rng.integers(1, 5)), int(shape.prod()))
        bias = np.zeros(len(weight), np.float32)
        node = nir.Affine(weight, bias) if self._rng.integers(2) else nir.Linear(weight)
        self._name = self._add("fc", node, self._name)
        self._shape = (len(weight),)
