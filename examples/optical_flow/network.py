"""The network: windows of events in, flow at each pixel out."""

from __future__ import annotations

from torch import nn

from async_tnt import TNTConfig

WINDOW_US = 30_000
"""Length of a window, in microseconds."""

HOP_US = 15_000
"""Distance between the starts of windows that overlap, in microseconds.

An answer then always has 15 to 30 ms of events, after the first 15 ms of a stream."""

BINS = 8
"""Time bins of a window."""

CHANNELS = (16, 32, 32, 32, 32)
"""Channels of the hidden convolutions."""

STRIDES = (2, 2, 1, 1, 1)
"""Strides of the hidden convolutions. Their product is 4: flow is computed for 4 x 4 pixels at
once, and enlarged."""


def flow_config(sensor: tuple[int, int]) -> TNTConfig:
    """How events become the volume that the network reads.

    sensor : (width, height). If a side is no multiple of four, the flow has up to three columns or
        rows more than the sensor.
    """
    return TNTConfig(
        sensor=sensor,
        grid=sensor,
        bins=BINS,
        window_us=WINDOW_US,
        polarity="signed",
        transform="none",
    )


def flow_network() -> nn.Sequential:
    """Six convolutions of 3x3: volumes (N, BINS, H, W) -> flow (N, 2, H, W), x before y."""
    layers: list[nn.Module] = []
    n_in = BINS
    for n_out, stride in zip(CHANNELS, STRIDES, strict=True):
        layers.append(nn.Conv2d(n_in, n_out, 3, stride, padding=1, bias=False))
        layers += [nn.BatchNorm2d(n_out), nn.ReLU()]
        n_in = n_out
    layers.append(nn.Conv2d(n_in, 2, 3, padding=1))
    layers.append(nn.Upsample(scale_factor=4, mode="bilinear", align_corners=False))
    return nn.Sequential(*layers)
