"""Find the thresholds and the refractory time of simulated pixels.

Events do not tell these values directly. So the recorded motion is simulated with several values,
and the simulated events are compared with the recorded ones.

Events tell contrast only in units of the pixels' thresholds, and an image that is found from events
is smoother than the scene. So the thresholds are scaled until the simulated windows have as many
events as the recorded ones.

The intervals between a pixel's events give only an upper bound of its refractory time. So several
refractory times within the bound are tried, each with its own scale of the thresholds. The choice
is the refractory time whose intervals are most like the recorded ones.
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
"""Refractory times that are tried, as shares of the longest one that the intervals allow."""
INTERVALS = ("same-pixel interval, 5 %", "same-pixel interval, median")
"""The numbers of `describe` with which refractory times are compared."""
UNITS = {
    "active pixels": "%",
    "same-pixel interval": "ms",
    "ON share": "%",
    "ON - OFF centroid": "px",
}
"""Name of a number of `describe`, up to its comma -> unit. The other numbers have no unit."""
CLOCK_MS = 1e-3
"""Shortest interval that is compared, in milliseconds: one microsecond, the unit of times. Shorter
intervals count as this one."""
MOST_STEPS = 8
"""Most steps in which the scale of the thresholds is searched."""
NEAR_ENOUGH = 0.005
"""Deviation of the number of events, as a share, at which the search for the scale ends."""
WARNING_RATIO = 4 / 3
"""Ratio between a simulated and a recorded number, in either order, that is worth a warning."""


@dataclass(frozen=True)
class Calibration:
    """How events are re-synthesized, and how well they match recorded events.

    Parameters
    ----------
    pixels : the simulated sensor.
    length : median length of the recorded paths, in pixels.
    match : "recorded" -> the numbers of `describe` for the recorded windows, and "resynthesized" ->
        the same numbers for windows that are simulated with the recorded motion.
    """

    pixels: SimulatedPixels
    length: float
    match: dict[str, Any]


def calibrate(reconstruction: Reconstruction, windows: Sequence[Columns], seed: int) -> Calibration:
    """Calibrate re-synthesis on some windows.

    Parameters
    ----------
    reconstruction : finds the paths and the images of these windows.
    windows : windows of recordings, with or without the events of the neighbouring windows. A
        hundred windows are enough.
    seed : seed of the simulation.

    Raises
    ------
    ValueError : no path was found in any window.
    """
    model = reconstruction.model
    parts = [part_of(window, model.window_us) for window in windows]
    measured = measure_pixels(parts, model.sensor, model.window_us)

    lengths = []
    images = []
    recorded = []
    refusals: Counter[str] = Counter()
    for (path, image), part in zip(reconstruction(windows, measured), parts, strict=True):
        if image is None:
            refusals[path.refused] += 1
        else:
            lengths.append(path.length)
            images.append(image)
            recorded.append(structured(part))
    if not images:
        reasons = ", ".join(f"{why} {n}" for why, n in refusals.most_common())
        raise ValueError(
            f"no motion was found in any of {len(parts)} windows ({reasons}): re-synthesis needs "
            "windows in which one image moves as a whole, with a few hundred events each"
        )

    target = describe(recorded, model.sensor)
    n_events = sum(map(len, recorded))
    candidates = []
    shares = REFRACTORY_SHARES if measured.refractory_us else (0.0,)
    for share in shares:
        pixels = SimulatedPixels(replace(measured, refractory_us=share * measured.refractory_us))
        pixels, simulated = _scale_thresholds(pixels, images, n_events, seed)
        numbers = describe(simulated, model.sensor)
        candidates.append((_difference(numbers, target), pixels, numbers))
    _, pixels, numbers = min(candidates, key=lambda candidate: candidate[0])
    match = {"recorded": target, "resynthesized": numbers}
    return Calibration(pixels, float(np.median(lengths)), match)


def _difference(numbers: Mapping[str, float], target: Mapping[str, float]) -> float:
    """How much the `INTERVALS` of two descriptions differ: the sum of |log ratio|."""
    ratios = [max(numbers[name], CLOCK_MS) / max(target[name], CLOCK_MS) for name in INTERVALS]
    return float(sum(abs(np.log(ratio)) for ratio in ratios))


def _scale_thresholds(
    pixels: SimulatedPixels, images: Sequence[MovedImage], n_events: int, seed: int
) -> tuple[SimulatedPixels, list[np.ndarray]]:
    """Scale the thresholds until all images together have `n_events` events in the recorded motion.

    Parameters
    ----------
    pixels : the simulated pixels with the first scale.
    images : the images of the windows.
    n_events : number of events of the recorded windows.
    seed : seed of the simulation.

    Returns
    -------
    The pixels with this scale, and the simulated events of each image.
    """
    # with thresholds that are twice as high, pixels have about half as many events
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
    """Numbers that describe windows, to compare recorded with simulated windows.

    An active pixel has an event in the window. A same-pixel interval is the time between two
    consecutive events of one pixel in one window, of either polarity. The quantiles of the
    intervals are over all windows together.

    Parameters
    ----------
    windows : structured arrays with fields t (us, in order), x, y, p.
    sensor : (width, height), in pixels.

    Returns
    -------
    Name -> value, in the units of `UNITS`; nan where there is nothing to measure.
    """
    n_events = sum(map(len, windows))
    n_active = 0
    n_on = 0
    intervals = [np.empty(0, np.int64)]
    for events in windows:
        pixel = events["y"].astype(np.int64) * sensor[0] + events["x"]
        # the sort is stable: the events of each pixel stay in order of time
        order = np.argsort(pixel, kind="stable")
        is_same_pixel = np.diff(pixel[order]) == 0
        intervals.append(np.diff(events["t"][order])[is_same_pixel])
        n_active += len(np.unique(pixel))
        n_on += int((events["p"] == 1).sum())
    all_intervals = np.concatenate(intervals)
    short = np.nan
    median = np.nan
    if len(all_intervals):
        short, median = np.quantile(all_intervals, (0.05, 0.5))
    return {
        "events per window": _ratio(n_events, len(windows)),
        "active pixels": 100.0 * _ratio(n_active, len(windows) * sensor[0] * sensor[1]),
        "events per active pixel": _ratio(n_events, n_active),
        "same-pixel interval, 5 %": float(short) * 1e-3,
        "same-pixel interval, median": float(median) * 1e-3,
        "ON share": 100.0 * _ratio(n_on, n_events),
    }


def differing_numbers(match: Mapping[str, Mapping[str, float]]) -> list[str]:
    """The names of the numbers of `Calibration.match` that differ by `WARNING_RATIO` or more.

    Examples
    --------
    >>> recorded = {"ON share": 50.0, "active pixels": 2.0}
    >>> simulated = {"ON share": 40.0, "active pixels": 2.8}
    >>> differing_numbers({"recorded": recorded, "resynthesized": simulated})
    ['active pixels']
    """
    names = []
    for name, recorded in match["recorded"].items():
        # `CLOCK_MS` is a bound for intervals. The other numbers are larger, so it does not change
        # them.
        simulated = max(match["resynthesized"][name], CLOCK_MS)
        ratio = max(recorded, CLOCK_MS) / simulated
        if not 1 / WARNING_RATIO < ratio < WARNING_RATIO:
            names.append(name)
    return names


def _ratio(part: float, whole: float) -> float:
    """The ratio part / whole; nan if `whole` is 0."""
    return part / whole if whole else float("nan")


def side_by_side(columns: Mapping[str, Mapping[str, float]]) -> str:
    """A table, as text, with a column for each description and a row for each number.

    Parameters
    ----------
    columns : title of a column -> description, see `describe`. A missing number is shown as -.
    """
    names = list(dict.fromkeys(name for description in columns.values() for name in description))
    labels = {}
    for name in names:
        unit = UNITS.get(name.split(",")[0])
        labels[name] = f"{name} [{unit}]" if unit else name
    width = max((len(title) for title in columns), default=0) + 3
    margin = max([36, *map(len, labels.values())])
    lines = [" " * margin + "".join(f"{title:>{width}}" for title in columns)]
    for name in names:
        values = [f"{column[name]:.2f}" if name in column else "-" for column in columns.values()]
        row = "".join(f"{value:>{width}}" for value in values)
        lines.append(f"{labels[name]:<{margin}}{row}")
    return "\n".join(lines)
