"""Draw the pixels of cameras at random, over the ranges that event cameras have.

thresholds    .1 to .4 in log luminance, log-uniform; the ON and the OFF threshold differ by less
              than a factor of 1.4 in two thirds of the cameras
mismatch      .03 to .25: the standard deviation, over pixels, of the log of the thresholds
refractory    .1 to 3 ms, log-uniform
bandwidth     200 to 5,000 Hz in the brightest light, log-uniform
noise         .01 to 3 events a pixel and second, log-uniform; 10 to 100 % of them are ON
leak          up to .3 events a pixel and second
after-pulses  half of the cameras have none; in the other half up to a third of the events have an
              after-pulse
hot pixels    half of the cameras have none; in the other half up to one pixel in 500 is hot, with
              50 events a second

If a recording of the camera exists, the values measured on it replace some of these ranges. The
ratio of thresholds, the noise and the after-pulses are drawn within a factor of 1.25 of the
measured values. The refractory time is drawn between 0 and its measured bound. Two values may be
missing. The noise is not known if no quiet pixel has noise, and the refractory time is not known if
no pixel has two events.
"""

from __future__ import annotations

import numpy as np

from async_tnt.simulation.measured_pixels import LARGEST_RATIO, MeasuredPixels
from async_tnt.simulation.simulator import PixelModel

THRESHOLDS = (0.1, 0.4)
"""Range of the contrast threshold, in log luminance."""
RATIO_SPREAD = 0.35
"""Standard deviation of the log of the ratio of ON and OFF thresholds."""
MISMATCHES = (0.03, 0.25)
"""Range of the standard deviation, over pixels, of the log of the thresholds."""
REFRACTORY_US = (100.0, 3_000.0)
"""Range of the refractory time, in microseconds."""
BANDWIDTHS_HZ = (200.0, 5_000.0)
"""Range of a pixel's bandwidth in the brightest light, in hertz."""
NOISE_HZ = (0.01, 3.0)
"""Range of the noise, in events a pixel and second."""
NOISE_ON_SHARES = (0.1, 1.0)
"""Range of the share of the noise that is ON."""
LEAK_HZ = 0.3
"""Largest rate of the ON events that a leak causes, in events a pixel and second."""
AFTER_SHARE = 1 / 3
"""Largest share of the events that an after-pulse follows."""
HOT_SHARE = 1 / 500
"""Largest share of the pixels that are hot."""
HOT_HZ = 50.0
"""Mean rate of a hot pixel, in events a second."""
NEAR = 1.25
"""Largest factor by which a drawn value differs from the value that was measured on a recording."""


def random_pixels(rng: np.random.Generator, camera: MeasuredPixels | None = None) -> PixelModel:
    """Draw the pixels of a camera.

    Parameters
    ----------
    rng : draws the pixels.
    camera : the camera's pixels as measured on a recording; None: they were not measured.
    """

    def between(low: float, high: float) -> float:
        """Draw a number. Its logarithm is uniform."""
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    threshold = between(*THRESHOLDS)
    ratio = np.clip(np.exp(RATIO_SPREAD * rng.standard_normal()), 1 / LARGEST_RATIO, LARGEST_RATIO)
    refractory_us = between(*REFRACTORY_US)
    noise_hz = between(*NOISE_HZ)
    noise_on_share = rng.uniform(*NOISE_ON_SHARES)
    leak_hz = rng.uniform(0, LEAK_HZ)
    # half of the cameras have no after-pulses, and half no hot pixels
    after_share = rng.uniform(0, AFTER_SHARE) * (rng.random() < 0.5)
    hot_share = rng.uniform(0, HOT_SHARE) * (rng.random() < 0.5)

    if camera is not None:
        ratio = camera.step_on / camera.step_off * between(1 / NEAR, NEAR)
        after_share = camera.after_share * between(1 / NEAR, NEAR)
        if camera.noise_hz:
            # the measured noise includes the events that a leak causes
            noise_hz = camera.noise_hz * between(1 / NEAR, NEAR)
            noise_on_share = camera.noise_on_share
            leak_hz = 0.0
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
