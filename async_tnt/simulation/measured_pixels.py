"""Measure a sensor's pixels on its recordings.

The measurement finds the ratio of the ON and the OFF threshold, the refractory time, the noise and
the after-pulses. The events do not tell how large the thresholds are. So contrast is measured in
units of the thresholds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from async_tnt.simulation.simulator import AFTER_US

Columns = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""t, x, y, p of one window's events, in order, with t in microseconds since the window's start.

Events of the neighbouring windows may be included, with times before 0, and at or after the
window's end."""

LARGEST_RATIO = 4.0
"""Largest ratio of the ON to the OFF threshold, or of OFF to ON. A larger measured ratio is set to
it."""
REFRACTORY_SHARE = 0.01
"""The upper bound of the refractory time is this quantile of the intervals between a pixel's
events. So this share of the intervals may be shorter."""


@dataclass(frozen=True)
class MeasuredPixels:
    """The parameters of a sensor's pixels, as far as events tell them.

    Parameters
    ----------
    step_on, step_off : thresholds of ON and OFF events. Their unit is such that their product is 1.
    refractory_us : microseconds that a pixel is held in reset after an event; 0 if it is not known.
    noise_hz : noise events per pixel and second. Noise occurs even where nothing moves.
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
    """The events of `span` consecutive windows. `window` is the middle one of them.

    Times count from the start of the first one.
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
    is_after = np.zeros(len(t), bool)
    is_after[order[1:]] = is_same_pixel & is_other_sign & is_soon
    return is_after


@dataclass
class _Counts:
    """Counts over several windows. After-pulses are only counted in `n_after`.

    A pixel is quiet in a window if its eight neighbours have no events. A quiet pixel is lonely if
    it has events itself.

    Attributes
    ----------
    n_on, n_off : number of ON events and of OFF events.
    n_after : number of after-pulses.
    n_quiet : number of quiet pixels, summed over the windows.
    n_lonely : number of lonely pixels, summed over the windows.
    sum_of_on_shares : sum over the lonely pixels: the share of a pixel's events that are ON.
    intervals : an array for each window: the microseconds between consecutive events of the same
        pixel, if both have the same sign.
    """

    n_on: int = 0
    n_off: int = 0
    n_after: int = 0
    n_quiet: int = 0
    n_lonely: int = 0
    sum_of_on_shares: float = 0.0
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
        is_quiet = sum_of_neighbours(counts.reshape(height, width)).ravel() == 0
        is_lonely = is_quiet & (counts > 0)
        self.n_quiet += int(is_quiet.sum())
        self.n_lonely += int(is_lonely.sum())
        self.sum_of_on_shares += float((on_counts[is_lonely] / counts[is_lonely]).sum())

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
      the same before and after the motion. So without noise step_on n_on = step_off n_off, which
      gives the ratio of the thresholds.
    - Noise is measured at pixels whose eight neighbours have no events. The pixels with noise are
      counted, not their events, because some pixels fire all the time.
    - The refractory time is the longest one that the intervals between a pixel's events allow.
    """
    width, height = sensor
    counts = _Counts()
    for window in windows:
        counts.add(window, sensor)
    n_on = counts.n_on
    n_off = counts.n_off

    # The mean number of noise events of a pixel in a window. Noise is a Poisson process, in which
    # a pixel stays without events with probability exp(-mean).
    noise_a_pixel = -np.log1p(-min(0.99, counts.n_lonely / max(1, counts.n_quiet)))
    noise_on_share = counts.sum_of_on_shares / counts.n_lonely if counts.n_lonely else 0.5
    n_noise = noise_a_pixel * width * height * len(windows)

    # The numbers of ON and of OFF events that are not noise. By chance, a number of noise events
    # may differ from its expectation by about `least`. So a smaller difference tells nothing.
    least = max(1.0, 3 * np.sqrt(n_on + n_off))
    n_signal_on = max(least, n_on - noise_on_share * n_noise)
    n_signal_off = max(least, n_off - (1 - noise_on_share) * n_noise)
    ratio = n_signal_off / n_signal_on
    step_on = float(np.sqrt(np.clip(ratio, 1 / LARGEST_RATIO, LARGEST_RATIO)))

    intervals = np.concatenate([np.empty(0, np.int64), *counts.intervals])
    refractory_us = float(np.quantile(intervals, REFRACTORY_SHARE)) if len(intervals) else 0.0
    return MeasuredPixels(
        step_on=step_on,
        step_off=1 / step_on,
        refractory_us=refractory_us,
        noise_hz=float(noise_a_pixel / (window_us * 1e-6)),
        noise_on_share=noise_on_share,
        after_share=counts.n_after / max(1, n_on + n_off),
    )


def sum_of_neighbours(counts: np.ndarray) -> np.ndarray:
    """The sum of the counts of each pixel's eight neighbours, (H, W)."""
    framed = np.pad(counts, 1)
    height, width = counts.shape
    total = sum(framed[i : i + height, j : j + width] for i in range(3) for j in range(3))
    return np.asarray(total - counts)
