"""The operations of a spiking network: neurons, and linear layers between them.

The names of neurons, and of the roles of their weights, are those of the Neuromorphic Intermediate
Representation (NIR). `docs/theory.md` says what they compute at an event.

References
----------
- Pedersen et al. 2024, Neuromorphic intermediate representation: a unified instruction set for
  interoperable brain-inspired computing, doi:10.1038/s41467-024-52259-9
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from async_tnt.networks.layers.layer import Check, Layer, Shape
from async_tnt.networks.layers.operation import Operation, expect_weights
from async_tnt.networks.layers.operations import OPERATIONS

SUBTRACT = "subtract"
"""The reset by subtraction: each spike takes the threshold from the membrane."""

VALUE = "value"
"""The reset to a value: the membrane becomes `v_reset`, and a neuron has one spike at most."""

RESETS = (SUBTRACT, VALUE)


def _is_step(value: object) -> bool:
    return isinstance(value, float) and math.isfinite(value) and value > 0.0


RESET = Check(f"one of {', '.join(RESETS)}", lambda value: value in RESETS)

DT = Check("a positive number", _is_step)
"""The time step, in seconds, of the program that trained the network: see `theory.md`."""


def _neuron_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    (source,) = inputs
    for role, shape in weights.items():
        if shape != source[:1]:
            expect_weights(role, shape, source)
    return source


CURRENT_ROLES = {"tau_mem": True, "tau_syn": True, "r": True, "v_leak": True, "w_in": True}
"""The roles of weights of neurons with a current."""

NEURONS = (
    Operation(
        name="if",
        description="Integrate and fire: v grows by r times the input; it fires above v_threshold.",
        parameters={"reset": RESET},
        roles={"r": True, "v_threshold": True, "v_reset": False},
        shape=_neuron_shape,
        flat_maps="kept",
    ),
    Operation(
        name="lif",
        description="As if; v leaks to v_leak, and its input counts r dt / tau.",
        parameters={"reset": RESET, "dt": DT},
        roles={"tau": True, "r": True, "v_leak": True, "v_threshold": True, "v_reset": False},
        shape=_neuron_shape,
        flat_maps="kept",
    ),
    Operation(
        name="cuba_lif",
        description=(
            "As lif; its input counts w_in dt / tau_syn for a current, which leaks, and which "
            "counts r for v."
        ),
        parameters={"reset": RESET, "dt": DT},
        roles=CURRENT_ROLES | {"v_threshold": True, "v_reset": False},
        shape=_neuron_shape,
        flat_maps="kept",
    ),
    Operation(
        name="threshold",
        description="Fires once where its input at one event is above the threshold.",
        roles={"threshold": True},
        shape=_neuron_shape,
        flat_maps="kept",
    ),
    Operation(
        name="li",
        description="A leaky integrator: as lif, but it never fires. It is a network's output.",
        parameters={"dt": DT},
        roles={"tau": True, "r": True, "v_leak": True},
        shape=_neuron_shape,
    ),
    Operation(
        name="cuba_li",
        description="A leaky integrator with a current: as cuba_lif, but it never fires.",
        parameters={"dt": DT},
        roles=CURRENT_ROLES,
        shape=_neuron_shape,
    ),
)
"""Layers with a state. Each has weights for each neuron, or for each channel."""

FIRING = ("if", "lif", "cuba_lif")
"""Neurons that fire, and are reset then."""

INTEGRATORS = ("li", "cuba_li")
"""Neurons that never fire."""

OUTPUTS = (*FIRING, *INTEGRATORS)
"""Neurons that may be the last layer."""

SCALE = Operation(
    name="scale",
    description="Each number times a weight of its own.",
    roles={"scale": True},
    shape=_neuron_shape,
    flat_maps="kept",
)

LINEAR = ("conv", "dense", "average_pool", "sum_pool")
"""Operations that ordinary networks have, too. A bias must be zero."""

SPIKING_OPERATIONS: dict[str, Operation] = {
    **{name: OPERATIONS[name] for name in (*LINEAR, "flatten", "pick", "add")},
    SCALE.name: SCALE,
    **{operation.name: operation for operation in NEURONS},
}
"""Name -> operation of a spiking network."""


def check_spiking_values(layers: Sequence[Layer], weights: Mapping[str, np.ndarray]) -> None:
    """Refuse values for which a layer has no meaning at an event.

    Raises
    ------
    ValueError : the message names the layer and the value.
    """
    readers = [name for layer in layers for name in layer["inputs"]]
    picks = [layer["name"] for layer in layers if layer["op"] == "pick"]
    if picks and readers.count("volume") > 1:
        raise ValueError(f"layer {picks[0]!r} (pick) must be the only one that reads the events")
    for layer in layers:
        if layer["op"] in INTEGRATORS and layer["name"] in readers:
            raise ValueError(
                f"layer {layer['name']!r} ({layer['op']}) must be the last one, as it never fires"
            )
        tensors = {role: weights[name] for role, name in layer.get("weights", {}).items()}
        try:
            _check_layer(layer, tensors)
        except ValueError as error:
            raise ValueError(f"layer {layer['name']!r} ({layer['op']}): {error}") from None


def _check_layer(layer: Layer, tensors: Mapping[str, np.ndarray]) -> None:
    if "bias" in tensors and tensors["bias"].any():
        largest = float(np.abs(tensors["bias"]).max())
        raise ValueError(
            f"its bias must be 0, got up to {largest:.3g}: a constant current has no meaning at "
            "an event"
        )
    if layer["op"] == "pick" and (
        layer["inputs"] != ["volume"] or sorted(layer["channels"]) != [0, 1]
    ):
        raise ValueError("it must read the events, and exchange or keep their channels [0, 1]")
    for role in ("tau", "tau_mem", "tau_syn"):
        if role in tensors and not (tensors[role] > 0).all():
            raise ValueError(f"{role} must be positive, got {float(tensors[role].min()):.3g}")
    if layer["op"] == "threshold" and (tensors["threshold"] < 0).any():
        raise ValueError("threshold must not be negative, as it would fire without input")
    if layer["op"] not in FIRING:
        return

    threshold = tensors["v_threshold"]
    reset_to = tensors.get("v_reset", np.zeros(1, np.float32))
    if layer["reset"] == SUBTRACT:
        if not (threshold > 0).all():
            raise ValueError(
                f"v_threshold must be positive with the reset {SUBTRACT!r}, got "
                f"{float(threshold.min()):.3g}"
            )
        if reset_to.any():
            raise ValueError(f"v_reset must be 0 with the reset {SUBTRACT!r}")
    # neurons without a leak begin at 0
    begin = ("v_leak", tensors["v_leak"]) if "v_leak" in tensors else ("its rest, 0,", np.zeros(1))
    for name, value in (("v_reset", reset_to), begin):
        if (value > threshold).any():
            raise ValueError(
                f"{name} must not be above v_threshold, as the neuron would fire without input"
            )
