"""Cameras that nobody measured, drawn at random: pixels over the ranges that event cameras have.

thresholds    .1 to .4 in log luminance, log-uniform; ON against OFF within a factor of 1.4 in two
              thirds of the cameras
mismatch      .03 to .25
refractory    .1 to 3 ms, log-uniform
bandwidth     200 to 5,000 Hz in the brightest light, log-uniform
noise         .01 to 3 events a pixel and second, log-uniform; 10 to 100 % of it ON
leak          up to .3 events a pixel and second
after-pulses  none in half of the cameras, else of up to a third of the events
hot pixels    none in half of the cameras, else up to one in 500, of 50 events a second

What a recording of a camera tells of its pixels takes the place of these ranges: ratio of
thresholds, noise and after-pulses within a quarter, and the bound of the refractory time, if it is
shorter. A recording without a quiet pixel tells no noise, and one without two events of a pixel no
refractory time.
"""

from __future__ import annotations

import numpy as np

from async_tnt.simulation.measured_pixels import LARGEST_RATIO, MeasuredPixels
from async_tnt.simulation.simulator import PixelModel

THRESHOLDS, RATIO_SPREAD, MISMATCHES = (0.1, 0.4), 0.35, (0.03, 0.25)
REFRACTORY_US, BANDWIDTHS_HZ = (100.0, 3_000.0), (200.0, 5_000.0)
NOISE_HZ, NOISE_ON_SHARES, LEAK_HZ = (0.01, 3.0), (0.1, 1.0), 0.3
AFTER_SHARE, HOT_SHARE, HOT_HZ = 1 / 3, 1 / 500, 50.0
NEAR = 1.25
"""How far a camera that is known may be from what a recording tells."""


def random_pixels(rng: np.random.Generator, camera: MeasuredPixels | None = None) -> PixelModel:
    """Pixels of a camera, as `rng` draws them; of one that is known, as far as its events tell."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    threshold = between(*THRESHOLDS)
    ratio = np.clip(np.exp(RATIO_SPREAD * rng.standard_normal()), 1 / LARGEST_RATIO, LARGEST_RATIO)
    refractory_us, noise_hz, noise_on_share = (
        between(*REFRACTORY_US),
        between(*NOISE_HZ),
        rng.uniform(*NOISE_ON_SHARES),
    )
    leak_hz = rng.uniform(0, LEAK_HZ)
    after_share, hot_share = (
        rng.uniform(0, most) * (rng.random() < 0.5) for most in (AFTER_SHARE, HOT_SHARE)
    )
    if camera is not None:
        known = camera.step_on / camera.step_off, camera.after_share
        ratio, after_share = (number * between(1 / NEAR, NEAR) for number in known)
        if camera.noise_hz:
            noise_hz, noise_on_share, leak_hz = (
                camera.noise_hz * between(1 / NEAR, NEAR),
                camera.noise_on_share,
                0.0,
            )
        if camera.refractory_us:
            refractory_us = rng.uniform(0, 1) * min(camera.refractory_us, REFRACTORY_US[1])
    return PixelModel(
        threshold_on=threshold * float(np.sqrt(ratio)),
        threshold_off=threshold / float(np.sqrt(ratio)),
        mismatch=rng.uniform(*MISMATCHES),
        refractory_us=refractory_us,
        noise_hz=noise_hz,
        noise_on_share=noise_on_share,
        bandwidth_hz=between(*BANDWIDTHS_HZ),
        leak_hz=leak_hz,
        after_share=min(1.0, after_share),
        hot_share=hot_share,
        hot_hz=HOT_HZ,
    )
