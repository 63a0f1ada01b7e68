"""A trained pipeline's way into a model file, and a model's way back into torch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from tnt_reference import Classifier, LandmarkRegressor

from async_tnt.networks.model import Model
from async_tnt.training.pipelines import Pipeline, input_scales
from async_tnt.training.windows import Windows


def export(pipeline: Pipeline, classes: tuple[str, ...], record: Mapping[str, Any]) -> Model:
    """The finished model: the first convolutions absorb their input's scale, so that they take raw volumes.

    conv1(scale V) = w * (scale V) = (scale w) * V
    """
    parts: dict[str, tuple[Any, torch.Tensor]]
    parts = {"": (pipeline.classifier, pipeline.scale), "regressor.": (pipeline.regressor, pipeline.raw_scale)}
    weights = {}
    for prefix, (network, scale) in parts.items():
        if network is None:
            continue
        for name, tensor in network.state_dict().items():
            w = tensor.detach().cpu()
            weights[prefix + name] = (w * scale.cpu() if name == "conv1.weight" else w.clone()).numpy()
    return Model(pipeline.config, weights, classes, record)


def pipeline_of(model: Model) -> Pipeline:
    """A model in torch, from windows to logits, ready to classify."""
    return Pipeline(model.config, network_of(model), regressor_of(model)).eval()


def pipeline_before_export(model: Model, windows: Windows) -> Pipeline:
    """The inverse of `export`: a model's pipeline, with input scales measured on `windows`, to train it on."""
    scales = input_scales(model.config, windows)
    pipeline = Pipeline(model.config, network_of(model), regressor_of(model), **scales)
    network: Any
    with torch.no_grad():
        for network, scale in ((pipeline.classifier, pipeline.scale), (pipeline.regressor, pipeline.raw_scale)):
            if network is not None:
                network.conv1.weight /= scale
    return pipeline


def network_of(model: Model) -> Classifier:
    """A model's classifier in torch. It takes volumes as they are."""
    f1, f2, f3 = (len(model.weights[f"{layer}.bias"]) for layer in ("conv1", "conv2", "fc1"))
    network = Classifier(model.config.channels, model.config.grid, len(model.classes), (f1, f2, f3))
    network.load_state_dict(
        {name: torch.from_numpy(w.copy()) for name, w in model.weights.items() if not name.startswith("regressor.")}
    )
    return network.eval()


def regressor_of(model: Model) -> LandmarkRegressor | None:
    """A model's landmark regressor in torch, where it has one. It takes raw volumes as they are.

    Raises
    ------
    ValueError : its convolutions have different widths, which the compiled regressor takes and this one does not.
    """
    if not model.config.needs_regressor:
        return None
    widths = {len(model.weights[f"regressor.conv{k}.bias"]) for k in (1, 2, 3)}
    if len(widths) != 1:
        raise ValueError(f"the regressor's convolutions must have the same width to be trained, got {sorted(widths)}")
    network = LandmarkRegressor(model.config.channels, model.config.grid, widths.pop())
    prefix = "regressor."
    network.load_state_dict(
        {
            name.removeprefix(prefix): torch.from_numpy(w.copy())
            for name, w in model.weights.items()
            if name.startswith(prefix)
        }
    )
    return network.eval()
