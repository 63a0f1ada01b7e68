"""The compiled network of a model of raw outputs, and of any model."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from async_tnt.base.box import Box
from async_tnt.base.checks import ParameterValueError
from async_tnt.base.running import Running, one_at_a_time
from async_tnt.kernels.decisions import outputs as K
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.network.program import EPOCH
from async_tnt.networks.layers.graph import CLASSIFIER
from async_tnt.networks.layers.program import VolumeInput
from async_tnt.networks.models.compiled import CompiledClassifier, program_of
from async_tnt.networks.models.model import Model
from async_tnt.volume.volume import TNTVolume


class CompiledNetwork:
    """The compiled network of a model of raw outputs: volume (C, H, W) -> tensors.

    Each output has the shape (C, H, W) or (N,). The outputs equal torch's within 1e-4 of the
    largest number. A call with an array computes the whole network. `refresh` computes only what
    has changed in a volume since the last call. Both give the same outputs, bit for bit. An
    instance holds its feature maps: use one instance per thread.

    Parameters
    ----------
    model : a Model with `outputs`.

    Attributes
    ----------
    shape : (C, H, W) of the volumes.
    names : the names of the outputs.
    output_shapes : the shapes of the outputs.
    network : the arrays that compiled code reads, see `kernels.network.program`.
    steps : for each step of the program, the name of the layer that it computes or belongs to.

    Raises
    ------
    ValueError : the model has classes; or, in a call, the volume's shape is not the model's.
    RuntimeError : in a call, another call is running.

    Examples
    --------
    >>> from torch import nn
    >>> from async_tnt import CompiledNetwork, Model, TNTConfig, TNTVolume
    >>> config = TNTConfig(sensor=(34, 34), bins=5, transform="none")
    >>> model = Model.from_torch(nn.Conv2d(5, 2, 3, padding=1), config)
    >>> network = CompiledNetwork(model)
    >>> volume = TNTVolume(config)
    >>> volume.open(start_us=0)
    >>> _ = network.refresh(volume)  # the first call computes everything
    >>> _ = volume.update_one(10, 17, 20, 1)
    >>> (flow,) = network.refresh(volume)
    >>> flow.shape, network.changed
    ((2, 34, 34), (Box(x0=16, y0=19, x1=19, y1=22),))
    """

    def __init__(self, model: Model) -> None:
        if not model.outputs:
            rule = "must have raw outputs; CompiledClassifier(model) is for models with classes"
            raise ParameterValueError("model", rule)
        self.shape = model.config.shape
        self.names = tuple(model.outputs)
        self.output_shapes = tuple(model.output_shapes.values())
        self._running = Running("CompiledNetwork")
        self._program = program_of(model, CLASSIFIER)
        self.network = self._program.arrays
        self.steps = self._program.steps
        self._input = VolumeInput(self.shape)
        rows = [
            (number, record)
            for number, output in enumerate(self._program.outputs)
            for record in output.changes
        ]
        self._sources = np.array(rows, np.int64)
        self._boxes = np.zeros((len(self.names), K.BOX_SIZE), np.int64)
        self._prepare()

    def _prepare(self) -> None:
        """Compile the kernels, so that no event waits for the compiler."""
        self._program.prepare()
        prepare(K.refresh_outputs)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        vars(self).pop("arrays", None)  # they are views of the original's memory
        # The copied number names a window of the original's process. In this process it may name
        # another window.
        self.network.program[EPOCH] = 0
        self._prepare()

    @cached_property  # made once: making a view takes as long as running a small network
    def arrays(self) -> tuple[np.ndarray, ...]:
        """The outputs of the last call, read-only float32; the next call changes them."""
        shapes = enumerate(self.output_shapes)
        return tuple(self._program.view(number, shape) for number, shape in shapes)

    @property
    def changed(self) -> tuple[Box, ...]:
        """For each output, the box of the places where the last `refresh` may have changed it.

        A vector (N,) is a map of one place.
        """
        return tuple(Box(*box) for box in self._boxes.tolist())

    @one_at_a_time
    def __call__(self, volume: np.ndarray) -> tuple[np.ndarray, ...]:
        """The outputs of one volume, new arrays, float32."""
        self._program.run(self._input(volume))
        return tuple(array.copy() for array in self.arrays)

    @one_at_a_time
    def refresh(self, volume: TNTVolume) -> tuple[np.ndarray, ...]:
        """The outputs of a volume's open window: read-only views, which the next call changes.

        The call is quick if little has changed since the last call.

        Parameters
        ----------
        volume : a TNTVolume of the model's shape; it may be another one than in the last call.

        Raises
        ------
        ValueError : the volume has another shape.
        """
        if volume.config.shape != self.shape:
            raise ParameterValueError(
                "volume", f"must have shape {self.shape}", volume.config.shape
            )
        K.refresh_outputs.call(volume.state(), *self.network, self._sources, self._boxes)
        return self.arrays


def compiled_network_of(model: Model) -> CompiledClassifier | CompiledNetwork:
    """The compiled network of a model with classes or with raw outputs."""
    return CompiledNetwork(model) if model.outputs else CompiledClassifier(model)
