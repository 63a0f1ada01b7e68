"""The pixels that other motions are simulated with, and which of a recording's events a window has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from async_tnt.simulation.measured_pixels import Columns, MeasuredPixels
from async_tnt.simulation.simulator import PixelModel

MISMATCH = 0.12
"""Of the simulated thresholds from pixel to pixel, as in `PixelModel`."""
THRESHOLD_SPREAD, REFRACTORY_SPREAD = 0.1, 0.4


@dataclass(frozen=True)
class SimulatedPixels:
    """The sensor that re-synthesized events come from.

    Parameters
    ----------
    measured : what the recordings tell.
    scale : thresholds, in units of those that images are measured in; `calibration` finds it.
    """

    measured: MeasuredPixels
    scale: float = 1.0

    def draw(self, rng: np.random.Generator) -> PixelModel:
        """The pixels of one window, drawn by `rng`: thresholds and refractory time vary from window to window."""
        scale = self.scale * np.exp(THRESHOLD_SPREAD * rng.standard_normal())
        spread = rng.uniform(1 - REFRACTORY_SPREAD, 1 + REFRACTORY_SPREAD)
        return PixelModel(
            threshold_on=scale * self.measured.step_on,
            threshold_off=scale * self.measured.step_off,
            mismatch=MISMATCH,
            refractory_us=self.measured.refractory_us * spread,
            noise_hz=self.measured.noise_hz,
            noise_on_share=self.measured.noise_on_share,
            after_share=self.measured.after_share,
        )


def part_of(window: Columns, window_us: int, span: int = 1) -> Columns:
    """The events of `span` windows with `window` in their middle; times since the first one's start."""
    t, x, y, p = window
    before_us = (span - 1) // 2 * window_us
    first, last = np.searchsorted(t, (-before_us, window_us + before_us))
    return t[first:last] + before_us, x[first:last], y[first:last], p[first:last]
