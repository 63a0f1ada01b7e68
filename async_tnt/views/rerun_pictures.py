"""What a view shows: events and volumes as small images of bytes, the newest decision as text."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from async_tnt.decision import Decision
from async_tnt.views.figure_style import shortened

# Okabe and Ito's colours, which colour-blind people can distinguish; bright ones, as the viewer is dark
ON_COLOUR, OFF_COLOUR = (230, 159, 0), (86, 180, 233)
NOTHING_COLOUR, GAP_COLOUR = (18, 20, 24), (70, 74, 80)
NOTHING, OFF, ON = 0, 1, 2
"""Cells of an event image."""
MOST_SHEET_PIXELS = 1 << 17

MOST_BARS = 12  # with more classes, the likeliest are shown
BAR_LENGTH = 14
MOST_LETTERS = 16  # of a class name next to its bar
EIGHTHS = " ▏▎▍▌▋▊▉"


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

    The colour shows the sign (ON positive, OFF negative), its brightness the square root of the value relative to the
    largest one in the volume: single events stay visible next to many.

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


def newest_text(decision: Decision, classes: Sequence[str]) -> str:
    """Markdown: the class of the open window at this moment.

    Parameters
    ----------
    decision : of any trigger.
    classes : the names, as many as there are probabilities.
    """
    if decision.events == 0:
        return "# no event\n\nThe window has no event yet."
    length_ms = (decision.time_us - decision.window_start_us) / 1e3
    return (
        f"# {plain(decision.label)}\n\nwith probability {decision.probability:.3f}, from {decision.events:,} events in "
        f"{length_ms:,.1f} ms\n\n```\n{bars(decision.probabilities, classes)}\n```"
    )


def bars(probabilities: np.ndarray, classes: Sequence[str]) -> str:
    """A line for each class: its name, a bar, the probability. All in the classes' order, or the likeliest first.

    Examples
    --------
    >>> print(bars(np.array([0.25, 0.75]), ["cat", "mouse"]))
    cat   ███▌           0.250
    mouse ██████████▌    0.750
    """
    shown = list(range(len(classes)))
    if len(classes) > MOST_BARS:
        shown = np.argsort(-probabilities, kind="stable")[:MOST_BARS].tolist()
    names = [_short(classes[k]) for k in shown]
    width = max(map(len, names))
    lines = []
    for name, k in zip(names, shown, strict=True):
        n_eighths = round(float(probabilities[k]) * BAR_LENGTH * 8)
        bar = "█" * (n_eighths // 8) + EIGHTHS[n_eighths % 8].strip()
        lines.append(f"{name:{width}} {bar:{BAR_LENGTH}} {probabilities[k]:.3f}")
    return "\n".join(lines)


def plain(text: str) -> str:
    """Markdown that shows the text itself, on one line."""
    return "".join(f"\\{c}" if c in r"\`*_{}[]<>()#+-.!|~&$" else c for c in " ".join(text.split()))


def _short(name: str) -> str:
    return shortened(" ".join(name.replace("`", "'").split()), MOST_LETTERS)  # three ` would end the block of bars
