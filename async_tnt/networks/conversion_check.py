"""Whether the layers that were made of a torch module compute what the module does."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from torch import nn

WAY_OUT = (
    "; TorchClassifier(module) runs any module, and OnnxClassifier what torch exports to ONNX, whole at every decision"
)


def check_conversion(
    module: nn.Module, layers: Sequence[Mapping[str, Any]], weights: Mapping[str, np.ndarray], shape: tuple[int, ...]
) -> None:
    """Compare a module with its layers, on two random volumes: a trace does not show everything that a module does.

    Parameters
    ----------
    layers, weights : as `layers_from_torch` made them.
    shape : of a volume, (C, H, W).

    Raises
    ------
    NotImplementedError : they differ by more than 1e-3 of the largest value, or, of a module in 16 bits, its rounding.
    """
    import torch
    from tnt_reference import LayerNetwork

    like = next((w for w in module.parameters() if w.is_floating_point()), torch.empty(0))
    volumes = torch.randn(2, *shape, generator=torch.Generator().manual_seed(0))
    with torch.no_grad(), in_eval_mode(module):
        expected = module(volumes.to(like)).float().cpu()
        found = LayerNetwork(layers, weights).eval()(volumes).float().reshape(expected.shape)
    bound = max(1e-3, 8 * torch.finfo(like.dtype).eps) * max(1.0, float(expected.abs().max()))
    if not torch.allclose(found, expected, rtol=0.0, atol=bound, equal_nan=True):
        difference = float((found - expected).abs().max())
        raise NotImplementedError(
            f"the module's layers compute other values than the module (by {difference:.2g}): it changes a value in "
            "place that is used again, has hooks, or a layer with a forward of its own" + WAY_OUT
        )


@contextmanager
def in_eval_mode(module: nn.Module) -> Iterator[None]:
    """As `module.eval()`; the modes are restored afterwards."""
    modes = {part: part.training for part in module.modules()}
    module.eval()
    try:
        yield
    finally:
        for part, mode in modes.items():
            part.training = mode
