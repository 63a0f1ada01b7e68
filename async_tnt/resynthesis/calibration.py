"""What events cannot tell directly, found by simulating the recorded motion again: contrast and refractory time.

Events tell contrast in units of the pixels' thresholds, and each image is smoother than what was seen. So the
thresholds are scaled until the re-synthesized recorded motion has as many events as the recordings. Intervals between a
pixel's events only bound its refractory time; of some times within the bound, each with its own scale, the one whose
intervals are most like the recorded ones is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from async_tnt.events import structured
from async_tnt.resynthesis.events import MovedImage, SimulatedPixels
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.resynthesis.pixels import Columns, MeasuredPixels, measure_pixels
from async_tnt.resynthesis.reconstruction import Reconstruction
from async_tnt.simulation.statistics import describe

REFRACTORY_SHARES = (0.0, 0.25, 0.5, 0.75)
"""Of the longest refractory time that the intervals allow."""
INTERVALS = ("same-pixel interval, 5 %", "same-pixel interval, median")
"""The numbers of `describe` that are compared."""
CLOCK_MS = 1e-3  # shorter intervals are 0 in whole microseconds
MOST_STEPS, NEAR_ENOUGH = 8, 0.005


@dataclass(frozen=True)
class Calibration:
    """How events are re-synthesized.

    Parameters
    ----------
    pixels : of the simulated sensor.
    length : median length of the recorded paths, in pixels.
    match : "recorded" and "resynthesized": the same numbers of both, for the recorded motion; see
        `simulation.statistics.describe`.
    """

    pixels: SimulatedPixels
    length: float
    match: dict[str, Any]


def calibrate(
    reconstruction: Reconstruction,
    windows: Sequence[Columns],
    seed: int,
    known: Sequence[MotionPath | None] | None = None,
) -> Calibration:
    """Calibrate on some windows.

    Parameters
    ----------
    reconstruction : of windows of their sensor and length.
    windows : of recordings; a hundred are enough.
    seed : of the simulation.
    known : the path of each window, where paths are shared.

    Raises
    ------
    ValueError : no window's path was found.
    """
    model = reconstruction.model
    measured = measure_pixels(windows, model.sensor, model.window_us)
    paths, images, recorded = _reconstruct(reconstruction, windows, measured, known)
    target = _numbers(recorded, reconstruction)
    candidates = []
    for share in REFRACTORY_SHARES if measured.refractory_us else (0.0,):
        pixels = SimulatedPixels(replace(measured, refractory_us=share * measured.refractory_us))
        pixels, simulated = _scaled(pixels, images, sum(map(len, recorded)), seed)
        found = _numbers(simulated, reconstruction)
        unlike = sum(abs(np.log(max(found[name], CLOCK_MS) / max(target[name], CLOCK_MS))) for name in INTERVALS)
        candidates.append((float(unlike), pixels, found))
    _, pixels, found = min(candidates, key=lambda candidate: candidate[0])
    numbers = {"recorded": target, "resynthesized": found}
    return Calibration(pixels, float(np.median([path.length for path in paths])), numbers)


def _scaled(
    pixels: SimulatedPixels, images: Sequence[MovedImage], n_events: int, seed: int
) -> tuple[SimulatedPixels, list[np.ndarray]]:
    """The pixels whose scale gives as many events under the recorded motion as were recorded, and these events."""
    ratio = 1.0
    for _ in range(MOST_STEPS):
        pixels = replace(pixels, scale=pixels.scale * ratio)
        simulated = [image.as_recorded(pixels, np.random.default_rng((seed, i))) for i, image in enumerate(images)]
        ratio = max(1, sum(map(len, simulated))) / n_events
        if abs(ratio - 1) < NEAR_ENOUGH:
            break
    return pixels, simulated


def _numbers(windows: Sequence[np.ndarray], reconstruction: Reconstruction) -> dict[str, float]:
    """`describe`, without what means nothing of windows that move in different directions."""
    model = reconstruction.model
    numbers = describe(windows, sensor=model.sensor, cuts_us=(0, model.window_us))
    return {
        name.replace("saccade", "window"): value
        for name, value in numbers.items()
        if not name.startswith("ON - OFF centroid")
    }


def _reconstruct(
    reconstruction: Reconstruction,
    windows: Sequence[Columns],
    pixels: MeasuredPixels,
    known: Sequence[MotionPath | None] | None,
) -> tuple[list[MotionPath], list[MovedImage], list[np.ndarray]]:
    """Path, image and recorded events of those windows whose path is found."""
    found = reconstruction(windows, pixels, known)
    moving = [(path, image, structured(one)) for (path, image), one in zip(found, windows, strict=True) if image]
    if not moving:
        raise ValueError(
            f"no motion was found in any of {len(windows)} windows: re-synthesis needs windows in which one image "
            "moves as a whole, with some hundred events each"
        )
    paths, images, recorded = zip(*moving, strict=True)
    return list(paths), list(images), list(recorded)
