"""Networks that are made at random.

They have any layers in any order, branches that are added or joined, and weights with zeros.
"""

import numpy as np
from hypothesis import strategies as st

from async_tnt import Model, TNTConfig
from async_tnt.networks.layers.graph import VOLUME, layer_shapes
from async_tnt.networks.layers.operations import OPERATIONS

CONFIG = TNTConfig(
    sensor=(9, 8), grid=(9, 8), bins=2, window_us=1000, transform="none", landmark="center"
)

KERNELS = [(1, 1), (2, 2), (3, 3), (3, 3), (5, 5), (1, 3), (2, 5), (4, 1)]

FUNCTIONS = [
    name
    for name, operation in OPERATIONS.items()
    if operation.flat_maps == "kept" and not operation.parameters and name != "flatten"
]
"""Operations on each number by itself, without parameters."""

MOST_CHANNELS = 60
"""A map of more channels is joined with itself alone."""

MOST_PLACES = 80
"""Places are spread over maps whose sides are below this."""


class _Builder:
    """The layers so far, with their weights and the shapes of their outputs."""

    def __init__(self, draw, config: TNTConfig) -> None:
        self.draw = draw
        self.config = config
        self.layers = []
        self.weights = {}
        self.random = np.random.default_rng(draw(st.integers(0, 1000)))

    def pick(self, choices):
        return self.draw(st.sampled_from(choices))

    def chance(self) -> bool:
        return self.draw(st.booleans())

    @property
    def shapes(self):
        """Layer -> shape, and that of the volume."""
        tensors = {name: w.shape for name, w in self.weights.items()}
        return layer_shapes(self.layers, self.config.shape, tensors, outputs=())

    def tensor(self, *shape: int, low: float = -1.0, high: float = 1.0) -> str:
        """Add weights; where they may be negative, a fifth of them are zero."""
        name = f"tensor {len(self.weights)}"
        values = self.random.uniform(low, high, shape)
        share_of_zeros = 0.2 if low < 0 else 0.0
        values[self.random.random(shape) < share_of_zeros] = 0.0
        self.weights[name] = values.astype(np.float32)
        return name

    def add(self, op: str, inputs: list[str], **parameters) -> str:
        name = f"layer {len(self.layers)}"
        self.layers.append({"op": op, "name": name, "inputs": inputs, **parameters})
        return name

    def window(self, shape, dilation=(1, 1)):
        """A kernel that fits."""
        kernel = list(self.pick(KERNELS))
        padding = [0, 0, 0, 0]
        for axis in range(2):
            side = shape[1 + axis]
            while (kernel[axis] - 1) * dilation[axis] + 1 > side:
                kernel[axis] -= 1
            most = min(kernel[axis] - 1, 2)
            padding[axis] = self.draw(st.integers(0, most))
            padding[2 + axis] = self.draw(st.integers(0, most))
        stride = self.pick([[1, 1], [1, 1], [2, 2], [3, 1]])
        return {"kernel": kernel, "stride": list(stride), "padding": padding}


# -- how a layer is drawn: it reads `source`, of this shape ----------------------------------------


def _conv(make, source, shape):
    channels = shape[0]
    dilation = make.pick([[1, 1], [1, 1], [2, 1], [1, 2], [2, 3]])
    groups = make.pick([n for n in range(1, channels + 1) if channels % n == 0])
    if groups > 1:
        n_filters = groups * make.draw(st.integers(1, 3))
    else:
        n_filters = make.pick([1, 2, 5, 18, 35])
    window = make.window(shape, dilation)
    taps = (channels // groups, *window["kernel"])
    scale = 1.7 / np.sqrt(np.prod(taps))
    weights = {"weight": make.tensor(n_filters, *taps, low=-scale, high=scale)}
    if make.chance():
        weights["bias"] = make.tensor(n_filters)
    return make.add("conv", [source], weights=weights, **window, dilation=dilation, groups=groups)


def _dense(make, source, shape, n_units):
    (n_inputs,) = shape
    scale = 1.7 / np.sqrt(n_inputs)
    weights = {"weight": make.tensor(n_units, n_inputs, low=-scale, high=scale)}
    if make.chance():
        weights["bias"] = make.tensor(n_units)
    return make.add("dense", [source], weights=weights)


def _batch_norm(make, source, shape):
    n = shape[0]
    weights = {"mean": make.tensor(n), "variance": make.tensor(n, low=0.3, high=2.0)}
    for role in ("weight", "bias"):
        if make.chance():
            weights[role] = make.tensor(n)
    return make.add("batch_norm", [source], weights=weights, epsilon=1e-5)


def _function(op):
    def draw(make, source, shape):
        if op == "log1p":  # its input must be above -1
            source = make.add("clip", [source], low=-0.75, high=None)
        return make.add(op, [source])

    return draw


def _leaky_relu(make, source, shape):
    return make.add("leaky_relu", [source], slope=make.pick([0.01, 0.5, -0.5]))


def _prelu(make, source, shape):
    n = make.pick([1, shape[0]])
    return make.add("prelu", [source], weights={"slope": make.tensor(n, low=-0.1, high=0.9)})


def _clip(make, source, shape):
    low = make.pick([None, 0.0, -0.5])
    return make.add("clip", [source], low=low, high=make.pick([None, 6, 0.25]))


def _softshrink(make, source, shape):
    return make.add("softshrink", [source], lambd=make.pick([0, 0.25, 1.5]))


def _pool(op):
    return lambda make, source, shape: make.add(op, [source], **make.window(shape))


def _adaptive_average_pool(make, source, shape):
    size = [make.draw(st.integers(1, side + 1)) for side in shape[1:]]
    return make.add("adaptive_average_pool", [source], size=size)


def _depth_to_space(make, source, shape):
    largest_side = max(shape[1:])
    blocks = [1]
    for block in (2, 3):
        if shape[0] % block**2 == 0 and block * largest_side < MOST_PLACES:
            blocks.append(block)
    return make.add("depth_to_space", [source], block=make.pick(blocks))


def _padding(op):
    def draw(make, source, shape):
        largest_side = max(shape[1:])
        most = 3 if largest_side + 6 < MOST_PLACES else 0
        return make.add(op, [source], padding=[make.draw(st.integers(0, most)) for _ in range(4)])

    return draw


def _norm(op):
    def draw(make, source, shape):
        n = shape[0]
        weights = {role: make.tensor(n) for role in ("weight", "bias") if make.chance()}
        more = {}
        if op == "group_norm":
            more["groups"] = make.pick([k for k in range(1, n + 1) if n % k == 0])
        return make.add(op, [source], weights=weights, epsilon=make.pick([1e-5, 0.1]), **more)

    return draw


def _bilinear_corners(make, source, shape):
    blocks = [1] + [block for block in (2, 3) if block * max(shape[1:]) < MOST_PLACES]
    return make.add("bilinear_corners", [source], block=make.pick(blocks))


def _expand(make, source, shape):
    """The mean of all places, at as many places as the source has, or others."""
    mean = make.add("global_average_pool", [source])
    size = make.pick([list(shape[1:]), [1, 1], [3, 70]])
    return make.add("expand", [mean], size=size)


def _pick(make, source, shape):
    channels = make.draw(st.lists(st.integers(0, shape[0] - 1), min_size=1, max_size=20))
    return make.add("pick", [source], channels=channels)


def _other_operand(make, source, shape):
    """An input of a sum or product: of the same shape, or of one place or channel."""
    kind = make.pick(["same", "one place", "one channel"])
    if kind == "one place":
        return make.add("global_average_pool", [source])
    if kind == "one channel":
        return make.add("pick", [source], channels=[0])
    return make.pick([name for name, other in make.shapes.items() if other == shape])


def _add(make, source, shape):
    return make.add("add", [source, _other_operand(make, source, shape)])


def _multiply(make, source, shape):
    """The second factor is small, so that numbers do not grow from layer to layer."""
    factor = make.add(make.pick(["sigmoid", "tanh"]), [_other_operand(make, source, shape)])
    return make.add("multiply", make.pick([[source, factor], [factor, source]]))


def _concat(make, source, shape):
    fitting = [name for name, other in make.shapes.items() if other[1:] == shape[1:]]
    others = [source]
    if shape[0] <= MOST_CHANNELS:
        others = make.draw(st.lists(st.sampled_from(fitting), min_size=1, max_size=2))
    return make.add("concat", [source, *others])


ACTIVATIONS = {
    **{name: _function(name) for name in FUNCTIONS},
    "leaky_relu": _leaky_relu,
    "prelu": _prelu,
    "clip": _clip,
    "softshrink": _softshrink,
}
"""Operation -> how it is drawn."""

ON_MAPS = {
    "conv": _conv,
    "batch_norm": _batch_norm,
    **ACTIVATIONS,
    **{op: _pool(op) for op in ("max_pool", "average_pool", "sum_pool", "inside_average_pool")},
    "adaptive_average_pool": _adaptive_average_pool,
    "zero_pad": _padding("zero_pad"),
    "edge_pad": _padding("edge_pad"),
    "depth_to_space": _depth_to_space,
    "layer_norm": _norm("layer_norm"),
    "group_norm": _norm("group_norm"),
    "bilinear_corners": _bilinear_corners,
    "expand": _expand,
    "pick": _pick,
    "multiply": _multiply,
    "add": _add,
    "concat": _concat,
}

IN_THE_HEAD = {"global_average_pool", "flatten", "dense"}

DRAWN = ON_MAPS.keys() | IN_THE_HEAD
"""All operations that a random network may have."""


@st.composite
def random_models(draw, config: TNTConfig = CONFIG) -> Model:
    make = _Builder(draw, config)
    maps = [VOLUME]
    for _ in range(draw(st.integers(0, 6))):
        source = make.pick(maps[-2:])
        op = make.pick(["conv", "conv", *ON_MAPS])
        name = ON_MAPS[op](make, source, make.shapes[source])
        maps.append(name)
    n_classes = make.pick([1, 2, 11, 40])
    _draw_head(make, maps[-1], n_classes)
    classes = tuple(f"class {k}" for k in range(n_classes))
    return Model(config, make.weights, classes, network={"classifier": make.layers})


def _draw_head(make, source, n_classes):
    """Layers from a map to logits: one dense layer or two, with what may stand between."""
    if make.chance():
        source = make.add("global_average_pool", [source])
    source = make.add("flatten", [source])
    if make.chance():
        op = make.pick(["relu", "clip", "tanh"])
        source = ACTIVATIONS[op](make, source, make.shapes[source])
    if make.chance():
        source = _dense(make, source, make.shapes[source], make.pick([1, 17, 40]))
        if make.chance():
            source = _batch_norm(make, source, make.shapes[source])
        if make.chance():
            op = make.pick(sorted(ACTIVATIONS))
            source = ACTIVATIONS[op](make, source, make.shapes[source])
    _dense(make, source, make.shapes[source], n_classes)
