"""Learn a mask of hot pixels: those with far more events than what moves in front of them can explain.

Let n be a pixel's count of events in a recording. A plausible count for it is

    plausible = max(neighbours, mean, 1)

    neighbours   the 4th largest count among the other pixels of the 5x5 block around it (at the sensor's border the
                 block is shifted inwards): a moving edge, even a line one pixel wide that moves along itself, passes at
                 least four of them. A median, as in image filters, would mistake such lines for hot pixels.
    mean         the mean count of all pixels: in a still scene neighbours say nothing
    1            a single event is no evidence

and the pixel is hot if both hold:

    n > factor * plausible                                           far above
    n log(n / plausible) - (n - plausible) > log(N / false_alarms)   and not by chance

The second is Chernoff's bound on a Poisson count, P(count >= n) <= exp(n - plausible) (plausible / n)^n, so that among
the N pixels of the sensor fewer than `false_alarms` pass it by chance. Hot pixels raise the mean and hide weaker ones
nearby: the search is repeated, with the count `neighbours` for those found, until it finds no more. (A count of zero
would break a line in two, and the rest would be found next, pixel by pixel.)

Five or more equally hot pixels in one 5x5 block explain one another and are not found: a flickering lamp looks the
same. Conversely, something small and bright that visits one pixel all the time looks like a hot pixel: learn from
recordings in which things move, or of a still scene, with some thousand events at least.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numba import int64, uint16
from numpy.lib.stride_tricks import sliding_window_view

from async_tnt.events import EventDecoder
from async_tnt.kernels.jit import compile_only
from async_tnt.kernels.pixels import count_events
from async_tnt.sources.sensor import checked_sensor

BLOCK = 5
RANK = 4
FACTOR = 5.0
FALSE_ALARMS = 0.01


def learn_mask(
    source: Iterable[Any], sensor: tuple[int, int], *, factor: float = FACTOR, false_alarms: float = FALSE_ALARMS
) -> np.ndarray:
    """Find the hot pixels of a recording.

    A pixel with n events is hot if both hold:

        n > factor * plausible
        n log(n / plausible) - (n - plausible) > log(pixels / false_alarms)

    where a plausible number is the largest of three: the 4th largest among the 24 pixels around it, the mean of all
    pixels, and 1. The search is repeated until no more are found.

    Parameters
    ----------
    source : packets, in any form that `async_tnt.event_forms` lists.
    sensor : (width, height) in pixels.
    factor : how many times more events than plausible a hot pixel has, above 1.
    false_alarms : pixels expected to be found by chance, over the whole sensor.

    Returns
    -------
    bool, shape (H, W), True where a pixel is hot: what `PixelFilter(mask=)` takes.

    Raises
    ------
    ValueError, TypeError : wrong settings, or invalid events.

    Example
    -------
    >>> from async_tnt.sources import open_recording, sample_recordings
    >>> recording = open_recording(sample_recordings()[3])
    >>> int(learn_mask(recording, (34, 34)).sum())
    0
    >>> stuck = ([1000 * k for k in range(200)], [30] * 200, [5] * 200, [1] * 200)
    >>> np.argwhere(learn_mask([*recording, stuck], (34, 34))).tolist()  # (y, x)
    [[5, 30]]
    """
    _check(factor, false_alarms)
    return hot_pixels(count_pixels(source, sensor), factor=factor, false_alarms=false_alarms)


def count_pixels(source: Iterable[Any], sensor: tuple[int, int]) -> np.ndarray:
    """Events of each pixel in a `source` of packets: int64, shape (H, W) of the `sensor` (width, height)."""
    compile_only(count_events, uint16[::1], uint16[::1], int64, int64[:, ::1])
    width, height = checked_sensor(sensor)
    decoder = EventDecoder((width, height))
    counts = np.zeros((height, width), np.int64)
    for events in source:
        _, x, y, _, n = decoder.decode(events)
        count_events(x, y, n, counts)
    return counts


def hot_pixels(counts: np.ndarray, *, factor: float = FACTOR, false_alarms: float = FALSE_ALARMS) -> np.ndarray:
    """`learn_mask`, with its `factor` and `false_alarms`, from the `counts` of events: int64, shape (H, W)."""
    _check(factor, false_alarms)
    hot = np.zeros(counts.shape, bool)
    if counts.size == 0:
        return hot
    chance = math.log(counts.size / false_alarms)
    rest = counts.copy()
    while True:
        mean = max(1.0, rest.mean())
        y, x = np.nonzero(rest > factor * mean)
        n = rest[y, x].astype(np.float64)
        neighbours = _neighbours(rest, y, x)
        plausible = np.maximum(mean, neighbours)
        found = (n > factor * plausible) & (n * np.log(n / plausible) - (n - plausible) > chance)
        if not found.any():
            return hot
        y, x = y[found], x[found]
        hot[y, x] = True
        rest[y, x] = neighbours[found]


def _neighbours(counts: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The 4th largest count in the 5x5 block around each pixel, itself not counted.

    The pixel stays in its block: if it is larger than its 4th largest neighbour, that is the 5th largest count of the
    block; if not, the 5th largest of the block is no smaller than the pixel, which is then not hot.
    """
    height, width = (min(BLOCK, side) for side in counts.shape)
    blocks = sliding_window_view(counts, (height, width))
    top = np.clip(y - BLOCK // 2, 0, blocks.shape[0] - 1)
    left = np.clip(x - BLOCK // 2, 0, blocks.shape[1] - 1)
    rank = min(RANK, height * width - 1)
    return np.sort(blocks[top, left].reshape(y.size, height * width), axis=1)[:, -1 - rank]


def _check(factor: float, false_alarms: float) -> None:
    if not (math.isfinite(factor) and factor > 1):
        raise ValueError(f"`factor` must be above 1, got {factor}")
    if not (math.isfinite(false_alarms) and false_alarms > 0):
        raise ValueError(f"`false_alarms` must be above 0, got {false_alarms}")
