"""Torch modules as classifiers, and a Model's networks as torch modules of the reference.

torch and `tnt_reference` are imported only when they are used.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.base.checks import ParameterTypeError, positive_int
from async_tnt.base.extras import needs_extra
from async_tnt.networks.layers.graph import CLASSIFIER, REGRESSOR
from async_tnt.networks.models.model import Model, layers_of
from async_tnt.networks.models.objects import LOGITS_SHAPES, Places, logits_shape

if TYPE_CHECKING:
    import tnt_reference
    import torch


def torch_classifier(model: Model) -> tnt_reference.LayerNetwork:
    """A model's network as a module in eval mode.

    The module computes logits (N, n_classes) from volumes (N, C, H, W), or a tuple of the raw
    outputs.
    """
    return _network(model, CLASSIFIER, list(model.outputs.values()) or None)


def exact_outputs(model: Model) -> Callable[[np.ndarray], list[np.ndarray]]:
    """A model's network in float64: a function from a volume (C, H, W) to its outputs."""
    import torch

    network = torch_classifier(model).double()

    def outputs(volume: np.ndarray) -> list[np.ndarray]:
        with torch.inference_mode():
            answer = network(torch.tensor(volume, dtype=torch.float64)[None])
        tensors = answer if isinstance(answer, tuple) else (answer,)
        return [tensor[0].numpy() for tensor in tensors]

    return outputs


def torch_regressor(model: Model) -> tnt_reference.LayerNetwork | None:
    """A model's landmark network as a module in eval mode.

    The module computes landmarks (N, 2) in grid pixels from raw volumes (N, C, H, W). The result is
    None if the model has no landmark network.
    """
    return _network(model, REGRESSOR) if model.config.needs_regressor else None


def _network(
    model: Model, name: str, outputs: list[str] | None = None
) -> tnt_reference.LayerNetwork:
    from tnt_reference import LayerNetwork

    return LayerNetwork(layers_of(model, name), model.weights, outputs).eval()


def landmark_function(model: Model) -> Callable[[np.ndarray], tuple[float, float]]:
    """The landmark network as a function from one raw volume (C, H, W) to its landmark.

    The landmark is (x, y) in grid pixels. The model must have a landmark network.
    """
    import torch

    network = torch_regressor(model)
    assert network is not None

    def landmark(raw_volume: np.ndarray) -> tuple[float, float]:
        with torch.inference_mode():
            x, y = network(torch.tensor(raw_volume)[None])[0].tolist()
        return x, y

    return landmark


class TorchClassifier:
    """A torch module as a classifier: volume (C, H, W) -> logits (n_classes,).

    `Processor(config, classifier=TorchClassifier(module))` decides by any callable from a tensor
    (1, C, H, W) to logits: a module, TorchScript, a `torch.export.ExportedProgram`, a plain
    function of tensors. A module is put into eval mode. It is called in inference mode, on the
    device and in the floating type of its first parameter.

    Parameters
    ----------
    module : the callable. Its logits are a tensor of any shape that has one axis longer than 1,
        such as (1, n_classes), or a map (1, n_classes + 1, R, C), see `Model`. The module itself is
        put into eval mode, not a copy: call `module.train()` before training continues.
    places : where the places of a map lie; by default they divide the sensor evenly.
    threads : the number of torch's threads, set here by `torch.set_num_threads`. The number holds
        for the whole process, also for other classifiers and for training. None leaves it as it is.

    Raises
    ------
    ImportError : torch is not installed.
    TypeError : `module` cannot be called; or, in a call, it does not return a tensor.
    ValueError : `threads` is less than 1; or, in a call, the logits have another shape.
    """

    def __init__(
        self,
        module: Callable[[torch.Tensor], torch.Tensor],
        *,
        threads: int | None = 1,
        places: Places | None = None,
    ) -> None:
        with needs_extra("reference", "torch modules need torch"):
            import torch

        if isinstance(module, torch.export.ExportedProgram):
            module = module.module()
        if not callable(module):
            raise ParameterTypeError("module", "must be callable", type(module).__name__)
        if threads is not None:
            torch.set_num_threads(positive_int("threads", threads))
        self.module = module
        self.places = places
        self._like = torch.empty(0)  # a tensor with the device and the type of the module
        if isinstance(module, torch.nn.Module):
            # an exported program has no eval mode: it stays in the mode of its export
            with suppress(NotImplementedError):
                module.eval()
            for w in chain(module.parameters(), module.buffers()):
                if w.is_floating_point():
                    self._like = torch.empty(0, dtype=w.dtype, device=w.device)
                    break

    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """The logits of one volume, a new array: float32, (n_classes,) or (n_classes + 1, R, C)."""
        import torch

        # The volume is copied, which takes 1 us for 9 x 34 x 34. Torch has no read-only tensors.
        # Without a copy, a module that works in place (a first layer `ReLU(inplace=True)`) would
        # write into the open window, and a module that keeps its input would see it change.
        tensor = torch.from_numpy(np.array(volume, np.float32))[None].to(self._like)
        with torch.inference_mode():
            logits: Any = self.module(tensor)
            if not isinstance(logits, torch.Tensor):
                raise TypeError(
                    f"the module must return a tensor of logits, got {type(logits).__name__}"
                )
            shape = logits_shape(tuple(logits.shape))
            if shape is None:
                raise ValueError(
                    f"the module must return logits {LOGITS_SHAPES}, got shape "
                    f"{tuple(logits.shape)}"
                )
            answer: np.ndarray = logits.reshape(shape).to("cpu", torch.float32).numpy()
        return answer.copy()  # the module may keep its tensor
