"""From windows to logits, trainable from end to end: volumes from the kernels, networks in torch.

    events -> volume -> classifier                                             every landmark but one
    events -> raw volume -> regressor -> landmark -> volume -> classifier      landmark `regressor`

In the second way the loss reaches the regressor through the volume, by `gather.landmark_gradients`: a volume
has two numbers to learn, its landmark's, so that the way back costs about as much as the splat.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tnt_reference import Classifier, LandmarkRegressor
from torch import nn

from async_tnt.config import TNTConfig

from .augment import Draws
from .batches import BatchVolumes
from .windows import Windows

FLOOR = 1e-3  # of the largest channel scale: bins that are nearly always empty are not blown up


class Pipeline(nn.Module):
    """Windows to logits.

    Parameters
    ----------
    config : how events become volumes.
    classifier : (N, C, H, W) -> (N, n_classes).
    regressor : with landmark `regressor`: (N, C, H, W), raw volumes, -> (N, 2), landmarks in grid pixels.
    scale, raw_scale : what each channel of the classifier's and of the regressor's input is multiplied with
        first, shape (C,); ones by default.
    """

    scale: torch.Tensor
    raw_scale: torch.Tensor

    def __init__(
        self, config: TNTConfig, classifier: nn.Module, regressor: nn.Module | None = None,
        *, scale: np.ndarray | None = None, raw_scale: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        super().__init__()
        if config.needs_regressor != (regressor is not None):
            raise ValueError(
                f"landmark 'regressor' and a `regressor` network go together: got landmark {config.landmark!r}, "
                f"transform {config.transform!r} and regressor {type(regressor).__name__}"
            )
        self.config, self.classifier, self.regressor = config, classifier, regressor
        ones = np.ones(config.channels, np.float32)
        self.register_buffer("scale", torch.from_numpy(ones if scale is None else scale)[:, None, None].clone())
        self.register_buffer(
            "raw_scale", torch.from_numpy(ones if raw_scale is None else raw_scale)[:, None, None].clone()
        )
        self._volumes = BatchVolumes(config)
        self._raw_volumes = BatchVolumes(config.replace(landmark="center", transform="none", remove_flow=False))

    def forward(self, windows: Windows, draws: Draws | None = None) -> torch.Tensor:
        """Logits (N, n_classes) of N windows, varied as `draws` say."""
        logits: torch.Tensor = self.classifier(self._on_device(self.volumes(windows, draws), self.scale))
        return logits.float()

    def volumes(self, windows: Windows, draws: Draws | None = None) -> torch.Tensor:
        """(N, C, H, W): what the classifier sees, but for `scale`."""
        if self.regressor is None:
            return torch.from_numpy(self._volumes(windows, draws))
        landmarks = self.landmarks(windows, draws)
        volumes: torch.Tensor = _SplatAbout.apply(landmarks.cpu(), self._volumes, windows, draws)
        return volumes

    def landmarks(self, windows: Windows, draws: Draws | None = None) -> torch.Tensor:
        """(N, 2): the regressor's landmarks, float64, in grid pixels."""
        if self.regressor is None:
            raise ValueError(f"only landmark 'regressor' has landmarks of its own, got {self.config.landmark!r}")
        raw = torch.from_numpy(self._raw_volumes(windows, draws))
        landmarks: torch.Tensor = self.regressor(self._on_device(raw, self.raw_scale))
        return landmarks.double()

    def _on_device(self, volumes: torch.Tensor, scale: Any) -> torch.Tensor:
        # A new array: the kernels write the next batch into the old one. Channels last is a third faster.
        return (volumes.to(scale.device) * scale).contiguous(memory_format=torch.channels_last)


class _SplatAbout(torch.autograd.Function):
    """Landmarks (N, 2) to volumes (N, C, H, W), differentiable with respect to the landmarks."""

    @staticmethod
    def forward(
        ctx: Any, landmarks: torch.Tensor, volumes: BatchVolumes, windows: Windows, draws: Draws | None
    ) -> torch.Tensor:
        ctx.volumes, ctx.windows, ctx.draws = volumes, windows, draws
        ctx.save_for_backward(landmarks)
        return torch.from_numpy(volumes(windows, draws, landmarks.detach().numpy()))

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None, None]:
        (landmarks,) = ctx.saved_tensors
        gradient = ctx.volumes.landmark_gradient(
            ctx.windows, ctx.draws, landmarks.detach().numpy(), gradients[0].contiguous().numpy()
        )
        return torch.from_numpy(gradient), None, None, None


def new_pipeline(config: TNTConfig, n_classes: int, seed: int, windows: Windows) -> Pipeline:
    """The thesis' networks with PyTorch's initial weights, a function of the seed alone; input scales measured on
    `windows`.

    The regressor's last convolution starts at zero: the first landmark is the image centre. Torch's own
    generator is left as it was.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        classifier = Classifier(config.channels, config.grid, n_classes)
        regressor = LandmarkRegressor(config.channels, config.grid) if config.needs_regressor else None
    return Pipeline(config, classifier, regressor, **input_scales(config, windows))


def input_scales(config: TNTConfig, windows: Windows) -> dict[str, np.ndarray]:
    """The arguments `scale` and `raw_scale` of `Pipeline`, measured on `windows`."""
    if not config.needs_regressor:
        return {"scale": channel_scale(config, windows)}
    # The landmarks start at the centre, so that is where the classifier's input is measured.
    return {
        "scale": channel_scale(config.replace(landmark="center"), windows),
        "raw_scale": channel_scale(config.replace(landmark="center", transform="none"), windows),
    }


def channel_scale(config: TNTConfig, windows: Windows, n: int = 512) -> np.ndarray:
    """1 / root mean square of each channel, over `n` windows spread evenly: float32, shape (C,).

    Cells are mostly zero and late TNT bins, where all events crowd in the middle, are far larger than early
    ones. A fixed factor per channel evens that out and is no part of the finished network: see `export`.
    """
    some = windows[np.unique(np.linspace(0, len(windows) - 1, min(n, len(windows))).astype(np.int64))]
    volumes = BatchVolumes(config)(some)
    mean_square = np.square(volumes, dtype=np.float64).mean(axis=(0, 2, 3))
    mean_square = np.maximum(mean_square, FLOOR * mean_square.max())
    return (1.0 / np.sqrt(np.maximum(mean_square, 1e-12))).astype(np.float32)
