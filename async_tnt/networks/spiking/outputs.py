"""The outputs of a spiking network: what its last layer's neurons have done in the window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from async_tnt.networks.layers.layer import Layer
from async_tnt.networks.spiking.operations import FIRING
from async_tnt.networks.spiking.operations import OUTPUTS as ENDS
from async_tnt.volume.config import TNTConfig

SPIKES = "spikes"
MEMBRANES = "membranes"
FIRST_SPIKES = "first_spike_us"

OUTPUTS = {
    SPIKES: "the number of each neuron's spikes in the window",
    MEMBRANES: "each neuron's membrane after the newest event, at its time",
    FIRST_SPIKES: "the time of each neuron's first spike since the window's start, or -1",
}
"""Name of an output -> what it holds. A leaky integrator has membranes alone.

Times are float32: they are exact to a microsecond in the first 16 seconds of a window."""


def outputs_of(layers: Sequence[Layer]) -> dict[str, str]:
    """Name of an output -> the layer that computes it, for a model of raw outputs."""
    last = layers[-1]
    names = list(OUTPUTS) if last["op"] in FIRING else [MEMBRANES]
    return {name: last["name"] for name in names}


def check_spiking_outputs(
    layers: Sequence[Layer], outputs: Mapping[str, str], config: TNTConfig
) -> None:
    """Refuse a network whose last layer has no neurons, other raw outputs, or another input.

    Raises
    ------
    ValueError : see above.
    """
    if layers[-1]["op"] not in ENDS:
        raise ValueError("the last layer of a spiking network must be of neurons")
    expected = outputs_of(layers)
    if outputs and dict(outputs) != expected:
        raise ValueError(f"the outputs of this spiking network must be {', '.join(expected)}")
    is_plain = (
        config.representation == "count"
        and config.polarity == "split"
        and config.transform == "none"
        and config.grid == config.sensor
        and config.window_events is None
    )
    if not is_plain:
        raise ValueError(
            "a spiking network reads the events of a sensor: its configuration must have "
            "representation='count', polarity='split', transform='none', a window of a duration, "
            "and the sensor's own grid"
        )
