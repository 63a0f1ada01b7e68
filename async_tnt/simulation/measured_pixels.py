"""Measure a sensor's pixels on its recordings.

Measured are the ratio of the ON and the OFF threshold, the refractory time, noise and after-pulses.
The events do not tell how large the thresholds are. So contrast is measured in units of thresholds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from async_tnt.simulation.simulator import AFTER_US

Columns = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""t, x, y, p of one window's events, in order, with t in microseconds since the window's start.

Events of the neighbouring windows may be there, too: before 0, and at or after the window's end."""

LARGEST_RATIO = 4.0
"""Largest ratio of the ON and the OFF threshold, or of OFF and ON. Measured ratios beyond it are
cut off."""
REFRACTORY_SHARE = 0.01
"""The bound of the refractory time is this quantile of the intervals between a pixel's events. So
this share of the intervals may be shorter."""


@dataclass(frozen=True)
class MeasuredPixels:
    """The pixels of a sensor, as far as its events tell.

    Parameters
    ----------
    step_on, step_off : thresholds of ON and OFF events. Their unit is such that their product is 1.
    refractory_us : microseconds that a pixel is held in reset after an event.
    noise_hz : noise events per pixel and second, which occur where nothing moves.
    noise_on_share : share of the noise events that are ON.
    after_share : share of all events that an after-pulse follows.
    """

    step_on: float = 1.0
    step_off: float = 1.0
    refractory_us: float = 0.0
    noise_hz: float = 0.0
    noise_on_share: float = 0.5
    after_share: float = 0.0


def part_of(window: Columns, window_us: int, span: int = 1) -> Columns:
    """The events of `span` consecutive windows with `window` in their middle.

    Times count from the start of the first of these windows.
    """
    t, x, y, p = window
    before_us = (span - 1) // 2 * window_us
    first, last = np.searchsorted(t, (-before_us, window_us + before_us))
    return t[first:last] + before_us, x[first:last], y[first:last], p[first:last]


def is_after_pulse(window: Columns) -> np.ndarray:
    """Which events are after-pulses: bool, (n,).

    An after-pulse follows an event of the other sign at its pixel within `AFTER_US`.
    """
    t, x, y, p = window
    # the sort is stable: the events of each pixel stay in order of time
    order = np.lexsort((y, x))
    is_same_pixel = (np.diff(x[order]) == 0) & (np.diff(y[order]) == 0)
    is_other_sign = p[order[1:]] != p[order[:-1]]
    is_soon = np.diff(t[order].astype(np.int64)) <= AFTER_US
    after = np.zeros(len(t), bool)
    after[order[1:]] = is_same_pixel & is_other_sign & is_soon
    return after


@dataclass
class _Counts:
    """Counts over several windows. After-pulses are only counted in `n_after`.

    Attributes
    ----------
    n_on, n_off : number of ON events and of OFF events.
    n_after : number of after-pulses.
    n_quiet : number of pixels, of all windows, whose eight neighbours have no events.
    n_lonely : number of quiet pixels that have events themselves.
    n_lonely_on : sum, over the lonely pixels, of the share of their events that are ON.
    intervals : an array for each window: the microseconds between consecutive events of the same
        pixel, if both have the same sign.
    """

    n_on: int = 0
    n_off: int = 0
    n_after: int = 0
    n_quiet: int = 0
    n_lonely: int = 0
    n_lonely_on: float = 0.0
    intervals: list[np.ndarray] = field(default_factory=list)

    def add(self, window: Columns, sensor: tuple[int, int]) -> None:
        """Add the counts of a window."""
        width, height = sensor
        is_after = is_after_pulse(window)
        t, x, y, p = [column[~is_after] for column in window]
        n_on = int(p.sum())
        self.n_after += int(is_after.sum())
        self.n_on += n_on
        self.n_off += len(p) - n_on

        pixel = y.astype(np.int64) * width + x
        counts = np.bincount(pixel, minlength=width * height)
        on_counts = np.bincount(pixel, p, width * height)
        quiet = neighbours(counts.reshape(height, width)).ravel() == 0
        lonely = quiet & (counts > 0)
        self.n_quiet += int(quiet.sum())
        self.n_lonely += int(lonely.sum())
        self.n_lonely_on += float((on_counts[lonely] / counts[lonely]).sum())

        # the sort is stable: the events of each pixel stay in order of time
        order = np.argsort(pixel, kind="stable")
        is_same_pixel = np.diff(pixel[order]) == 0
        is_same_sign = np.diff(p[order].astype(np.int8)) == 0
        intervals = np.diff(t[order].astype(np.int64))
        self.intervals.append(intervals[is_same_pixel & is_same_sign])


def measure_pixels(
    windows: Sequence[Columns], sensor: tuple[int, int], window_us: int
) -> MeasuredPixels:
    """Measure the pixels on some windows.

    - Thresholds: if an image stays within the sensor, the sum of log luminance over all pixels is
      the same before and after. So, but for noise, step_on n_on = step_off n_off: there are fewer
      events of the sign with the larger threshold.
    - Noise is measured at pixels whose eight neighbours have no events. The pixels with noise are
      counted, not their events, because some pixels fire all the time.
    - The refractory time is the longest that the intervals between a pixel's events allow.
    """
    width, height = sensor
    counts = _Counts()
    for window in windows:
        counts.add(window, sensor)
    n_on = counts.n_on
    n_off = counts.n_off

    # The mean number of noise events of a pixel in a window. Noise is a Poisson process, in which
    # a pixel stays without events with probability exp(-mean).
    noise = -np.log1p(-min(0.99, counts.n_lonely / max(1, counts.n_quiet)))
    noise_on_share = counts.n_lonely_on / counts.n_lonely if counts.n_lonely else 0.5
    n_noise = noise * width * height * len(windows)

    # by chance, the number of noise events may differ by this much from its expectation
    least = max(1.0, 3 * np.sqrt(n_on + n_off))
    moved_on = max(least, n_on - noise_on_share * n_noise)
    moved_off = max(least, n_off - (1 - noise_on_share) * n_noise)
    ratio = moved_off / moved_on
    step_on = float(np.sqrt(np.clip(ratio, 1 / LARGEST_RATIO, LARGEST_RATIO)))

    intervals = np.concatenate([np.empty(0, np.int64), *counts.intervals])
    shortest = float(np.quantile(intervals, REFRACTORY_SHARE)) if len(intervals) else 0.0
    return MeasuredPixels(
        step_on=step_on,
        step_off=1 / step_on,
        refractory_us=shortest,
        noise_hz=float(noise / (window_us * 1e-6)),
        noise_on_share=noise_on_share,
        after_share=counts.n_after / max(1, n_on + n_off),
    )


def neighbours(counts: np.ndarray) -> np.ndarray:
    """The sum of each pixel's eight neighbours, (H, W)."""
    framed = np.pad(counts, 1)
    height, width = counts.shape
    total = sum(framed[i : i + height, j : j + width] for i in range(3) for j in range(3))
    return np.asarray(total - counts)
