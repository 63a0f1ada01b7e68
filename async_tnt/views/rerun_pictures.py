"""Events and volumes as pictures of bytes, small enough to send many a second."""

from __future__ import annotations

import math

import numpy as np

# Okabe and Ito's colours, told apart by the colour-blind too; bright ones, for the viewer is dark
ON_COLOUR, OFF_COLOUR = (230, 159, 0), (86, 180, 233)
NOTHING_COLOUR, GAP_COLOUR = (18, 20, 24), (70, 74, 80)
NOTHING, OFF, ON = 0, 1, 2
"""Cells of an event image."""
MOST_SHEET_PIXELS = 1 << 17


def event_image(events: np.ndarray, sensor: tuple[int, int]) -> np.ndarray:
    """Which polarity each pixel's newest event had.

    Parameters
    ----------
    events : structured array with x, y, p; checked, in order of arrival.
    sensor : (width, height) in pixels.

    Returns
    -------
    uint8, shape (height, width), indexed [y, x]: NOTHING, OFF or ON.
    """
    image = np.zeros((sensor[1], sensor[0]), np.uint8)
    image[events["y"], events["x"]] = OFF + events["p"]  # of several at one pixel NumPy keeps the last
    return image


def bin_sheet(volume: np.ndarray, most_pixels: int = MOST_SHEET_PIXELS) -> np.ndarray:
    """All bins of a volume side by side: row by row, the first one at the top left.

    The colour says the sign (ON positive, OFF negative), its brightness the square root of the value's share of the
    largest one in the volume: single events stay visible beside many.

    Parameters
    ----------
    volume : float32, shape (C, H, W).
    most_pixels : of the sheet, gaps not counted. A larger volume is reduced by a whole number, each of its blocks of
        cells shown by the largest value in it.

    Returns
    -------
    uint8, shape (height, width, 3): RGB.
    """
    channels = volume.shape[0]
    columns = math.ceil(math.sqrt(channels))
    rows = -(-channels // columns)
    factor = math.ceil(math.sqrt(volume.size / most_pixels))
    bins = _reduced(volume, factor) if factor > 1 else volume
    _, height, width = bins.shape
    largest = float(np.abs(bins).max())
    level = np.sqrt(np.abs(bins) / largest) if largest > 0 else np.zeros_like(bins)
    index = np.rint(np.copysign(level, bins) * 255).astype(np.int16) + 255
    sheet = np.empty((rows * (height + 1) - 1, columns * (width + 1) - 1, 3), np.uint8)
    sheet[:] = GAP_COLOUR
    for k in range(channels):
        top, left = k // columns * (height + 1), k % columns * (width + 1)
        sheet[top : top + height, left : left + width] = _PALETTE[index[k]]
    return sheet


def _reduced(volume: np.ndarray, factor: int) -> np.ndarray:
    """Each block of factor x factor cells as the one of the largest magnitude, with its sign."""
    channels, height, width = volume.shape
    rows, columns = -(-height // factor), -(-width // factor)
    padded = np.zeros((channels, rows * factor, columns * factor), volume.dtype)
    padded[:, :height, :width] = volume
    largest = padded[:, ::factor, ::factor].copy()
    for k in range(1, factor * factor):  # every k-th cell of all blocks at once: many times faster than block by block
        cells = padded[:, k // factor :: factor, k % factor :: factor]
        np.copyto(largest, cells, where=np.abs(cells) > np.abs(largest))
    return largest


def _palette() -> np.ndarray:
    """(511, 3): from OFF's colour over that of nothing to ON's."""
    level = np.linspace(0, 1, 256)[:, None]
    nothing = np.array(NOTHING_COLOUR, float)
    on, off = (nothing + level * (np.array(colour) - nothing) for colour in (ON_COLOUR, OFF_COLOUR))
    return np.rint(np.concatenate((off[:0:-1], on))).astype(np.uint8)


_PALETTE = _palette()


def class_colours(n: int) -> list[tuple[int, int, int]]:
    """A colour for each class: hues a golden angle apart, so that neighbours in the list differ, in three values."""
    colours = []
    for k in range(n):
        hue, value = k * 0.618034 % 1.0 * 6.0, (1.0, 0.75, 0.9)[k % 3]
        red, green, blue = abs(hue - 3) - 1, 2 - abs(hue - 2), 2 - abs(hue - 4)
        shares = (min(max(c, 0.0), 1.0) for c in (red, green, blue))
        r, g, b = (round(255 * value * (0.4 + 0.6 * share)) for share in shares)
        colours.append((r, g, b))
    return colours
