"""Find the hot pixels of recordings.

A hot pixel has far more events than the things that move in front of it can explain. Let n be a
pixel's count of events in a recording. A plausible count for it is

    plausible = max(neighbours, mean, 1)

    neighbours   the 4th largest count among the other pixels of the 5x5 block around it (at the
                 sensor's border the block is shifted inwards). A moving edge, even a line one pixel
                 wide that moves along itself, passes at least four of them, except at its very
                 ends. A median, as in image filters, would mistake such lines for hot pixels.
    mean         the mean count of all pixels: in a still scene, neighbours say nothing
    1            a single event is no evidence

and the pixel is hot if both hold:

    n > 5 plausible                                          far above
    n log(n / plausible) - (n - plausible) > log(100 N)      not by chance

The second condition follows from Chernoff's bound on a Poisson count,

    P(count >= n) <= exp(n - plausible) (plausible / n)^n

so that chance makes one of the N pixels of a sensor hot in one of a hundred recordings.

Hot pixels raise the mean and hide weaker hot pixels nearby. So the search is repeated until it
finds no more. In the next search, each pixel found so far gets the largest count among the other
pixels of its block. (With a lower count the end of a line would move inwards, and the line would be
found pixel by pixel.)

Five or more hot pixels in one 5x5 block explain one another, and not all of them are found, because
a flickering lamp looks like hot pixels. Conversely, something small and bright that stays at one
pixel looks like a hot pixel. So learn from recordings in which things move, or from a still scene,
with some thousand events at least.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from async_tnt.kernels.sources.pixels import count_events
from async_tnt.volume.events import EventDecoder
from async_tnt.volume.sensor import checked_sensor, format_size

BLOCK = 5
"""Side, in pixels, of the block in which a pixel is compared with its neighbours."""

RANK = 4
"""Rank, among the neighbours' counts from the largest on, of the count that is plausible: a moving
edge passes at least this many neighbours."""

FACTOR = 5.0
"""A hot pixel has more than this multiple of its plausible count."""

FALSE_ALARMS = 0.01
"""Expected number of pixels of a whole sensor that chance makes hot."""

MAX_PIXELS = 1 << 24
"""Pixels of the largest sensor whose events are counted by pixel, which takes up to 40 bytes a
pixel. The largest event cameras have one or two million pixels; but a file of a few hundred bytes
may state a sensor with a thousand times more."""


def learn_mask(source: Iterable[Any], sensor: tuple[int, int]) -> np.ndarray:
    """Find the hot pixels of a recording.

    The head of `async_tnt.sources.pixels.hot_pixels` has the rule.

    Parameters
    ----------
    source : packets, in any form that `async_tnt.volume.event_forms` lists; read to its end.
    sensor : (width, height) in pixels.

    Returns
    -------
    bool, shape (H, W), True where a pixel is hot: what `PixelFilter(mask=)` takes.

    Raises
    ------
    ValueError, TypeError : `sensor` is invalid or has more than 2**24 pixels, or events are
        invalid.

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
    return hot_pixels(count_pixels(source, sensor))


def count_pixels(source: Iterable[Any], sensor: tuple[int, int]) -> np.ndarray:
    """The number of events at each pixel: int64, shape (H, W).

    Parameters
    ----------
    source : packets, as for `learn_mask`.
    sensor : (width, height), of 2**24 pixels at most.
    """
    width, height = checked_sensor(sensor)
    if width * height > MAX_PIXELS:
        size = format_size((width, height))
        raise ValueError(
            f"a sensor must have at most {MAX_PIXELS:,} pixels to count their events, got {size}"
        )
    decoder = EventDecoder((width, height))
    counts = np.zeros((height, width), np.int64)
    for events in source:
        _, x, y, _, n = decoder.decode(events)
        count_events(x, y, n, counts)
    return counts


def hot_pixels(counts: np.ndarray) -> np.ndarray:
    """Find the hot pixels, as `learn_mask`, from the number of events at each pixel.

    Parameters
    ----------
    counts : int64, shape (H, W).
    """
    hot = np.zeros(counts.shape, bool)
    least_evidence = math.log(counts.size / FALSE_ALARMS)
    plain_counts = counts
    while True:
        mean = max(1.0, plain_counts.mean())
        # Only these pixels can be hot, as `plausible` is at least the mean.
        y, x = np.nonzero((plain_counts > FACTOR * mean) & ~hot)
        n = plain_counts[y, x].astype(np.float64)
        plausible = np.maximum(mean, _largest(plain_counts, y, x, RANK))
        is_far_above = n > FACTOR * plausible
        evidence = n * np.log(n / plausible) - (n - plausible)
        is_not_by_chance = evidence > least_evidence
        is_hot = is_far_above & is_not_by_chance
        if not is_hot.any():
            return hot

        hot[y[is_hot], x[is_hot]] = True
        plain_counts = np.where(hot, 0, counts)
        y, x = np.nonzero(hot)
        plain_counts[y, x] = _largest(plain_counts, y, x, 0)


def listed_pixels(counts: np.ndarray, hot: np.ndarray) -> list[dict[str, int]]:
    """A dict for each hot pixel, with keys `x`, `y` and `events`, a count; busiest first."""
    pixels = [{"x": x, "y": y, "events": int(counts[y, x])} for y, x in np.argwhere(hot).tolist()]
    return sorted(pixels, key=lambda pixel: -pixel["events"])


def _largest(counts: np.ndarray, y: np.ndarray, x: np.ndarray, rank: int) -> np.ndarray:
    """The largest count in the 5x5 block around each pixel, after the `rank` largest ones.

    With a `rank` of four this stands for `neighbours`, although the block contains the pixel
    itself. If the pixel's count is larger than that of its 4th largest neighbour, the neighbour's
    count is the 5th largest count of the block. If it is not larger, both numbers are at least the
    pixel's own count, and with either of them the pixel is not hot.
    """
    height = min(BLOCK, counts.shape[0])
    width = min(BLOCK, counts.shape[1])
    blocks = sliding_window_view(counts, (height, width))
    top = np.clip(y - BLOCK // 2, 0, blocks.shape[0] - 1)
    left = np.clip(x - BLOCK // 2, 0, blocks.shape[1] - 1)
    rank = min(rank, height * width - 1)
    return np.sort(blocks[top, left].reshape(y.size, height * width), axis=1)[:, -1 - rank]
