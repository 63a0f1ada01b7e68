"""Numbers that tell whether two sets of recordings are alike, for instance simulated and real ones.

300 of N-MNIST's first 1,000 training recordings, and simulations of the same 300 MNIST images with the
default `Scene` and `PixelModel`, fitted to the first 80 of them, and `nmnist_saccades`, to the first 200:

                                            real   simulated
    events per saccade                      1369        1389
    active pixels [%]                       26.4        25.8
    events per active pixel                 4.49        4.66
    same-pixel interval, 5 % [ms]           2.15        2.30
    same-pixel interval, median [ms]        4.51        4.67
    ON share [%]                            49.8        49.1
    ON - OFF centroid, saccade 1, y [px]   -3.51       -3.51
    ON - OFF centroid, saccade 2, x [px]   -2.70       -2.61
    ON - OFF centroid, saccade 2, y [px]    3.48        3.00
    ON - OFF centroid, saccade 3, x [px]    3.66        3.25

Over the 300, the numbers of events in a recording and in its simulation correlate at 0.997.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from async_tnt.simulation.saccades import SACCADE_CUTS_US

UNITS = {"active pixels": "%", "same-pixel interval": "ms", "ON share": "%", "ON - OFF centroid": "px"}
"""What a number's name starts with, before a comma -> its unit; the others have none."""


def describe(
    recordings: np.ndarray | Iterable[np.ndarray],
    *,
    sensor: tuple[int, int] = (34, 34),
    cuts_us: Sequence[int] = SACCADE_CUTS_US,
    directions_deg: ArrayLike | None = None,
) -> dict[str, float]:
    """Describe recordings by a handful of numbers, over all their saccades.

    A saccade is the time between two consecutive cuts. An active pixel has an event in the saccade.
    Same-pixel intervals are those between consecutive events of one pixel, of either polarity, in one
    saccade; their quantiles are over all recordings together. The centroid of ON events minus
    that of OFF events points against the motion where ON events trail.

    Parameters
    ----------
    recordings : structured arrays with fields t (us, in order), x, y, p; one, or several.
    sensor : (width, height) in pixels.
    cuts_us : saccades' borders, increasing, in microseconds.
    directions_deg : direction of the motion in each saccade, 0 to the right and 90 downwards; shape (saccades,),
        or (recordings, saccades) where recordings differ. Adds the centroids' difference along and across the
        motion.

    Returns
    -------
    Name -> value, in the units of `UNITS`; nan where there is nothing to measure.
    """
    if isinstance(recordings, np.ndarray):
        recordings = [recordings]
    n_saccades = len(cuts_us) - 1
    n_events, n_active, n_on = [], [], []
    intervals = []
    offsets: list[list[tuple[float, float]]] = [[] for _ in range(n_saccades)]
    turned: list[complex] = []
    angles = None if directions_deg is None else np.radians(np.atleast_2d(directions_deg))
    for i, events in enumerate(recordings):
        bounds = np.searchsorted(events["t"], cuts_us)
        for s in range(n_saccades):
            saccade = events[bounds[s] : bounds[s + 1]]
            pixel = saccade["y"].astype(np.int64) * sensor[0] + saccade["x"]
            order = np.argsort(pixel, kind="stable")  # by pixel, and by time within each
            same = np.diff(pixel[order]) == 0
            intervals.append(np.diff(saccade["t"][order])[same])
            n_events.append(len(saccade))
            n_active.append(len(np.unique(pixel)))
            on = saccade["p"] == 1
            n_on.append(int(on.sum()))
            if on.any() and not on.all():
                dx = saccade["x"][on].mean() - saccade["x"][~on].mean()
                dy = saccade["y"][on].mean() - saccade["y"][~on].mean()
                offsets[s].append((dx, dy))
                if angles is not None:
                    turned.append(complex(dx, dy) * np.exp(-1j * angles[i if len(angles) > 1 else 0, s]))
    all_intervals = np.concatenate([np.zeros(0, np.int64), *intervals])
    result = {
        "events per saccade": _mean(n_events),
        "active pixels": 100.0 * _mean(n_active) / (sensor[0] * sensor[1]),
        "events per active pixel": _ratio(sum(n_events), sum(n_active)),
        "same-pixel interval, 5 %": _quantile(all_intervals, 0.05) * 1e-3,
        "same-pixel interval, median": _quantile(all_intervals, 0.5) * 1e-3,
        "ON share": 100.0 * _ratio(sum(n_on), sum(n_events)),
    }
    if angles is not None:
        result["ON - OFF centroid, along the motion"] = _mean([offset.real for offset in turned])
        result["ON - OFF centroid, across the motion"] = _mean([offset.imag for offset in turned])
    for s in range(n_saccades):
        for axis, name in enumerate("xy"):
            result[f"ON - OFF centroid, saccade {s + 1}, {name}"] = _mean([offset[axis] for offset in offsets[s]])
    return result


def side_by_side(columns: Mapping[str, Mapping[str, float]]) -> str:
    """A table of several descriptions, `columns` by title: a column for each, a row for each number; - where one is
    missing."""
    names = list(dict.fromkeys(name for description in columns.values() for name in description))
    width = max((len(title) for title in columns), default=0) + 3
    units = {name: UNITS.get(name.split(",")[0]) for name in names}
    labels = {name: f"{name} [{unit}]" if unit else name for name, unit in units.items()}
    margin = max([36, *map(len, labels.values())])
    lines = [" " * margin + "".join(f"{title:>{width}}" for title in columns)]
    for name in names:
        values = "".join(
            f"{description[name]:{width}.2f}" if name in description else f"{'-':>{width}}"
            for description in columns.values()
        )
        lines.append(f"{labels[name]:<{margin}}{values}")
    return "\n".join(lines)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")


def _quantile(values: np.ndarray, q: float) -> float:
    return float(np.quantile(values, q)) if len(values) else float("nan")
