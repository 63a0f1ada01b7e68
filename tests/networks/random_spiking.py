"""Spiking networks that are made at random: neurons of all kinds, and what lies between them."""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt import Model, TNTConfig
from async_tnt.networks.layers.graph import VOLUME, layer_shapes
from async_tnt.networks.spiking.operations import SPIKING_OPERATIONS
from async_tnt.networks.spiking.outputs import outputs_of

CONFIG = TNTConfig(sensor=(9, 8), grid=(9, 8), representation="count", window_us=1000)

KERNELS = [(1, 1), (2, 2), (3, 3), (3, 3), (5, 4), (1, 3)]

N_CLASSES = 3


class _Builder:
    """The layers so far, and their weights."""

    def __init__(self, config: TNTConfig, seed: int, ops: tuple[str, ...]) -> None:
        self.config = config
        self.random = np.random.default_rng(seed)
        self.ops = ops
        self.layers: list[dict[str, Any]] = []
        self.weights: dict[str, np.ndarray] = {}
        self.last = VOLUME

    def chance(self, share: float = 0.5) -> bool:
        return bool(self.random.random() < share)

    def pick(self, choices):
        return choices[self.random.integers(len(choices))]

    def shape(self, name: str) -> tuple[int, ...]:
        shapes = {name: w.shape for name, w in self.weights.items()}
        found = layer_shapes(self.layers, self.config.shape, shapes, (), SPIKING_OPERATIONS)
        return found[name]

    def add(self, op: str, inputs: list[str] | None = None, tensors=None, **fields) -> str:
        name = f"{op} {len(self.layers)}"
        layer: dict[str, Any] = {"op": op, "name": name, "inputs": inputs or [self.last], **fields}
        if tensors:
            layer["weights"] = {role: f"{name} {role}" for role in tensors}
            for role, values in tensors.items():
                self.weights[f"{name} {role}"] = values.astype(np.float32)
        self.layers.append(layer)
        self.last = name
        return name

    def synapses(self, *shape: int) -> np.ndarray:
        """Weights, of which a fifth are zero. Some lie on a coarse grid, so that sums meet."""
        values = self.random.uniform(-0.6, 1.0, shape)
        if self.chance(0.3):
            values = np.round(4 * values) / 4
        values[self.random.random(shape) < 0.2] = 0.0
        return values

    def neurons(self, op: str | None = None) -> None:
        op = op or self.pick(self.ops)
        shape = self.shape(self.last)
        sizes = shape if self.chance() else shape[:1]
        tensors = {"r": np.ones(sizes) if self.chance() else self.random.uniform(0.5, 2, sizes)}
        fields: dict[str, Any] = {}
        rest = np.zeros(sizes)
        if op in ("lif", "li"):
            fields["dt"] = self.pick([1e-4, 1e-3])
            tensors["tau"] = self.random.uniform(1, 8, sizes) * fields["dt"]
            tensors["r"] = tensors["r"] * tensors["tau"] / fields["dt"]
            rest = self.pick([rest, self.random.uniform(-0.3, 0.1, sizes)])
            tensors["v_leak"] = rest
        if op != "li":
            fields["reset"] = self.pick(["subtract", "value"])
            tensors["v_threshold"] = self.pick([0.25, 0.5, 1.0]) * np.ones(sizes)
            if self.chance():
                tensors["v_threshold"] = self.random.uniform(0.2, 1.2, sizes)
            if fields["reset"] == "value" and self.chance():
                tensors["v_reset"] = self.random.uniform(-0.5, 0.1, sizes)
        self.add(op, tensors=tensors, **fields)

    def window(self) -> dict[str, Any]:
        _, rows, columns = self.shape(self.last)
        kernel = [min(k, side) for k, side in zip(self.pick(KERNELS), (rows, columns), strict=True)]
        padding = [int(self.random.integers(0, max(1, k - 1))) for k in (*kernel, *kernel)]
        stride = [int(side) for side in self.random.integers(1, 4, 2)]
        return {"kernel": kernel, "padding": padding, "stride": stride}

    def between(self) -> None:
        """A linear layer on a map."""
        channels, rows, columns = self.shape(self.last)
        op = self.pick(["conv", "conv", "conv", "average_pool", "sum_pool", "scale", "add"])
        if op == "scale":
            shape = (channels, rows, columns) if self.chance() else (channels,)
            self.add("scale", tensors={"scale": self.random.uniform(-1, 2, shape)})
        elif op == "add":
            before = self.last
            others = [
                layer["name"]
                for layer in self.layers
                if self.shape(layer["name"]) == (channels, rows, columns)
            ]
            inputs = [before, self.pick(others)] if others else [before, before]
            self.add("add", inputs)
        elif op == "conv":
            fields = self.window()
            groups = self.pick([n for n in (1, 1, 2, channels) if channels % n == 0])
            filters = groups * int(self.random.integers(1, 5))
            reach = [fields["padding"][k] + fields["padding"][k + 2] for k in (0, 1)]
            dilation = [
                2 if 2 * (k - 1) + 1 <= side + pad and self.chance(0.2) else 1
                for k, side, pad in zip(fields["kernel"], (rows, columns), reach, strict=True)
            ]
            weight = self.synapses(filters, channels // groups, *fields["kernel"])
            self.add("conv", tensors={"weight": weight}, dilation=dilation, groups=groups, **fields)
        else:
            self.add(op, **self.window())


def random_spiking_model(
    seed: int,
    config: TNTConfig = CONFIG,
    *,
    raw: bool = False,
    ops: tuple[str, ...] = ("if", "lif"),
) -> Model:
    """A spiking model of `N_CLASSES` classes, or of raw outputs.

    ops : the operations of its neurons. The last layer may be a leaky integrator if "lif" is one.
    """
    builder = _Builder(config, seed, ops)
    if builder.chance():
        builder.add("pick", [VOLUME], channels=[1, 0])
    for _ in range(builder.random.integers(0, 4)):
        for _ in range(builder.random.integers(1, 3)):
            builder.between()
        if builder.chance(0.8):
            builder.neurons()
    last_op = "li" if "lif" in ops and builder.chance(0.2) else None
    if raw and builder.chance():
        builder.neurons(last_op)
    else:
        builder.add("flatten")
        if builder.chance(0.3):
            builder.neurons()
        weight = builder.synapses(N_CLASSES, int(np.prod(builder.shape(builder.last))))
        builder.add("dense", tensors={"weight": weight})
        if builder.chance(0.3):
            builder.neurons()
            weight = builder.synapses(N_CLASSES, N_CLASSES)
            builder.add("dense", tensors={"weight": weight})
        builder.neurons(last_op)
    layers = builder.layers
    return Model(
        config,
        builder.weights,
        () if raw else ("a", "b", "c"),
        network={"spiking": layers},
        outputs=outputs_of(layers) if raw else {},
    )
