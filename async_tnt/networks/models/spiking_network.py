"""SpikingNetwork: the compiled network of a spiking model."""

from __future__ import annotations

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import short
from async_tnt.networks.layers.graph import SPIKING
from async_tnt.networks.models.model import Model
from async_tnt.networks.spiking.operations import FIRING, NEURONS
from async_tnt.networks.spiking.program import make_spiking_program


class SpikingNetwork:
    """The compiled network of a spiking model. It has no state: its volumes have one each.

    Parameters
    ----------
    model : a spiking model.

    Attributes
    ----------
    config : the model's configuration.
    n_classes : number of classes; 0 for a model of raw outputs.
    outputs : name of a raw output -> its shape; empty for a model with classes.
    layers : the names of the layers of neurons, in their order. The last one is the output.
    fires : whether the output has spikes; a leaky integrator has none.
    program : the arrays that compiled code reads, see `kernels.spiking.layout`.
    output_stage : where the output's record begins in them.

    Raises
    ------
    ValueError : the model is no spiking model.
    """

    def __init__(self, model: Model) -> None:
        if not model.is_spiking:
            rule = "must be a spiking model, as Model.from_nir returns it"
            raise ParameterValueError("model", rule, short(repr(model)))
        self.config = model.config
        self.n_classes = len(model.classes)
        self.outputs = model.output_shapes
        network = model.network[SPIKING]
        kinds = {operation.name for operation in NEURONS}
        self.layers = tuple(layer["name"] for layer in network if layer["op"] in kinds)
        self.fires = network[-1]["op"] in FIRING
        self.program = make_spiking_program(network, model.config.shape, model.weights)
        self.output_stage = self.program.stages[self.layers[-1]].stage
