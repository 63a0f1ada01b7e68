"""A spiking network, computed at each event for all of its neurons.

An event at the time t is one step. It enters as a unit impulse at (polarity, y, x). Each layer in
turn computes its value from those of earlier layers at this event; other values are zero. In
float64, with the sum s of what arrives at a neuron, its membrane v and the time dt since the last
event, a neuron computes

    v <- v_leak + (v - v_leak) exp(-dt / tau)              lif, li
    v <- v + r s                                           if
    v <- v + (r dt_0 / tau) s                              lif, li: dt_0 is the layer's `dt`
    n  = the number of its spikes, which is its value
    v <- v - n v_threshold, or v_reset where n is 1        as `reset` says

A neuron with a current i, cuba_lif or cuba_li, solves tau_syn di/dt = -i and
tau_mem dv/dt = v_leak - v + r i for the time dt; then i <- i + (w_in dt_0 / tau_syn) s. A threshold
is a neuron whose membrane is what arrives at this event alone.

A neuron has no spike while its membrane is at most its threshold. Above it, a neuron with the reset
to a value has one spike. With the reset by subtraction it has the number of spikes that leaves the
membrane above 0 and at most at the threshold: max(1, ceil(v / v_threshold) - 1), and one more where
rounding leaves more than the threshold.

The order of sums is a part of the definition, as they are rounded: what a linear layer reads is
added in the order of row, column and channel, one number that is not zero after the other.

References
----------
- Pedersen et al. 2024, Neuromorphic intermediate representation: a unified instruction set for
  interoperable brain-inspired computing, doi:10.1038/s41467-024-52259-9: the neurons' equations
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch.nn import functional as F

Layer = Mapping[str, Any]

Weights = Mapping[str, torch.Tensor]
"""Role -> weights, float64."""

MICROSECONDS = 1e6
"""Microseconds in a second."""

MOST_SPIKES = float(2**31)
"""From this many spikes of a neuron at once, its membrane is 0 afterwards."""


class SpikingNetwork:
    """A spiking network in one window.

    Parameters
    ----------
    layers : the layers, as `networks/layers/graph.py` of the package describes them. The last one
        is of neurons.
    tensors : name -> weights.
    volume : the shape of the events, (2, H, W): ON, then OFF.

    Attributes
    ----------
    membranes : layer of neurons -> its membranes, float64. Flattened ones have the shape of the map
        before.
    counts, first_us : of each neuron of the last layer, the number of its spikes so far, and the
        time of the first of them, or -1.
    spikes : layer of neurons -> its number of spikes so far.
    leaks : whether a neuron of the network leaks.
    """

    def __init__(
        self, layers: Sequence[Layer], tensors: Mapping[str, Any], volume: Sequence[int]
    ) -> None:
        self._layers = list(layers)
        self._weights = {}
        for layer in layers:
            self._weights[layer["name"]] = {
                role: torch.as_tensor(tensors[name]).double()
                for role, name in layer.get("weights", {}).items()
            }
        self._volume = tuple(volume)
        self._responses: dict[tuple[str, int, int, int], torch.Tensor] = {}
        self._of_neurons: dict[str, Weights] = {}
        self.membranes: dict[str, torch.Tensor] = {}
        self._currents: dict[str, torch.Tensor] = {}
        self.spikes: dict[str, float] = {}
        self.leaks = any("v_leak" in weights for weights in self._weights.values())
        self._rest()

    def _rest(self) -> None:
        """Set all neurons to rest, by an event that has no effect."""
        self._time_us: float | None = None
        values = self._values(torch.zeros(self._volume, dtype=torch.float64), 0.0)
        self.spikes = dict.fromkeys(self.membranes, 0.0)
        self.counts = torch.zeros_like(values[self._layers[-1]["name"]])
        self.first_us = torch.full_like(self.counts, -1.0)

    def step(self, t_us: float, x: int, y: int, is_on: bool) -> torch.Tensor:
        """Compute one event; returns the spikes of the last layer at this event.

        t_us : time of the event, at or after that of the event before.
        """
        event = torch.zeros(self._volume, dtype=torch.float64)
        event[0 if is_on else 1, y, x] = 1.0
        passed_us = 0.0 if self._time_us is None else t_us - self._time_us
        self._time_us = t_us
        fired = self._values(event, passed_us)[self._layers[-1]["name"]]
        self.first_us[(fired > 0) & (self.counts == 0)] = t_us
        self.counts += fired
        return fired

    def _values(self, event: torch.Tensor, passed_us: float) -> dict[str, torch.Tensor]:
        """The value of each layer at an event."""
        values = {"volume": event}
        for layer in self._layers:
            inputs = [values[name] for name in layer["inputs"]]
            values[layer["name"]] = self._value(layer, inputs, passed_us)
        return values

    def _value(self, layer: Layer, inputs: list[torch.Tensor], passed_us: float) -> torch.Tensor:
        if layer["op"] in NEURONS:
            return self._fire(layer, inputs[0], passed_us)
        if layer["op"] == "add":
            total = torch.zeros_like(inputs[0])
            for value in inputs:
                total = total + value
            return total
        if layer["op"] == "pick":
            return inputs[0][layer["channels"]]
        if layer["op"] == "flatten":
            return inputs[0]  # as a map, so that its numbers keep their order
        return self._linear(layer, inputs[0])

    def _linear(self, layer: Layer, value: torch.Tensor) -> torch.Tensor:
        """The sum over the numbers of the input, each times the layer's response to a unit."""
        total = torch.zeros_like(self._response(layer, value.shape, (0, 0, 0)))
        for y, x, channel in value.permute(1, 2, 0).nonzero().tolist():
            response = self._response(layer, value.shape, (channel, y, x))
            total = total + value[channel, y, x] * response
        return total

    def _response(
        self, layer: Layer, shape: Sequence[int], place: tuple[int, int, int]
    ) -> torch.Tensor:
        """What a linear layer makes of a unit at a place of its input."""
        key = (layer["name"], *place)
        if key not in self._responses:
            unit = torch.zeros(tuple(shape), dtype=torch.float64)
            unit[place] = 1.0
            self._responses[key] = LINEAR[layer["op"]](layer, self._weights[layer["name"]], unit)
        return self._responses[key]

    def _weights_of_neurons(self, name: str, shape: Sequence[int]) -> Weights:
        """The weights of a layer of neurons, as maps."""
        if name not in self._of_neurons:
            given = self._weights[name]
            self._of_neurons[name] = {role: _as_map(w, shape) for role, w in given.items()}
        return self._of_neurons[name]

    def _fire(self, layer: Layer, arrived: torch.Tensor, passed_us: float) -> torch.Tensor:
        """The spikes of a layer of neurons, or the membranes of a leaky integrator."""
        name = layer["name"]
        w = self._weights_of_neurons(name, arrived.shape)
        if layer["op"] == "threshold":
            fired = (arrived > w["threshold"]).double()
            self.membranes[name] = torch.zeros_like(arrived)
            self.spikes[name] = self.spikes.get(name, 0.0) + float(fired.sum())
            return fired
        gain = w["r"]
        rest = w.get("v_leak", torch.zeros_like(arrived))
        v = self.membranes.get(name, rest.clone())
        if "tau_syn" in w:
            current = self._currents.get(name, torch.zeros_like(v))
            if passed_us > 0.0:
                v, current = _with_current(w, v, current, passed_us / MICROSECONDS)
            self._currents[name] = current + w["w_in"] * layer["dt"] / w["tau_syn"] * arrived
            gain = torch.zeros_like(v)
        if "tau" in w:
            gain = w["r"] * layer["dt"] / w["tau"]
            if passed_us > 0.0:
                v = rest + (v - rest) * torch.exp(-passed_us / (w["tau"] * MICROSECONDS))
        v = v + gain * arrived
        if layer["op"] in ("li", "cuba_li"):
            self.membranes[name] = v
            return torch.zeros_like(v)
        threshold = w["v_threshold"]
        is_above = v > threshold
        if layer["reset"] == "value":
            n = is_above.double()
            v = torch.where(is_above, w.get("v_reset", torch.zeros_like(v)), v)
        else:
            n = (torch.ceil(v / threshold) - 1.0).clamp(min=1.0) * is_above
            v = torch.where(is_above, v - n * threshold, v)
            is_left = v > threshold
            n = n + is_left
            v = torch.where(is_left, v - threshold, v)
            v = torch.where(n >= MOST_SPIKES, torch.zeros_like(v), v)
        self.membranes[name] = v
        self.spikes[name] = self.spikes.get(name, 0.0) + float(n.sum())
        return n


def _with_current(
    w: Weights, v: torch.Tensor, current: torch.Tensor, seconds: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Membrane and current after some time: the solution of the two equations above.

    With p = 1 / tau_mem and q = 1 / tau_syn, the current i adds r i p (e^-qt - e^-pt) / (p - q), or
    r i p t e^-pt where both are equal.
    """
    p = 1.0 / w["tau_mem"]
    q = 1.0 / w["tau_syn"]
    membrane_leak = torch.exp(-p * seconds)
    current_leak = torch.exp(-q * seconds)
    difference = torch.where(p == q, torch.ones_like(p), p - q)
    # e^-qt - e^-pt, without loss where p and q are close
    for_larger_p = -current_leak * torch.expm1(-(p - q) * seconds) / difference
    for_larger_q = membrane_leak * torch.expm1((p - q) * seconds) / difference
    unequal = torch.where(p > q, for_larger_p, for_larger_q)
    added = torch.where(p == q, seconds * membrane_leak, unequal)
    rest = w["v_leak"]
    v = rest + (v - rest) * membrane_leak + w["r"] * current * p * added
    return v, current * current_leak


def _as_map(values: torch.Tensor, shape: Sequence[int]) -> torch.Tensor:
    """Weights of each channel, or of each number of a map or its flattened form, as a map."""
    if values.numel() == shape[0]:
        return values.reshape(-1, 1, 1).expand(tuple(shape))
    return values.reshape(tuple(shape))


def _conv(layer: Layer, weights: Weights, value: torch.Tensor) -> torch.Tensor:
    stride = tuple(layer["stride"])
    dilation = tuple(layer["dilation"])
    padded = _padded(layer, value)
    return F.conv2d(padded, weights["weight"], None, stride, 0, dilation, layer["groups"])[0]


def _padded(layer: Layer, value: torch.Tensor) -> torch.Tensor:
    top, left, bottom, right = layer["padding"]
    return F.pad(value[None], (left, right, top, bottom))


def _dense(layer: Layer, weights: Weights, value: torch.Tensor) -> torch.Tensor:
    return (weights["weight"] @ value.reshape(-1)).reshape(-1, 1, 1)


def _average_pool(layer: Layer, weights: Weights, value: torch.Tensor) -> torch.Tensor:
    kernel, stride = tuple(layer["kernel"]), tuple(layer["stride"])
    return F.avg_pool2d(_padded(layer, value), kernel, stride)[0]


def _sum_pool(layer: Layer, weights: Weights, value: torch.Tensor) -> torch.Tensor:
    kernel, stride = tuple(layer["kernel"]), tuple(layer["stride"])
    return F.avg_pool2d(_padded(layer, value), kernel, stride, divisor_override=1)[0]


def _scale(layer: Layer, weights: Weights, value: torch.Tensor) -> torch.Tensor:
    return value * _as_map(weights["scale"], value.shape)


NEURONS = ("if", "lif", "li", "cuba_lif", "cuba_li", "threshold")
"""Operations with a state."""

LINEAR: dict[str, Callable[[Layer, Weights, torch.Tensor], torch.Tensor]] = {
    "conv": _conv,
    "dense": _dense,
    "average_pool": _average_pool,
    "sum_pool": _sum_pool,
    "scale": _scale,
}
"""Operation -> function (layer, weights, map (C, H, W)) -> map."""
