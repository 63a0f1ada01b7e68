"""What events cannot tell directly, found by simulating the recorded motion again: contrast and
refractory time.

Events tell contrast in units of the pixels' thresholds, and each image is smoother than what was
seen. So the thresholds are scaled until the re-synthesized recorded motion has as many events as
the recordings. Intervals between a pixel's events only bound its refractory time; of some times
within the bound, each with its own scale, the one whose intervals are most like the recorded ones
is taken.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from async_tnt.resynthesis.reconstruction import MovedImage, Reconstruction, SimulatedPixels
from async_tnt.simulation.measured_pixels import Columns, measure_pixels, part_of
from async_tnt.volume.events import structured

REFRACTORY_SHARES = (0.0, 0.25, 0.5, 0.75)
"""Of the longest refractory time that the intervals allow."""
INTERVALS = ("same-pixel interval, 5 %", "same-pixel interval, median")
"""The numbers of `describe` that are compared."""
UNITS = {
    "active pixels": "%",
    "same-pixel interval": "ms",
    "ON share": "%",
    "ON - OFF centroid": "px",
}
"""What a number's name starts with, before a comma -> its unit; the others have none."""
CLOCK_MS = 1e-3  # shorter intervals are 0 in whole microseconds
MOST_STEPS, NEAR_ENOUGH = 8, 0.005
UNLIKE = 4 / 3
"""Ratio of a simulated number to the recorded one that is worth a warning."""


@dataclass(frozen=True)
class Calibration:
    """How events are re-synthesized.

    Parameters
    ----------
    pixels : of the simulated sensor.
    length : median length of the recorded paths, in pixels.
    match : "recorded" and "resynthesized": the same numbers of both, for the recorded motion; see
        `describe`.
    """

    pixels: SimulatedPixels
    length: float
    match: dict[str, Any]


def calibrate(reconstruction: Reconstruction, windows: Sequence[Columns], seed: int) -> Calibration:
    """Calibrate on some windows.

    Parameters
    ----------
    reconstruction : of windows of their sensor and length.
    windows : of recordings, with their neighbours' events or without; a hundred are enough.
    seed : of the simulation.

    Raises
    ------
    ValueError : no window's path was found.
    """
    model = reconstruction.model
    parts = [part_of(one, model.window_us) for one in windows]
    measured = measure_pixels(parts, model.sensor, model.window_us)
    reconstructed = list(reconstruction(windows, measured))
    moving = [
        (path, image, structured(one))
        for (path, image), one in zip(reconstructed, parts, strict=True)
        if image
    ]
    if not moving:
        reasons = ", ".join(
            f"{why} {n}"
            for why, n in Counter(path.refused for path, _ in reconstructed).most_common()
        )
        raise ValueError(
            f"no motion was found in any of {len(parts)} windows ({reasons}): re-synthesis needs "
            "windows in "
            "which one image moves as a whole, with a few hundred events each"
        )
    paths, images, recorded = zip(*moving, strict=True)
    target = describe(recorded, model.sensor)
    candidates = []
    for share in REFRACTORY_SHARES if measured.refractory_us else (0.0,):
        pixels = SimulatedPixels(replace(measured, refractory_us=share * measured.refractory_us))
        pixels, simulated = _scaled(pixels, images, sum(map(len, recorded)), seed)
        found = describe(simulated, model.sensor)
        unlike = sum(
            abs(np.log(max(found[name], CLOCK_MS) / max(target[name], CLOCK_MS)))
            for name in INTERVALS
        )
        candidates.append((float(unlike), pixels, found))
    _, pixels, found = min(candidates, key=lambda candidate: candidate[0])
    numbers = {"recorded": target, "resynthesized": found}
    return Calibration(pixels, float(np.median([path.length for path in paths])), numbers)


def _scaled(
    pixels: SimulatedPixels, images: Sequence[MovedImage], n_events: int, seed: int
) -> tuple[SimulatedPixels, list[np.ndarray]]:
    """The pixels whose scale gives as many events under the recorded motion as were recorded, and
    these events."""
    ratio = 1.0
    for _ in range(MOST_STEPS):
        pixels = replace(pixels, scale=pixels.scale * ratio)
        simulated = [
            image.as_recorded(pixels, np.random.default_rng((seed, i)))
            for i, image in enumerate(images)
        ]
        ratio = max(1, sum(map(len, simulated))) / n_events
        if abs(ratio - 1) < NEAR_ENOUGH:
            break
    return pixels, simulated


def describe(windows: Sequence[np.ndarray], sensor: tuple[int, int]) -> dict[str, float]:
    """Numbers that tell whether two sets of recordings are alike.

    An active pixel has an event in the window. Same-pixel intervals are those between consecutive
    events of one pixel, of either polarity, in one window; their quantiles are over all windows
    together.

    Parameters
    ----------
    windows : structured arrays with fields t (us, in order), x, y, p.
    sensor : (width, height), in pixels.

    Returns
    -------
    Name -> value, in the units of `UNITS`; nan where there is nothing to measure.
    """
    n_active, n_events, n_on = 0, sum(map(len, windows)), 0
    intervals = [np.empty(0, np.int64)]
    for events in windows:
        pixel = events["y"].astype(np.int64) * sensor[0] + events["x"]
        order = np.argsort(pixel, kind="stable")  # by pixel, and by time within each
        same = np.diff(pixel[order]) == 0
        intervals.append(np.diff(events["t"][order])[same])
        n_active += len(np.unique(pixel))
        n_on += int((events["p"] == 1).sum())
    every = np.concatenate(intervals)
    short, median = np.quantile(every, (0.05, 0.5)) if len(every) else (np.nan, np.nan)
    return {
        "events per window": _ratio(n_events, len(windows)),
        "active pixels": 100.0 * _ratio(n_active, len(windows) * sensor[0] * sensor[1]),
        "events per active pixel": _ratio(n_events, n_active),
        "same-pixel interval, 5 %": float(short) * 1e-3,
        "same-pixel interval, median": float(median) * 1e-3,
        "ON share": 100.0 * _ratio(n_on, n_events),
    }


def unlike(match: Mapping[str, Mapping[str, float]]) -> list[str]:
    """The numbers of `Calibration.match` of which one is `UNLIKE` times the other or more.

    Examples
    --------
    >>> recorded = {"ON share": 50.0, "active pixels": 2.0}
    >>> unlike({"recorded": recorded, "resynthesized": {"ON share": 40.0, "active pixels": 2.8}})
    ['active pixels']
    """
    recorded, simulated = match["recorded"], match["resynthesized"]
    small = CLOCK_MS  # of an interval; the other numbers are larger
    ratios = {name: max(recorded[name], small) / max(simulated[name], small) for name in recorded}
    return [name for name, ratio in ratios.items() if not 1 / UNLIKE < ratio < UNLIKE]


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")


def side_by_side(columns: Mapping[str, Mapping[str, float]]) -> str:
    """A table of several descriptions, `columns` by title: a column for each, a row for each
    number; - where one is missing."""
    names = list(dict.fromkeys(name for description in columns.values() for name in description))
    width = max((len(title) for title in columns), default=0) + 3
    units = {name: UNITS.get(name.split(",")[0]) for name in names}
    labels = {name: f"{name} [{unit}]" if unit else name for name, unit in units.items()}
    margin = max([36, *map(len, labels.values())])
    lines = [" " * margin + "".join(f"{title:>{width}}" for title in columns)]
    for name in names:
        values = (f"{column[name]:.2f}" if name in column else "-" for column in columns.values())
        lines.append(f"{labels[name]:<{margin}}" + "".join(f"{value:>{width}}" for value in values))
    return "\n".join(lines)
