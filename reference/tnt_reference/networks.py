"""The two networks and the whole pipeline, events to logits, differentiable from end to end."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from torch import nn
from torch.nn import functional as F

from .images import time_image
from .landmarks import LANDMARKS
from .layers import heatmap_centroid
from .transform import tnt_coordinates
from .volume import check_bins, event_volume, tnt_volume
from .window import Column, check_polarity, check_size, until_newest

REPRESENTATIONS = ("volume", "count", "count_time", "mean_time", "time_surface")
"""What a `Pipeline` can make of events.

It is an event volume, an event volume of a single bin, or an image of times."""


class Classifier(nn.Module):
    """Event volume to logits: two convolutions and two fully connected layers.

        conv1 3x3 same, ReLU, 2x2 average pool
        conv2 3x3 same, ReLU, 2x2 average pool
        fc1, ReLU
        fc2

    Parameters
    ----------
    channels : number of the volume's channels: B, or 2B for split polarity.
    grid : (width, height) of the volume, at least 4 x 4. Pooling drops an odd side's last row or
        column (34 -> 17 -> 8).
    n_classes : how many logits.
    widths : how many outputs conv1, conv2 and fc1 have.

    References
    ----------
    Wang 2019, arXiv:1911.12801, the classifier: the order of layers. The thesis gives no widths;
    these are ours.
    """

    def __init__(
        self,
        channels: int = 9,
        grid: tuple[int, int] = (34, 34),
        n_classes: int = 10,
        widths: tuple[int, int, int] = (16, 32, 64),
    ) -> None:
        super().__init__()
        width, height = grid_for_two_pools(grid)
        self.channels = channels
        self.grid = (width, height)
        self.conv1 = nn.Conv2d(channels, widths[0], 3, padding="same")
        self.conv2 = nn.Conv2d(widths[0], widths[1], 3, padding="same")
        self.fc1 = nn.Linear(widths[1] * (height // 4) * (width // 4), widths[2])
        self.fc2 = nn.Linear(widths[2], n_classes)

    def forward(self, volume: torch.Tensor) -> torch.Tensor:
        """The logits of a volume: (N, C, H, W) -> (N, n_classes), or (C, H, W) -> (n_classes,)."""
        check_volume_shape(volume, self.channels, self.grid)
        a = F.avg_pool2d(F.relu(self.conv1(volume)), 2)  # (..., 16, H//2, W//2)
        a = F.avg_pool2d(F.relu(self.conv2(a)), 2)  # (..., 32, H//4, W//4)
        a = a.flatten(-3)  # (..., 32 (H//4) (W//4)), channel by channel, row by row
        logits: torch.Tensor = self.fc2(F.relu(self.fc1(a)))
        return logits


class LandmarkRegressor(nn.Module):
    """A network from a raw event volume to a landmark.

    The landmark is the centroid of a heatmap, which three 3x3 and one 1x1 convolution draw.

        h = exp(heatmap(ReLU(conv3(ReLU(conv2(ReLU(conv1(V))))))))   non-negative, (H, W)
        l = sum_{y,x} h[y, x] (x, y) / sum_{y,x} h[y, x]             in pixels of the whole image

    The thesis does not say how its heatmap is kept non-negative, nor with which weights the network
    starts; both are our choice. With `exp`, the centroid is the expectation under a softmax over
    all pixels, which training can make as sharp as it needs. The 1x1 convolution starts at zero: h
    is 1 everywhere, and the first landmark is exactly the image centre for all events. Therefore
    only the 1x1 convolution has a gradient at the first step; from the second step on, all layers
    have a gradient. The 1x1 convolution has no bias: a constant added to the exponent does not
    change the centroid.

    Parameters
    ----------
    channels : number of the volume's channels: B, or 2B for split polarity.
    grid : (width, height) of the volume.
    n_filters : how many outputs each 3x3 convolution has. It is our choice; the thesis gives none.

    References
    ----------
    Wang 2019, arXiv:1911.12801, the landmark regression network, row "TNT+regress".
    """

    def __init__(
        self, channels: int = 9, grid: tuple[int, int] = (34, 34), n_filters: int = 20
    ) -> None:
        super().__init__()
        self.channels = channels
        self.grid = check_size("grid", grid, smallest=2)
        self.conv1 = nn.Conv2d(channels, n_filters, 3, padding="same")
        self.conv2 = nn.Conv2d(n_filters, n_filters, 3, padding="same")
        self.conv3 = nn.Conv2d(n_filters, n_filters, 3, padding="same")
        self.heatmap = nn.Conv2d(n_filters, 1, 1, bias=False)
        nn.init.zeros_(self.heatmap.weight)

    def forward(self, volume: torch.Tensor) -> torch.Tensor:
        """The landmark of a raw `volume`, float64, (x, y) in grid pixels.

        A volume (N, C, H, W) has landmarks (N, 2), a volume (C, H, W) has a landmark (2,).
        """
        check_volume_shape(volume, self.channels, self.grid)
        a = F.relu(self.conv1(volume))  # (..., n_filters, H, W), as are the next two
        a = F.relu(self.conv2(a))
        a = F.relu(self.conv3(a))
        return heatmap_centroid(self.heatmap(a))


class Pipeline(nn.Module):
    """A module from the events of one window to logits: landmark, transform, volume, classifier.

    A window is given by the columns `t`, `x`, `y`, `p` of its N events and by its start,
    `start_us`.

    Parameters
    ----------
    classifier : a module from (N, C, H, W) to (N, n_classes); `Classifier` or your own.
    sensor, grid : (width, height); by default the grid has the size of the sensor.
    window_us : the window's length; None: each window ends with its newest event, as in the thesis.
    bins, t_max, polarity, remove_flow : see `tnt_volume`.
    landmark : "center", "running", "line", "window"; or "regressor".
    transform : "tnt", or "none" for the raw event volume (the baseline; the landmark then has no
        effect).
    representation : "volume"; "count", an event volume of one bin; or an image of times, see
        `time_image`, without the transform.
    regressor : the network behind landmark "regressor" (`LandmarkRegressor` or a module from (N, C,
        H, W) to (N, 2)): it sees the raw event volume of the same window, and learns through the
        transform.

    Raises
    ------
    ValueError, TypeError : the settings do not fit together; or, in a call, the events are invalid.
    """

    def __init__(
        self,
        classifier: nn.Module,
        *,
        sensor: tuple[int, int],
        window_us: int | None,
        grid: tuple[int, int] | None = None,
        bins: int = 9,
        t_max: float = 8.0,
        polarity: str = "signed",
        landmark: str = "running",
        transform: str = "tnt",
        remove_flow: bool = False,
        representation: str = "volume",
        regressor: nn.Module | None = None,
    ) -> None:
        super().__init__()
        _check_representation(representation, bins, transform)
        _check_landmark(landmark, regressor)
        self.classifier = classifier
        self.regressor = regressor
        self.sensor = check_size("sensor", sensor, smallest=2)
        self.grid = check_size("grid", grid if grid is not None else sensor, smallest=2)
        self.window_us = window_us
        self.bins = check_bins(bins)
        self.t_max = t_max
        self.polarity = polarity
        self.landmark = landmark
        self.transform = transform
        self.remove_flow = remove_flow
        self.representation = representation
        check_polarity(polarity)
        self._check_transform()
        self._check_networks()

    def _check_transform(self) -> None:
        """Check the settings of the transform, which raises their errors even without events."""
        tnt_coordinates(
            [],
            [],
            [],
            start_us=0,
            window_us=self.duration_us([], 0),
            sensor=self.sensor,
            grid=self.grid,
            t_max=self.t_max,
            landmark=(0.0, 0.0) if self.landmark == "regressor" else self.landmark,
            remove_flow=self.remove_flow,
        )

    def _check_networks(self) -> None:
        """Refuse a network that is built for other volumes."""
        channels = 2 * self.bins if self.polarity == "split" else self.bins
        for name, network in (("classifier", self.classifier), ("regressor", self.regressor)):
            expected = (getattr(network, "channels", channels), getattr(network, "grid", self.grid))
            if expected != (channels, self.grid):
                raise ValueError(
                    f"the {name} is built for (channels, grid) {expected}, these settings give "
                    f"{(channels, self.grid)}"
                )

    def duration_us(self, t: Column, start_us: int) -> int:
        """The length, in microseconds, of the window of the times `t` that starts at `start_us`."""
        if self.window_us is None:
            return until_newest(t, start_us)
        return self.window_us

    def volume(self, t: Column, x: Column, y: Column, p: Column, start_us: int) -> torch.Tensor:
        """The classifier's input for one window, (C, H, W), in the type of the weights."""
        if self.transform == "none":
            return self.raw_volume(t, x, y, p, start_us)
        landmark: str | torch.Tensor = self.landmark
        if self.regressor is not None:
            landmark = self.regressor(self.raw_volume(t, x, y, p, start_us)[None])[0]  # (2,)
        return tnt_volume(
            t,
            x,
            y,
            p,
            start_us=start_us,
            window_us=self.duration_us(t, start_us),
            sensor=self.sensor,
            grid=self.grid,
            bins=self.bins,
            t_max=self.t_max,
            polarity=self.polarity,
            landmark=landmark,
            remove_flow=self.remove_flow,
            dtype=self.dtype,
        )

    def raw_volume(self, t: Column, x: Column, y: Column, p: Column, start_us: int) -> torch.Tensor:
        """The untransformed event volume of one window, or its image of times, (C, H, W)."""
        settings: dict[str, Any] = {
            "start_us": start_us,
            "window_us": self.duration_us(t, start_us),
            "sensor": self.sensor,
            "grid": self.grid,
            "polarity": self.polarity,
            "dtype": self.dtype,
        }
        if self.representation in ("volume", "count"):
            return event_volume(t, x, y, p, bins=self.bins, **settings)
        return time_image(t, x, y, p, representation=self.representation, **settings)

    @property
    def dtype(self) -> torch.dtype:
        """The type of the networks' weights."""
        return next((w.dtype for w in self.parameters()), torch.get_default_dtype())

    def forward(self, t: Column, x: Column, y: Column, p: Column, start_us: int) -> Any:
        """The logits (n_classes,) of the window that starts at `start_us`.

        If the classifier returns a tuple of tensors, so does this.
        """
        answer = self.batch([(t, x, y, p, start_us)])
        if isinstance(answer, tuple):
            return tuple(tensor[0] for tensor in answer)
        return answer[0]

    def batch(self, windows: Iterable[Sequence[Column]]) -> Any:
        """The logits (N, n_classes) of N `windows`, each `(t, x, y, p, start_us)`.

        If the classifier returns a tuple of tensors (N, ...), so does this.
        """
        volumes = [self.volume(*window) for window in windows]  # N of (C, H, W)
        if not volumes:
            raise ValueError("`windows` must hold at least one (t, x, y, p, start_us), got none")
        return self.classifier(torch.stack(volumes))


def _check_representation(representation: str, bins: int, transform: str) -> None:
    if representation not in REPRESENTATIONS:
        raise ValueError(
            f"`representation` must be one of {', '.join(REPRESENTATIONS)}, got {representation!r}"
        )
    if representation == "count" and bins != 1:
        raise ValueError(f"`bins` must be 1 with representation 'count', got {bins}")
    if representation not in ("volume", "count") and transform != "none":
        raise ValueError(
            f"`transform` must be 'none' with representation {representation!r}, got {transform!r}"
        )
    if transform not in ("tnt", "none"):
        raise ValueError(f"`transform` must be 'tnt' or 'none', got {transform!r}")


def _check_landmark(landmark: str, regressor: nn.Module | None) -> None:
    if landmark not in (*LANDMARKS, "regressor"):
        raise ValueError(
            f"`landmark` must be one of {', '.join(LANDMARKS)}, regressor; got {landmark!r}"
        )
    if (landmark == "regressor") != (regressor is not None):
        raise ValueError(
            f"landmark 'regressor' and a `regressor` network go together: got landmark "
            f"{landmark!r} and regressor {type(regressor).__name__}"
        )


def grid_for_two_pools(grid: tuple[int, int]) -> tuple[int, int]:
    """The grid. If its sides cannot be halved twice, this raises a ValueError."""
    width, height = check_size("grid", grid, smallest=2)
    if min(width, height) < 4:
        raise ValueError(
            f"`grid` must have sides of at least 4 pixels, to be halved twice, got {width, height}"
        )
    return width, height


def check_volume_shape(volume: torch.Tensor, channels: int, grid: tuple[int, int]) -> None:
    """Refuse a volume with another number of channels, or with other sides."""
    expected = (channels, grid[1], grid[0])
    if volume.ndim not in (3, 4) or tuple(volume.shape[-3:]) != expected:
        raise ValueError(
            f"`volume` must have shape (C, H, W) or (N, C, H, W) with (C, H, W) = {expected}, got "
            f"{tuple(volume.shape)}"
        )
