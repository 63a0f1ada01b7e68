"""The pipeline from windows to logits, which is trainable from end to end.

Its volumes are computed by the kernels, and its networks are torch modules. `export` turns a
pipeline into a model, and `pipeline_of` turns a model into a pipeline.

    landmark `regressor`    events -> raw volume -> regressor -> landmark -> volume -> classifier
    every other landmark    events -> volume -> classifier

With landmark `regressor`, the gradient of the loss reaches the regressor through the volume
(`BatchVolumes.landmark_gradient`). For each window, the gradient passes through two numbers only,
the x and the y of the landmark. So the backward pass costs about as much as the computation of the
volume.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import nn

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import one_line
from async_tnt.networks.layers.graph import CLASSIFIER, REGRESSOR, VOLUME
from async_tnt.networks.layers.layer import Layer
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.scaled_volume import with_scaled_volume
from async_tnt.networks.models.torch_modules import torch_classifier, torch_regressor
from async_tnt.training.augment import Draws
from async_tnt.training.batches import BatchVolumes
from async_tnt.training.networks import build_network, landmark_network
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig

N_MEASURED = 512
"""Most windows on which an input scale is measured. These are spread evenly over all windows."""


class Pipeline(nn.Module):
    """A torch module from windows to logits.

    Parameters
    ----------
    config : how events become volumes.
    classifier : module from volumes (N, C, H, W) to logits (N, n_classes).
    regressor : module from raw volumes (N, C, H, W) to landmarks (N, 2) in grid pixels; only with
        landmark `regressor`.
    scale, raw_scale : the factors by which the inputs of the classifier and of the regressor are
        multiplied.
    """

    scale: torch.Tensor
    raw_scale: torch.Tensor

    def __init__(
        self,
        config: TNTConfig,
        classifier: nn.Module,
        regressor: nn.Module | None = None,
        *,
        scale: float = 1.0,
        raw_scale: float = 1.0,
    ) -> None:
        super().__init__()
        self.config = config
        self.classifier = classifier
        self.regressor = regressor
        self.register_buffer("scale", torch.tensor(scale, dtype=torch.float32))
        self.register_buffer("raw_scale", torch.tensor(raw_scale, dtype=torch.float32))
        self._volumes = BatchVolumes(config)
        self._raw_volumes = BatchVolumes(
            config.replace(landmark="center", transform="none", remove_flow=False)
        )

    def forward(self, windows: Windows, draws: Draws | None = None) -> torch.Tensor:
        """Logits (N, n_classes) of N windows, augmented by `draws`."""
        return self.classify(self.volumes(windows, draws))

    def classify(self, volumes: torch.Tensor) -> torch.Tensor:
        """Logits of volumes (N, C, H, W): (N, n_classes), or maps (N, n_classes + 1, R, C)."""
        logits: torch.Tensor = self.classifier(self._on_device(volumes, self.scale)).float()
        if logits.shape[2:] == (1, 1):
            logits = logits.flatten(1)
        return logits

    def volumes(self, windows: Windows, draws: Draws | None = None) -> torch.Tensor:
        """The classifier's input before it is scaled, (N, C, H, W)."""
        if self.regressor is None:
            return torch.from_numpy(self._volumes(windows, draws))
        landmarks = self.landmarks(windows, draws)
        volumes: torch.Tensor = _SplatAbout.apply(  # type: ignore[no-untyped-call]
            landmarks.cpu(), self._volumes, windows, draws
        )
        return volumes

    def landmarks(self, windows: Windows, draws: Draws | None = None) -> torch.Tensor:
        """The regressor's landmarks, float64, (N, 2), in grid pixels."""
        assert self.regressor is not None
        raw = torch.from_numpy(self._raw_volumes(windows, draws))
        landmarks: torch.Tensor = self.regressor(self._on_device(raw, self.raw_scale))
        return landmarks.double()

    def _on_device(self, volumes: torch.Tensor, scale: torch.Tensor) -> torch.Tensor:
        """Volumes times `scale`, on the device of `scale`."""
        # The kernels write the next batch into `volumes`. The product is a new array, which the
        # networks may keep. With channels last, the networks are a third faster.
        return (volumes.to(scale.device) * scale).contiguous(memory_format=torch.channels_last)


class _SplatAbout(torch.autograd.Function):
    """The step from landmarks (N, 2) to volumes (N, C, H, W), with its gradient."""

    @staticmethod
    def forward(
        ctx: Any,
        landmarks: torch.Tensor,
        volumes: BatchVolumes,
        windows: Windows,
        draws: Draws | None,
    ) -> torch.Tensor:
        ctx.volumes = volumes
        ctx.windows = windows
        ctx.draws = draws
        ctx.save_for_backward(landmarks)
        return torch.from_numpy(volumes(windows, draws, landmarks.detach().numpy()))

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None, None]:
        (landmarks,) = ctx.saved_tensors
        gradient = ctx.volumes.landmark_gradient(
            ctx.windows, ctx.draws, landmarks.detach().numpy(), gradients[0].contiguous().numpy()
        )
        return torch.from_numpy(gradient), None, None, None


class Logarithm(nn.Module):
    """The layer log(1 + x)."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.log1p(x)


def new_pipeline(
    config: TNTConfig,
    n_classes: int,
    seed: int,
    windows: Windows,
    network: str = "thesis",
    *,
    logarithm: bool = False,
    grid: tuple[int, int] | None = None,
) -> Pipeline:
    """A pipeline with PyTorch's initial weights, and with input scales measured on `windows`.

    The weights depend on the seed alone. Torch's global generator is left as it was.

    Parameters
    ----------
    config : how events become volumes.
    n_classes : number of classes.
    seed : decides the weights.
    windows : the windows that input scales are measured on.
    network : the classifier, see `build_network`.
    logarithm : whether the classifier takes log(1 + volume). Then the volume is not scaled.
    grid : the grid of the classifier's input; by default the grid of `config`. Scenes have a larger
        grid.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed % (1 << 63))
        classifier = build_network(network, config.channels, grid or config.grid, n_classes)
        regressor = landmark_network(config.channels) if config.needs_regressor else None
    scales = input_scales(config, windows)
    if logarithm:
        classifier = nn.Sequential(OrderedDict(logarithm=Logarithm(), network=classifier))
        scales["scale"] = 1.0
    return Pipeline(config, classifier, regressor, **scales)


def check_network(
    name: str, config: TNTConfig, n_classes: int = 2, *, everywhere: bool = False
) -> None:
    """Refuse a network that cannot be trained, before the training begins.

    Parameters
    ----------
    name : see `build_network`.
    config : configuration of the volumes that the network takes.
    n_classes : number of classes.
    everywhere : whether the network must compute a map.

    Raises
    ------
    ValueError : the network cannot be built for this configuration, has no compiled form, takes no
        batch, or computes a map although `everywhere` is False, or no map although it is True.
    """
    network = build_network(name, config.channels, config.grid, n_classes)
    # The landmark does not matter here. Landmark `regressor` would need a second network, and
    # `remove_flow` needs landmark `line`.
    plain_config = config.replace(landmark="center", remove_flow=False)
    try:
        model = Model.from_torch(network, plain_config, [str(k) for k in range(n_classes)])
        network.train()(torch.zeros(2, *config.shape))
    except (NotImplementedError, RuntimeError) as error:
        raise ParameterValueError("network", f"{name}: {one_line(error)}") from None
    has_map = model.places is not None
    if everywhere == has_map:
        return
    wanted = "one logit for each class"
    if everywhere:
        wanted = "a map of a channel for each class and one for nothing"
    raise ParameterValueError(
        "network",
        f"{name} must compute {wanted}",
        f"{model.logits_shape} for {n_classes} classes",
    )


def input_scales(config: TNTConfig, windows: Windows) -> dict[str, float]:
    """The arguments `scale` and `raw_scale` of `Pipeline`, measured on `windows`."""
    if not config.needs_regressor:
        return {"scale": input_scale(config, windows)}
    # A new regressor puts every landmark at the centre. So both inputs are measured with it there.
    return {
        "scale": input_scale(config.replace(landmark="center"), windows),
        "raw_scale": input_scale(config.replace(landmark="center", transform="none"), windows),
    }


def input_scale(config: TNTConfig, windows: Windows) -> float:
    """1 / root mean square of all cells, over at most `N_MEASURED` windows.

    The scale is one number for all bins. A scale for each bin would fit the event rate of the
    training motions over time. It would amplify bins with few events (31 times in N-MNIST's first
    bin, after TNT), and be wrong for every other motion. With a scale for each bin, TNT does worse
    even on held-out digits in the training motions.
    """
    n = min(N_MEASURED, len(windows))
    indices = np.linspace(0, len(windows) - 1, n).astype(np.int64)
    measured = windows[np.unique(indices)]
    volumes = BatchVolumes(config)
    mean_squares = []
    for k in range(len(measured)):  # one after another, because all volumes together may be large
        volume = volumes(measured[k : k + 1])
        mean_squares.append(np.square(volume, dtype=np.float64).mean())
    return float(1.0 / np.sqrt(max(np.mean(mean_squares), 1e-12)))


def export(pipeline: Pipeline, classes: tuple[str, ...], config: TNTConfig | None = None) -> Model:
    """Turn a pipeline into the finished model, which takes volumes that are not scaled.

    The scales become part of the weights of the first layers:

        conv1(scale V) = w * (scale V) = (scale w) * V

    Parameters
    ----------
    pipeline : the trained networks.
    classes : names, one for each label from 0 on.
    config : how events become the volumes that the model takes; by default the pipeline's.

    Raises
    ------
    NotImplementedError : a network has operations without a compiled form. The message names the
        first of them.
    ValueError : the classifier does not compute one logit for each class, or a layer does not fit.
    """
    config = config or pipeline.config
    model = Model.from_torch(pipeline.classifier, config, classes, regressor=pipeline.regressor)
    weights = dict(model.weights)
    network = dict(model.network)
    for name, scale in ((CLASSIFIER, pipeline.scale), (REGRESSOR, pipeline.raw_scale)):
        if name not in network or scale == 1:
            continue
        tensor_names = first_weights(network[name])
        for tensor in tensor_names:
            weights[tensor] = weights[tensor] * scale.cpu().numpy()
        if not tensor_names:  # the scale becomes a layer of its own, the first one
            network[name], tensors = with_scaled_volume(
                name, network[name], weights, pipeline.config.channels, float(scale)
            )
            weights |= tensors
    return replace(model, weights=weights, network=network)


def first_weights(layers: Sequence[Layer]) -> list[str]:
    """The names of the convolution weights that multiply the volume, and can include its scale.

    The list is empty if a layer other than a convolution reads the volume, too, or if another layer
    uses the same weights.
    """
    readers = [layer for layer in layers if VOLUME in layer["inputs"]]
    names = [layer["weights"]["weight"] for layer in readers if layer["op"] == "conv"]
    all_names = [name for layer in layers for name in layer.get("weights", {}).values()]
    are_all_convolutions = len(names) == len(readers)
    are_used_once = all(all_names.count(name) == 1 for name in names)
    return names if are_all_convolutions and are_used_once else []


def pipeline_of(model: Model) -> Pipeline:
    """The pipeline of a model, from windows to logits, in evaluation mode."""
    return Pipeline(model.config, torch_classifier(model), torch_regressor(model)).eval()


def pipeline_before_export(model: Model, windows: Windows) -> Pipeline:
    """The pipeline with which a model is trained further: the inverse of `export`.

    Input scales are measured on `windows`. Batch norms keep the model's statistics.
    """
    scales = input_scales(model.config, windows)
    pipeline = Pipeline(model.config, torch_classifier(model), torch_regressor(model), **scales)
    network: Any
    with torch.no_grad():
        for network, scale in (
            (pipeline.classifier, pipeline.scale),
            (pipeline.regressor, pipeline.raw_scale),
        ):
            if network is None:
                continue
            tensor_names = first_weights(network.layers)
            for name in tensor_names:
                network.tensors[name] /= scale
            if not tensor_names:  # the network keeps its own scale
                scale.fill_(1.0)
    return pipeline
