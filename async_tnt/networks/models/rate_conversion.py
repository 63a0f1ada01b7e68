"""A spiking model of a trained network of ReLUs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterTypeError, ParameterValueError, real_number
from async_tnt.base.messages import short
from async_tnt.networks.layers.graph import CLASSIFIER, SPIKING, VOLUME, layer_shapes, tensors_of
from async_tnt.networks.layers.layer import Layer
from async_tnt.networks.models.batch_norms import Layers, Weights, without_batch_norms
from async_tnt.networks.models.compiled_network import CompiledNetwork
from async_tnt.networks.models.model import Model
from async_tnt.networks.spiking.operations import SUBTRACT
from async_tnt.networks.spiking.outputs import outputs_of

PERCENTILE = 99.9
"""The percentile of a layer's activations that stands for the largest one."""

SPIKES = 16.0
"""How many spikes a neuron has in a window, by default, if its activation is that percentile."""

MOST_OF_A_WINDOW = 1 << 16
"""The most activations of a layer in one window from which its percentile is computed."""

KEPT = ("conv", "dense", "average_pool", "sum_pool", "flatten")
"""Operations that a spiking network has, too."""


def spiking_from_rates(
    model: Model,
    windows: Iterable[np.ndarray],
    *,
    spikes: float = SPIKES,
    percentile: float = PERCENTILE,
    record: Mapping[str, Any] | None = None,
) -> Model:
    """A spiking model whose neurons have as many spikes in a window as the ReLUs are large.

    Each ReLU becomes integrate-and-fire neurons that are reset by subtraction. The weights stay.
    With the activation a of a ReLU, which reads a weighted sum of earlier activations, the number
    of spikes is

        n = s a    with    s = spikes / (percentile of a over all windows and neurons of the layer)

    but rounded down. So the neurons' threshold is the s of the layer before, divided by their own.
    This is the normalization of Diehl et al. with the percentile of Rueckauer et al., in terms of
    thresholds. As an event may cause several spikes of a neuron, no rate is too high; `spikes` says
    how finely activations are divided.

    The spiking model only comes close to the network: spikes are whole numbers, and a spike that
    came early is not taken back if later events inhibit the neuron. So it is best where a neuron's
    excitation and inhibition come evenly over the window, and may fail where a scene changes within
    it. Compare the accuracies of the two.

    Parameters
    ----------
    model : a network of convolutions, dense layers, average and sum poolings, additions and ReLUs
        without biases. Batch norms become part of the layer before. Its configuration has
        representation="count", polarity="split" and transform="none", and its grid is the sensor,
        because a spiking network reads single events.
    windows : volumes (2, H, W) as the network reads them, of training data, such as the `volume` of
        what `async_tnt.volumes` yields. Some hundred are enough.
    spikes : how many spikes a neuron has in a window if its activation is at the percentile. More
        are more exact, and take more time.
    percentile : in (0, 100].
    record : see `Model`.

    Returns
    -------
    A spiking model with the classes and the window of `model`. The last layer is always of neurons;
    a network whose logits are all negative has no output spikes, and its largest membrane decides.

    Raises
    ------
    NotImplementedError : a layer has no spiking form. The message names it.
    ValueError : the model reads something else than counts of events at the sensor's pixels, or has
        a bias; or there are no windows, or a layer is never above 0 in them.

    References
    ----------
    - Diehl, Neil, Binas, Cook, Liu, Pfeiffer 2015, Fast-classifying, high-accuracy spiking deep
      networks through weight and threshold balancing, IJCNN.
    - Rueckauer, Lungu, Hu, Pfeiffer, Liu 2017, Conversion of continuous-valued deep networks to
      efficient event-driven networks for image classification, Frontiers in Neuroscience 11:682.

    Examples
    --------
    >>> import async_tnt
    >>> from torch import nn
    >>> from async_tnt.sources import open_recording, sample_recordings
    >>> config = async_tnt.TNTConfig(representation="count", polarity="split")
    >>> module = nn.Sequential(nn.Flatten(), nn.Linear(2 * 34 * 34, 3, bias=False))
    >>> model = Model.from_torch(module, config, classes=["a", "b", "c"])
    >>> events = open_recording(sample_recordings()[3])
    >>> windows = [window.volume for window in async_tnt.volumes(events, config)]
    >>> spiking = spiking_from_rates(model, windows)
    >>> [layer["op"] for layer in spiking.layers]
    ['flatten', 'dense', 'if']
    """
    _check_arguments(model, spikes, percentile)
    layers, weights = without_batch_norms(model)
    _check_layers(layers, weights)
    largest = _percentiles(model, layers, weights, windows, percentile)
    converted = _Conversion(model, layers, weights, {k: spikes / v for k, v in largest.items()})
    for layer in layers:
        converted.add(layer)
    converted.finish()
    return Model(
        model.config,
        converted.weights,
        model.classes,
        record or {},
        network={SPIKING: converted.layers},
        outputs={} if model.classes else outputs_of(converted.layers),
    )


def _check_arguments(model: Model, spikes: float, percentile: float) -> None:
    if not isinstance(model, Model):
        raise ParameterTypeError("model", "must be a Model", short(model))
    if model.is_spiking:
        raise ParameterValueError("model", "must be a network of ReLUs; it is a spiking one")
    if len(model.outputs) > 1 or (not model.outputs and model.places is not None):
        raise ParameterValueError("model", "must have classes or one output, and no map of classes")
    config = model.config
    is_plain = (
        config.representation == "count"
        and config.polarity == "split"
        and config.transform == "none"
        and config.grid == config.sensor
        and config.window_events is None
    )
    if not is_plain:
        rule = (
            "must read counts of events, as a spiking network reads single events: its "
            "configuration must have representation='count', polarity='split', transform='none', a "
            "window of a duration, and the sensor's own grid"
        )
        raise ParameterValueError("model", rule)
    if not 0 < real_number("spikes", spikes) < np.inf:
        raise ParameterValueError("spikes", "must be a positive number", short(spikes))
    if not 0 < real_number("percentile", percentile) <= 100:
        raise ParameterValueError("percentile", "must be in (0, 100]", short(percentile))


# -- checks ----------------------------------------------------------------------------------------


def _check_layers(layers: Layers, weights: Weights) -> None:
    """Refuse layers without a spiking form, and biases; biases of zeros are removed."""
    for layer in layers:
        title = f"layer {layer['name']!r} ({layer['op']})"
        if layer["op"] == "max_pool":
            raise NotImplementedError(
                f"{title}: spikes come one after the other, and the neuron that will have most of "
                "them is not known at an event; train with an average pooling"
            )
        if layer["op"] not in (*KEPT, "relu", "add", "global_average_pool"):
            raise NotImplementedError(f"{title} has no spiking form")
        bias = layer.get("weights", {}).get("bias")
        if bias is None:
            continue
        if weights[bias].any():
            largest = float(np.abs(weights[bias]).max())
            raise ValueError(
                f"{title}: its bias, with that of a batch norm behind it, must be 0, got up to "
                f"{largest:.3g}: a constant current has no meaning at an event; train without"
            )
        layer["weights"] = {"weight": layer["weights"]["weight"]}
    for name in set(weights) - tensors_of(layers):
        del weights[name]


# -- activations -----------------------------------------------------------------------------------


def _percentiles(
    model: Model,
    layers: Layers,
    weights: Weights,
    windows: Iterable[np.ndarray],
    percentile: float,
) -> dict[str, float]:
    """Name of a layer that gets neurons -> the percentile of what it computes.

    These are the ReLUs, and the last layer.

    Raises
    ------
    ValueError : there are no windows, or a layer is never above 0 in them.
    """
    names = [layer["name"] for layer in layers if layer["op"] == "relu"]
    if layers[-1]["name"] not in names:
        names.append(layers[-1]["name"])
    by_name = {layer["name"]: layer for layer in layers}
    outputs = {str(k): _before_flatten(by_name, name) for k, name in enumerate(names)}
    network = CompiledNetwork(
        Model(model.config, weights, network={CLASSIFIER: layers}, outputs=outputs)
    )
    found: list[list[np.ndarray]] = [[] for _ in names]
    for window in windows:
        for activations, values in zip(found, network(window), strict=True):
            flat = values.reshape(-1)
            step = -(-flat.size // MOST_OF_A_WINDOW)
            activations.append(flat[::step].copy())
    if not found[0]:
        raise ParameterValueError("windows", "must have at least one window")

    largest = {}
    for name, activations in zip(names, found, strict=True):
        every = np.maximum(np.concatenate(activations), 0.0)
        value = float(np.percentile(every, percentile))
        if value <= 0.0:
            value = float(every.max())
        if value <= 0.0:
            raise ParameterValueError("windows", f"must make layer {name!r} larger than 0 once")
        largest[name] = value
    return largest


def _before_flatten(by_name: Mapping[str, Layer], name: str) -> str:
    """The layer that computes the activations of another one, perhaps before its ReLU; or VOLUME.

    A flattened map cannot be an output of a network, but the map can.
    """
    source: str = name
    while source != VOLUME and by_name[source]["op"] in ("relu", "flatten"):
        (source,) = by_name[source]["inputs"]
    return source


# -- layers ----------------------------------------------------------------------------------------


class _Conversion:
    """The layers of the spiking network that have been made so far.

    Parameters
    ----------
    scales : layer that gets neurons -> their number of spikes for an activation of 1.
    """

    def __init__(
        self, model: Model, layers: Layers, weights: Weights, scales: Mapping[str, float]
    ) -> None:
        self.layers: Layers = []
        self.weights: Weights = dict(weights)
        tensors = {name: w.shape for name, w in weights.items()}
        self._shapes = layer_shapes(layers, model.config.shape, tensors)
        self._names = {VOLUME, *(layer["name"] for layer in layers)}
        self._scales = scales
        # what a value of the spiking network is for an activation of 1: events count 1
        self._scale_of = {VOLUME: 1.0}

    def add(self, layer: Layer) -> None:
        """Add the layer's spiking form."""
        name = layer["name"]
        source = layer["inputs"][0]
        if layer["op"] == "relu":
            self._add_neurons(name, source, self._scales[name])
            return
        inputs = list(layer["inputs"])
        if layer["op"] == "add":
            inputs = [self._at_scale(other, self._scale_of[source]) for other in inputs]
        new = {**layer, "inputs": inputs}
        if layer["op"] == "global_average_pool":
            sides = list(self._shapes[source][1:])
            new |= {"op": "average_pool", "kernel": sides, "stride": sides, "padding": [0] * 4}
        self.layers.append(new)
        self._scale_of[name] = self._scale_of[source]

    def finish(self) -> None:
        """Add neurons behind a last layer that is no ReLU."""
        last = self.layers[-1]
        if last["op"] != "if":
            name = last["name"]
            self._add_neurons(self._free_name(f"{name}.neurons"), name, self._scales[name])

    def _add_neurons(self, name: str, source: str, scale: float) -> None:
        """Add integrate-and-fire neurons, with parameters for each place, as NIR has them."""
        ones = np.ones(self._shapes[source], np.float32)
        threshold = np.float32(self._scale_of[source] / scale)
        layer = {"op": "if", "name": name, "inputs": [source], "reset": SUBTRACT}
        self._append(layer, {"r": ones, "v_threshold": threshold * ones})
        self._scale_of[name] = scale

    def _at_scale(self, name: str, scale: float) -> str:
        """A layer's values, multiplied so that they have the scale of others."""
        if self._scale_of[name] == scale:
            return name
        factors = np.full(self._shapes[name], scale / self._scale_of[name], np.float32)
        scaled = self._free_name(f"{name}.scale")
        self._append({"op": "scale", "name": scaled, "inputs": [name]}, {"scale": factors})
        self._scale_of[scaled] = scale
        return scaled

    def _append(self, layer: dict[str, Any], tensors: Mapping[str, np.ndarray]) -> None:
        """Append a layer with new weights."""
        layer["weights"] = {}
        for role, values in tensors.items():
            tensor = f"{layer['name']}.{role}"
            while tensor in self.weights:
                tensor = f"{tensor}_"
            layer["weights"][role] = tensor
            self.weights[tensor] = values
        self.layers.append(layer)

    def _free_name(self, name: str) -> str:
        while name in self._names:
            name = f"{name}_"
        self._names.add(name)
        return name
