"""Pictures of raw outputs: an array (C, H, W) of any meaning becomes an RGB image.

The shape alone says how an output is shown, see `kind_of`. What the numbers mean only their user
knows: two channels may be a flow, and one channel the reconstructed image of a scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

Kind = Literal["numbers", "grey", "directions", "channels"]

KIND_WORDS: dict[Kind, str] = {
    "numbers": "numbers",
    "grey": "one channel as grey",
    "directions": "two channels as directions",
    "channels": "the largest channel",
}
"""Kind of an output -> how it is shown, for titles."""

WHEEL_WORDS = "Directions: channel 0 right, 1 down"
"""The title of the legend of directions."""

NO_NUMBER = (100, 0, 30)
"""Colour of nan, a dark red. Nothing else has this colour in any picture."""

FIRST_COLOURS = (
    (170, 170, 170),
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (0, 114, 178),
    (213, 94, 0),
    (204, 121, 167),
)
"""Colours of the first channels: grey, and those of Okabe and Ito, which colour-blind people can
distinguish."""
MOST_COLOURS = 256
"""Number of different colours of channels. A further channel has the colour of an earlier one."""
GOLDEN = 0.618034
"""Step of the hue from channel to channel after the first ones. Hues stay far from each other."""

SHARE = 0.99
"""Share of the numbers that the range of colours reaches. The few most extreme ones would leave all
others pale."""


def kind_of(shape: Sequence[int]) -> Kind:
    """How an output of this shape is shown.

    - "numbers": a vector (N,), or a map of one place
    - "grey": one channel (1, H, W)
    - "directions": two channels (2, H, W), as arrows: the hue is the direction, and the saturation
      the length
    - "channels": three channels or more. Each place has the colour of its largest channel, as in a
      segmentation.
    """
    if len(shape) == 1 or shape[1] * shape[2] == 1:
        return "numbers"
    if shape[0] == 1:
        return "grey"
    return "directions" if shape[0] == 2 else "channels"


class Limits(NamedTuple):
    """The numbers at the ends of a range of colours."""

    lowest: float
    """The number that is black. For directions it is 0, which is white."""
    highest: float
    """The number that is white. For directions it is the length that has the full colour."""


def limits_of(arrays: Sequence[np.ndarray]) -> Limits:
    """The range of colours in which pictures of arrays of one shape can be compared.

    It reaches over 99 % of the finite numbers, or of the lengths of the arrows that are not zero.
    The numbers beyond it have the colours of its ends. The range of 100 numbers or fewer reaches
    over all of them. It is (0, 0) without a finite number, and for kinds that have no range.
    """
    kind = kind_of(arrays[0].shape)
    if kind not in ("grey", "directions"):
        return Limits(0.0, 0.0)
    values = np.stack(arrays).astype(np.float64)
    if kind == "directions":
        lengths = np.hypot(values[:, 0], values[:, 1])
        lengths = lengths[np.isfinite(lengths) & (lengths > 0)]
        highest = np.quantile(lengths, SHARE, method="higher") if lengths.size else 0.0
        return Limits(0.0, float(highest))

    values = values[np.isfinite(values)]
    if values.size == 0:
        return Limits(0.0, 0.0)
    lowest = np.quantile(values, (1 - SHARE) / 2, method="lower")
    highest = np.quantile(values, (1 + SHARE) / 2, method="higher")
    # if almost all numbers are the same, the few others decide
    if lowest == highest:
        lowest = values.min()
        highest = values.max()
    return Limits(float(lowest), float(highest))


def picture_of(array: np.ndarray, limits: Limits) -> np.ndarray:
    """The picture of an output of any kind but "numbers", see `kind_of`.

    Parameters
    ----------
    array : float32, shape (C, H, W). A nan has the colour `NO_NUMBER`. An inf lies beyond any
        limit.
    limits : see `limits_of`. They are not used for three channels or more.

    Returns
    -------
    uint8, shape (H, W, 3): RGB.
    """
    kind = kind_of(array.shape)
    if kind == "grey":
        return grey_picture(array[0], limits)
    if kind == "directions":
        return direction_picture(array, limits)
    return channel_colours(array.shape[0])[largest_channel(array)]


def grey_picture(values: np.ndarray, limits: Limits) -> np.ndarray:
    """A picture of numbers (H, W), from black to white: uint8, shape (H, W, 3).

    Where all numbers are the same, they are a middle grey.
    """
    lowest, highest = limits
    values = values.astype(np.float64)
    if lowest == highest:
        brightness = 0.5 + 0.5 * np.sign(values - lowest)
    else:
        brightness = np.clip((values - lowest) / (highest - lowest), 0, 1)
    return _finished(np.repeat(brightness[..., np.newaxis], 3, axis=2), np.isnan(values))


def direction_picture(arrows: np.ndarray, limits: Limits) -> np.ndarray:
    """A picture of arrows (2, H, W): uint8, shape (H, W, 3).

    The hue is the direction, from red for right by green for down. The saturation is the length, as
    a share of `limits.highest`.
    """
    right, down = arrows.astype(np.float64)
    length = np.hypot(right, down)
    with np.errstate(divide="ignore", invalid="ignore"):
        # with `highest` 0, zero has no share
        share = np.where(length == 0, 0, np.minimum(length / limits.highest, 1))
    is_nan = np.isnan(right) | np.isnan(down)
    turn = np.where(is_nan, 0, np.arctan2(down, right) / (2 * np.pi))
    hue = HUES[np.rint(turn * len(HUES)).astype(np.int64) % len(HUES)]
    return _finished(1 - share[..., np.newaxis] * (1 - hue), is_nan)


def _of_hue(turn: np.ndarray) -> np.ndarray:
    """The full colour of each hue, which is a share of a turn: from 0 to 1, shape (N, 3)."""
    sixths = 6 * turn[:, np.newaxis] + np.array((0, 4, 2))
    return np.clip(np.abs(sixths % 6 - 3) - 1, 0, 1)


HUES = _of_hue(np.arange(6 * 255) / (6 * 255))
"""The full colours of all directions. Eight bits have no more hues than these."""


def _finished(colours: np.ndarray, is_nan: np.ndarray) -> np.ndarray:
    """Colours from 0 to 1 as uint8, with `NO_NUMBER` where a number is nan."""
    colours[is_nan] = 0  # nan has no integer
    picture = np.rint(255 * colours).astype(np.uint8)
    picture[is_nan] = NO_NUMBER
    return picture


def largest_channel(array: np.ndarray) -> np.ndarray:
    """The number of the largest channel at each place of a map (C, H, W): int64, shape (H, W).

    Of equal channels it is the first. A channel that is nan is left out. Where all channels are
    nan, the number is C.
    """
    is_nan = np.isnan(array)
    largest = np.where(is_nan, -np.inf, array).argmax(axis=0)
    largest[is_nan.all(axis=0)] = array.shape[0]
    return largest


def channel_colours(n_channels: int) -> np.ndarray:
    """The colour of each channel, and then that of nan: uint8, shape (n_channels + 1, 3)."""
    n_further = MOST_COLOURS - len(FIRST_COLOURS)
    numbers = np.arange(n_further)
    full = _of_hue(GOLDEN * numbers % 1)
    # pale and full colours in turn, bright and dark ones in turn
    saturation = np.where(numbers % 2, 0.5, 0.9)[:, np.newaxis]
    value = np.where(numbers // 2 % 2, 0.6, 0.95)[:, np.newaxis]
    further = np.rint(255 * value * (1 - saturation * (1 - full)))
    colours = np.concatenate([FIRST_COLOURS, further])
    of_channels = colours[np.arange(n_channels) % MOST_COLOURS]
    return np.concatenate([of_channels, [NO_NUMBER]]).astype(np.uint8)


def wheel_picture(side: int, background: tuple[int, int, int]) -> np.ndarray:
    """The colours of all directions in a disc, as a legend: uint8, shape (side, side, 3).

    The middle is zero, and the rim has the full colour. `background` is the colour around it.
    """
    steps = np.linspace(-1, 1, side)
    arrows = np.stack(np.meshgrid(steps, steps))
    picture = direction_picture(arrows, Limits(0.0, 1.0))
    picture[np.hypot(*arrows) > 1] = background
    return picture


def limits_words(kind: Kind, limits: Limits) -> str:
    """The range of colours of a picture, for people; empty if the picture has none."""
    lowest, highest = limits
    if kind == "directions":
        return f"full colour from {highest:.3g} on" if highest > 0 else "full colour above 0"
    if kind == "grey":
        if lowest == highest:
            return f"middle grey {lowest:.3g}"
        return f"black {lowest:.3g}, white {highest:.3g}"
    return ""


def span_words(array: np.ndarray) -> str:
    """The least and the largest finite number of an output, for people."""
    finite = array[np.isfinite(array)]
    n_others = array.size - finite.size
    words = f"{finite.min():.4g} to {finite.max():.4g}" if finite.size else "no finite number"
    if n_others:
        words += f" ({n_others:,} nan or inf)"
    return words
