"""What recordings tell of their sensor: thresholds of ON against OFF, refractory time, noise,
after-pulses.

How large the thresholds are, the events do not tell: contrast is measured in thresholds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from async_tnt.simulation.simulator import AFTER_US

Columns = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""t, x, y, p of one window's events, in order; t in microseconds since the window's start. May have
those of its neighbours, too: before 0, and from the window's end on."""

LARGEST_RATIO = 4.0
REFRACTORY_SHARE = 0.01
"""Share of the intervals between a pixel's events that may be shorter than the longest possible
refractory time."""


@dataclass(frozen=True)
class MeasuredPixels:
    """The pixels of a sensor, as far as its events tell.

    Parameters
    ----------
    step_on, step_off : thresholds of ON and OFF events; their product is 1.
    refractory_us : time that a pixel is held in reset after an event.
    noise_hz : events per pixel and second where nothing moves.
    noise_on_share : share of these that are ON.
    after_share : share of events with an after-pulse.
    """

    step_on: float = 1.0
    step_off: float = 1.0
    refractory_us: float = 0.0
    noise_hz: float = 0.0
    noise_on_share: float = 0.5
    after_share: float = 0.0


def part_of(window: Columns, window_us: int, span: int = 1) -> Columns:
    """The events of `span` windows with `window` in their middle; times since the first one's
    start."""
    t, x, y, p = window
    before_us = (span - 1) // 2 * window_us
    first, last = np.searchsorted(t, (-before_us, window_us + before_us))
    return t[first:last] + before_us, x[first:last], y[first:last], p[first:last]


def is_after_pulse(window: Columns) -> np.ndarray:
    """Which events follow one of the other sign at their pixel within `AFTER_US`: bool, (n,)."""
    t, x, y, p = window
    order = np.lexsort((y, x))  # stable: by pixel, and by time within each
    same = (np.diff(x[order]) == 0) & (np.diff(y[order]) == 0) & (p[order[1:]] != p[order[:-1]])
    after = np.zeros(len(t), bool)
    after[order[1:]] = same & (np.diff(t[order].astype(np.int64)) <= AFTER_US)
    return after


def measure_pixels(
    windows: Sequence[Columns], sensor: tuple[int, int], window_us: int
) -> MeasuredPixels:
    """Measure the pixels on some windows; the refractory time is the longest that the intervals
    allow.

    - Of an image that stays within the sensor, the light of all pixels together ends as it began.
      So ON and OFF events, but for noise, are to each other as their thresholds are not: step_on n_on = step_off n_off.
    - Noise is measured at pixels whose eight neighbours are all silent. Active pixels are counted,
      not their events, because some pixels fire all the time.
    """
    width, height = sensor
    n_on = n_off = n_lonely = n_quiet = n_after = 0
    n_lonely_on = 0.0
    intervals = [np.empty(0, np.int64)]
    for window in windows:
        after = is_after_pulse(window)
        n_after += int(after.sum())
        t, x, y, p = (column[~after] for column in window)
        pixel = y.astype(np.int64) * width + x
        counts = np.bincount(pixel, minlength=width * height).reshape(height, width)
        quiet = neighbours(counts).ravel() == 0
        lonely = quiet & (counts.ravel() > 0)
        n_quiet += int(quiet.sum())
        n_lonely += int(lonely.sum())
        n_lonely_on += float(
            (np.bincount(pixel, p, width * height)[lonely] / counts.ravel()[lonely]).sum()
        )
        n_on += int(p.sum())
        n_off += len(p) - int(p.sum())
        order = np.argsort(pixel, kind="stable")
        same = (np.diff(pixel[order]) == 0) & (np.diff(p[order].astype(np.int8)) == 0)
        intervals.append(np.diff(t[order].astype(np.int64))[same])
    # events of a pixel in a window, of a Poisson process
    noise = -np.log1p(-min(0.99, n_lonely / max(1, n_quiet)))
    noise_on_share = n_lonely_on / n_lonely if n_lonely else 0.5
    n_noise = noise * width * height * len(windows)
    # below it noise differs from what is expected of it by chance
    least = max(1.0, 3 * np.sqrt(n_on + n_off))
    ratio = max(least, n_off - (1 - noise_on_share) * n_noise) / max(
        least, n_on - noise_on_share * n_noise
    )
    step_on = float(np.sqrt(np.clip(ratio, 1 / LARGEST_RATIO, LARGEST_RATIO)))
    all_intervals = np.concatenate(intervals)
    shortest = float(np.quantile(all_intervals, REFRACTORY_SHARE)) if len(all_intervals) else 0.0
    after_share = n_after / max(1, n_on + n_off)
    noise_hz = float(noise / (window_us * 1e-6))
    return MeasuredPixels(step_on, 1 / step_on, shortest, noise_hz, noise_on_share, after_share)


def neighbours(counts: np.ndarray) -> np.ndarray:
    """The sum of each pixel's eight neighbours, (H, W)."""
    framed = np.pad(counts, 1)
    height, width = counts.shape
    total = sum(framed[i : i + height, j : j + width] for i in range(3) for j in range(3))
    return np.asarray(total - counts)
