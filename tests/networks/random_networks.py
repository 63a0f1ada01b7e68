"""Networks made at random: any layers in any order, branches that are added or joined, weights with
zeros."""

import numpy as np
from hypothesis import strategies as st

from async_tnt import Model, TNTConfig
from async_tnt.networks.layers.graph import VOLUME, layer_shapes
from async_tnt.networks.layers.operations import OPERATIONS

SIDES = st.sampled_from([(1, 1), (2, 2), (3, 3), (3, 3), (5, 5), (1, 3), (2, 5), (4, 1)])
FUNCTIONS = [
    name
    for name, operation in OPERATIONS.items()
    if operation.flat_maps == "kept" and not operation.parameters and name != "flatten"
]
ACTIVATIONS = ("leaky_relu", "prelu", "clip", *FUNCTIONS)
POOLS = ("max_pool", "average_pool", "sum_pool", "inside_average_pool")
CONFIG = TNTConfig(
    sensor=(9, 8), grid=(9, 8), bins=2, window_us=1000, transform="none", landmark="center"
)


class _Builder:
    def __init__(self, draw, config: TNTConfig) -> None:
        self.draw, self.config = draw, config
        self.layers, self.weights = [], {}
        self.random = np.random.default_rng(draw(st.integers(0, 1000)))

    @property
    def shapes(self):
        tensors = {name: w.shape for name, w in self.weights.items()}
        return layer_shapes(self.layers, self.config.shape, tensors, partial=True)

    def tensor(self, *shape: int, low: float = -1.0, high: float = 1.0) -> str:
        name = f"tensor {len(self.weights)}"
        values = self.random.uniform(low, high, shape)
        values[self.random.random(shape) < 0.2 * (low < 0)] = 0.0
        self.weights[name] = values.astype(np.float32)
        return name

    def add(self, op: str, inputs: list[str], **parameters) -> str:
        name = f"layer {len(self.layers)}"
        self.layers.append({"op": op, "name": name, "inputs": inputs, **parameters})
        return name

    def window(self, shape, dilation=(1, 1)):
        """A kernel that fits."""
        kernel, padding = list(self.draw(SIDES)), [0, 0, 0, 0]
        for axis in range(2):
            side = shape[1 + axis]
            while (kernel[axis] - 1) * dilation[axis] + 1 > side:
                kernel[axis] -= 1
            most = min(kernel[axis] - 1, 2)
            padding[axis], padding[2 + axis] = (
                self.draw(st.integers(0, most)),
                self.draw(st.integers(0, most)),
            )
        stride = self.draw(st.sampled_from([[1, 1], [1, 1], [2, 2], [3, 1]]))
        return {"kernel": kernel, "stride": list(stride), "padding": padding}

    def conv(self, source: str, shape) -> str:
        channels = shape[0]
        dilation = self.draw(st.sampled_from([[1, 1], [1, 1], [2, 1], [1, 2], [2, 3]]))
        groups = self.draw(
            st.sampled_from([n for n in range(1, channels + 1) if channels % n == 0])
        )
        n_filters = (
            groups * self.draw(st.integers(1, 3))
            if groups > 1
            else self.draw(st.sampled_from([1, 2, 5, 18, 35]))
        )
        window = self.window(shape, dilation)
        n_products = channels // groups * window["kernel"][0] * window["kernel"][1]
        scale = 1.7 / np.sqrt(n_products)
        weights = {
            "weight": self.tensor(
                n_filters, channels // groups, *window["kernel"], low=-scale, high=scale
            )
        }
        if self.draw(st.booleans()):
            weights["bias"] = self.tensor(n_filters)
        return self.add(
            "conv", [source], weights=weights, **window, dilation=dilation, groups=groups
        )

    def dense(self, source: str, n_inputs: int, n_units: int) -> str:
        scale = 1.7 / np.sqrt(n_inputs)
        weights = {"weight": self.tensor(n_units, n_inputs, low=-scale, high=scale)}
        if self.draw(st.booleans()):
            weights["bias"] = self.tensor(n_units)
        return self.add("dense", [source], weights=weights)

    def batch_norm(self, source: str, n: int) -> str:
        weights = {"mean": self.tensor(n), "variance": self.tensor(n, low=0.3, high=2.0)}
        for role in ("weight", "bias"):
            if self.draw(st.booleans()):
                weights[role] = self.tensor(n)
        return self.add("batch_norm", [source], weights=weights, epsilon=1e-5)

    def activation(self, op: str, source: str, shape, flat: bool = False) -> str:
        if op == "log1p":  # of what is above -1
            return self.add(op, [self.add("clip", [source], low=-0.75, high=None)])
        if op in FUNCTIONS:
            return self.add(op, [source])
        if op == "clip":
            low = self.draw(st.sampled_from([None, 0.0, -0.5]))
            return self.add(op, [source], low=low, high=self.draw(st.sampled_from([None, 6, 0.25])))
        if op == "prelu" and not flat:
            n = self.draw(st.sampled_from([1, shape[0]]))
            return self.add(op, [source], weights={"slope": self.tensor(n, low=-0.1, high=0.9)})
        return self.add("leaky_relu", [source], slope=self.draw(st.sampled_from([0.01, 0.5, -0.5])))


@st.composite
def random_models(draw, config: TNTConfig = CONFIG) -> Model:
    make = _Builder(draw, config)
    maps = {VOLUME: config.shape}
    for _ in range(draw(st.integers(0, 6))):
        source = draw(st.sampled_from(sorted(maps)[-2:])) if draw(st.booleans()) else list(maps)[-1]
        shape = maps[source]
        op = draw(
            st.sampled_from(
                [
                    "conv",
                    "conv",
                    "conv",
                    "batch_norm",
                    *ACTIVATIONS,
                    *POOLS,
                    "adaptive",
                    "spread",
                    "add",
                    "concat",
                ]
            )
        )
        same = [name for name, other in maps.items() if other == shape]
        joined = [name for name, other in maps.items() if other[1:] == shape[1:]]
        if op == "conv":
            name = make.conv(source, shape)
        elif op == "batch_norm":
            name = make.batch_norm(source, shape[0])
        elif op in POOLS:
            name = make.add(op, [source], **make.window(shape))
        elif op == "adaptive":
            size = [draw(st.integers(1, side + 1)) for side in shape[1:]]
            name = make.add("adaptive_average_pool", [source], size=size)
        elif op == "spread":
            blocks = [
                block
                for block in (1, 2, 3)
                if shape[0] % block**2 == 0 and block * max(shape[1:]) < 80
            ]
            if not blocks:
                continue
            name = make.add("depth_to_space", [source], block=draw(st.sampled_from(blocks)))
        elif op == "add":
            name = make.add(op, [source, draw(st.sampled_from(same))])
        elif op == "concat":
            if shape[0] > 60:
                continue
            name = make.add(
                op, [source, *draw(st.lists(st.sampled_from(joined), min_size=1, max_size=2))]
            )
        else:
            name = make.activation(op, source, shape)
        maps[name] = make.shapes[name]
    source = list(maps)[-1]
    n_classes = draw(st.sampled_from([1, 2, 11, 40]))
    shape = maps[source]
    if draw(st.booleans()):
        source = make.add("global_average_pool", [source])
        shape = (shape[0], 1, 1)
    source = make.add("flatten", [source])
    n = int(np.prod(shape))
    if draw(st.booleans()):
        source = make.activation(
            draw(st.sampled_from(["relu", "clip", "tanh"])), source, (n,), flat=True
        )
    if draw(st.booleans()):
        n_units = draw(st.sampled_from([1, 17, 40]))
        source = make.dense(source, n, n_units)
        n = n_units
        if draw(st.booleans()):
            source = make.batch_norm(source, n)
        if draw(st.booleans()):
            source = make.activation(draw(st.sampled_from(ACTIVATIONS)), source, (n,))
    make.dense(source, n, n_classes)
    classes = tuple(f"class {k}" for k in range(n_classes))
    return Model(config, make.weights, classes, network={"classifier": make.layers})
