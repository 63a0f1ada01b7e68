"""Made streams and models for the tests."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from async_tnt import EVENT_DTYPE, Model, TNTConfig, TNTVolume


def events_of(t, x, y, p) -> np.ndarray:
    """Columns as a structured array."""
    events = np.empty(len(t), EVENT_DTYPE)
    events["t"] = t
    events["x"] = x
    events["y"] = y
    events["p"] = p
    return events


def random_events(
    n: int, *, seed: int = 0, duration_us: int = 105_000, sensor=(34, 34), start_us: int = 0
):
    """A sorted stream, uniform over time and sensor."""
    rng = np.random.default_rng(seed)
    return events_of(
        np.sort(rng.integers(start_us, start_us + duration_us, n)),
        rng.integers(0, sensor[0], n),
        rng.integers(0, sensor[1], n),
        rng.integers(0, 2, n),
    )


def opened(config: TNTConfig, events=None, start_us: int = 0, **settings) -> TNTVolume:
    """A volume whose window begins then, with these events."""
    volume = TNTVolume(config, **settings)
    volume.open(start_us)
    volume.update(events)
    return volume


def random_model(
    config: TNTConfig = TNTConfig(),  # noqa: B008
    *,
    classes: int = 10,
    widths=(16, 32, 64),
    regressor_widths=(20, 20, 20),
    sharpness: float = 2.0,
    seed: int = 0,
) -> Model:
    """A model with random weights of a sensible size.

    It has a landmark network if the configuration needs one.
    """
    rng = np.random.default_rng(seed)
    channels, height, width = config.shape
    shapes = {
        "conv1": (widths[0], channels, 3, 3),
        "conv2": (widths[1], widths[0], 3, 3),
        "fc1": (widths[2], widths[1] * (height // 4) * (width // 4)),
        "fc2": (classes, widths[2]),
    }
    weights = {}
    for layer, shape in shapes.items():
        bound = 1 / np.sqrt(np.prod(shape[1:]))
        weights[f"{layer}.weight"] = rng.uniform(-bound, bound, shape)
        weights[f"{layer}.bias"] = rng.uniform(-bound, bound, shape[0])
    if config.needs_regressor:
        weights |= _random_regressor(rng, channels, regressor_widths, sharpness)
    names = tuple(f"class {k}" for k in range(classes))
    return thesis_model(config, weights, names, {"made": True})


def raw_model(config: TNTConfig = TNTConfig(), *, seed: int = 0) -> Model:  # noqa: B008
    """A model with raw outputs: a map of the grid's size, one of half of it, and a vector."""
    rng = np.random.default_rng(seed)
    channels = config.shape[0]
    name, op, halving = _conv("half", roles=("weight",))
    steps = [
        _conv("flow", roles=("weight",)),
        _relu(1),
        (name, op, halving | {"stride": [2, 2]}),
        ("mean", "global_average_pool", {}),
        ("vector", "flatten", {}),
    ]
    weights = {
        "flow.weight": rng.normal(size=(2, channels, 3, 3)),
        "half.weight": rng.normal(size=(3, 2, 3, 3)),
    }
    return Model(
        config,
        weights,
        network={"classifier": _chain(steps)},
        outputs={"flow": "flow", "half": "half", "mean": "vector"},
    )


REGRESSOR_CONFIG = TNTConfig(landmark="regressor")


def random_regressor_model(config: TNTConfig = REGRESSOR_CONFIG, **settings) -> Model:
    """`random_model` with a landmark network whose landmark lies pixels away from the centre.

    Its heatmap has peaks where the events are. With few events that takes a large `sharpness`.
    """
    config = config.replace(landmark="regressor", transform="tnt", remove_flow=False)
    return random_model(config, **settings)


def _random_regressor(
    rng: np.random.Generator, channels: int, widths, sharpness: float
) -> dict[str, np.ndarray]:
    weights = {}
    inputs = channels
    for layer, n_filters in zip(("conv1", "conv2", "conv3"), widths, strict=True):
        # sized so that numbers neither die out nor explode from layer to layer
        bound = np.sqrt(6 / (9 * inputs))
        weights[f"regressor.{layer}.weight"] = rng.uniform(-bound, bound, (n_filters, inputs, 3, 3))
        weights[f"regressor.{layer}.bias"] = rng.uniform(-0.1, 0.1, n_filters)
        inputs = n_filters
    weights["regressor.heatmap.weight"] = rng.uniform(-sharpness, sharpness, (1, inputs, 1, 1))
    return weights


@st.composite
def nasty_streams(draw, sensor, window_us: int, start_us: int, max_events: int = 60):
    """Streams of hard cases.

    Ties, bursts, borders, corners, the window's first and last microsecond, times that run
    backwards, all events at one pixel.
    """
    n = draw(st.integers(0, max_events))
    moments = (0, 1, window_us // 8, window_us // 4, window_us // 2, window_us - 1)
    special = st.sampled_from([moment for moment in moments if moment < window_us])
    inside = st.integers(0, window_us - 1)
    times = draw(st.lists(st.one_of(inside, special), min_size=n, max_size=n))
    if draw(st.booleans()):
        times = sorted(times)
    # a burst: half of the stream at one moment
    if n and draw(st.booleans()):
        times[n // 2 :] = [times[n // 2]] * (n - n // 2)
    x = draw(st.lists(_places(sensor[0]), min_size=n, max_size=n))
    y = draw(st.lists(_places(sensor[1]), min_size=n, max_size=n))
    if n and draw(st.integers(0, 4)) == 0:
        x = [x[0]] * n
        y = [y[0]] * n
    p = draw(st.lists(st.integers(0, 1), min_size=n, max_size=n))
    return events_of([start_us + t for t in times], x, y, p)


def _places(size: int):
    """Places on a side of a sensor, often at its ends or in its middle."""
    special = st.sampled_from([0, size - 1, (size - 1) // 2, size // 2])
    return st.one_of(special, st.integers(0, size - 1))


def thesis_model(config: TNTConfig, *arguments, **named) -> Model:
    """A `Model` of the thesis' networks, whose widths are those of its weights."""
    return Model(config, *arguments, **named, network=thesis_network(config))


def thesis_network(config: TNTConfig) -> dict[str, list[dict]]:
    """The thesis' two networks as layers (Wang 2019).

    The classifier: two convolutions with ReLU, each followed by average pooling, then two dense
    layers. The landmark regressor, if the configuration needs one: three convolutions with ReLU,
    then one of 1x1, whose heatmap has a centroid.
    """
    pool = {"kernel": [2, 2], "stride": [2, 2], "padding": [0, 0, 0, 0]}
    steps = []
    for k in (1, 2):
        steps += [_conv(f"conv{k}"), _relu(k), (f"pool{k}", "average_pool", pool)]
    steps += [("flatten", "flatten", {}), _dense("fc1"), _relu(3), _dense("fc2")]
    network = {"classifier": _chain(steps)}
    if config.needs_regressor:
        steps = []
        for k in (1, 2, 3):
            steps += [_conv(f"conv{k}", "regressor."), _relu(k)]
        # a bias would not move the centroid
        steps.append(_conv("heatmap", "regressor.", side=1, roles=("weight",)))
        steps.append(("landmark", "heatmap_centroid", {}))
        network["regressor"] = _chain(steps)
    return network


def _chain(steps):
    """Layers, each of which has the one before it as its input."""
    layers = []
    before = "volume"
    for name, op, more in steps:
        layers.append({"op": op, "name": name, "inputs": [before], **more})
        before = name
    return layers


def _conv(name, prefix="", side=3, roles=("weight", "bias")):
    """A convolution that keeps the size."""
    weights = {role: f"{prefix}{name}.{role}" for role in roles}
    sides = {
        "kernel": [side, side],
        "stride": [1, 1],
        "padding": [side // 2] * 4,
        "dilation": [1, 1],
    }
    return name, "conv", {"weights": weights, **sides, "groups": 1}


def _relu(k):
    return f"relu{k}", "relu", {}


def _dense(name):
    return name, "dense", {"weights": {role: f"{name}.{role}" for role in ("weight", "bias")}}
