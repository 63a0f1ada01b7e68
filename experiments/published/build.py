"""Networks of the list, built with random weights and calibrated."""

from __future__ import annotations

import importlib
from typing import Any

import torch
from torch import Tensor, nn

from async_tnt.base.extras import needs_extra
from experiments.published import event_networks
from experiments.published.zoo_list import Entry

CLASSES = 10
"""Number of classes of networks from libraries."""

BATCHES = 4
"""Number of batches by which batch norms are calibrated."""

BATCH = 8
"""Number of inputs in each of these batches."""

ACTIVE = 0.4
"""Largest share of places that have a value in these inputs."""


def build(entry: Entry, seed: int = 0) -> nn.Module:
    """The network of an entry, in eval mode, with random weights that give it usual numbers.

    Batch norms get the statistics of sparse random inputs, so that numbers neither vanish nor grow
    from layer to layer.

    Raises
    ------
    MissingExtraError : the library of the entry is not installed.
    """
    torch.manual_seed(seed)
    module = _MAKERS[entry.source](entry)
    calibrate(module, entry.shape, seed)
    return module.eval()


def calibrate(module: nn.Module, shape: tuple[int, int, int], seed: int) -> None:
    """Give the batch norms of a module the statistics of sparse random inputs."""
    generator = torch.Generator().manual_seed(seed)
    norms = [layer for layer in module.modules() if isinstance(layer, nn.BatchNorm2d)]
    for norm in norms:
        norm.momentum = None  # which means the mean over all batches
        norm.reset_running_stats()
        norm.train()
    module.eval()
    for norm in norms:
        norm.train()
    with torch.no_grad():
        for _ in range(BATCHES if norms else 0):
            module(sparse_inputs(BATCH, shape, generator))


def sparse_inputs(n: int, shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Random inputs, most of whose places are 0, as volumes of events are.

    Their sizes differ, from a tenth to a hundred, and so do their signs and the shares of their
    active places. Otherwise an input unlike these makes numbers grow from layer to layer.
    """
    values = torch.rand((n, *shape), generator=generator)
    sizes = 10 ** (3 * torch.rand((n, 1, 1, 1), generator=generator) - 1)
    signs = torch.sign(torch.rand((n, 1, *shape[1:]), generator=generator) - 0.3)
    active = ACTIVE * torch.rand((n, 1, 1, 1), generator=generator)
    is_active = torch.rand((n, 1, *shape[1:]), generator=generator) < active
    return values * sizes * signs * is_active


def _from_papers(entry: Entry) -> nn.Module:
    module: nn.Module = getattr(event_networks, entry.builder)()
    return module


def _from_torchvision(entry: Entry) -> nn.Module:
    models = _torchvision().models
    family, _, name = entry.builder.rpartition(".")
    make = getattr(getattr(models, family) if family else models, name)
    if family:
        module: nn.Module = make(weights=None, weights_backbone=None, num_classes=CLASSES)
        return module
    options = {"init_weights": False} if name in ("googlenet", "inception_v3") else {}
    if options:
        options["aux_logits"] = False
    module = make(weights=None, num_classes=CLASSES, **options)
    return module


def _from_timm(entry: Entry) -> nn.Module:
    _torchvision()
    with needs_extra("zoo", "networks of timm need it"):
        import timm
    module: nn.Module = timm.create_model(
        entry.builder, pretrained=False, num_classes=CLASSES, in_chans=entry.shape[0]
    )
    return module


def _from_segmentation(entry: Entry) -> nn.Module:
    _torchvision()
    with needs_extra("zoo", "segmentation networks need segmentation-models-pytorch"):
        import segmentation_models_pytorch
    decoder, encoder = entry.builder.split("/")
    module: nn.Module = getattr(segmentation_models_pytorch, decoder)(
        encoder, encoder_weights=None, in_channels=entry.shape[0], classes=2
    )
    return module


def _torchvision() -> Any:
    """The package torchvision.

    Its own operators are in a library that needs CUDA, and no network of the list has them. Where
    they cannot be loaded, two of them are declared, because the package names them on import.
    """
    with needs_extra("zoo", "networks of torchvision need it"):
        try:
            return importlib.import_module("torchvision")
        except RuntimeError:
            _LIBRARY.append(torch.library.Library("torchvision", "DEF"))
            for name in ("nms", "qnms"):
                _LIBRARY[0].define(
                    f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"
                )
            return importlib.import_module("torchvision")


_LIBRARY: list[torch.library.Library] = []
"""What `_torchvision` has declared. It is kept, because declarations end with it."""

_MAKERS = {
    "events": _from_papers,
    "torchvision": _from_torchvision,
    "timm": _from_timm,
    "segmentation": _from_segmentation,
}
"""Source of an entry -> function that makes its network."""
