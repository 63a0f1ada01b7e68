"""In how many windows motion re-synthesis finds a path, and how often the path is right.

The report also counts the paths that are found where nothing moves.

    python -m experiments.found_paths [--nmnist N-MNIST] [--windows N] [--json FILE] [--quick]

There are three kinds of windows:

- N-MNIST's three saccades, with all of their events and with a fifth of them, and thirds of
  saccades with a fifth of the events, alone and together with the windows beside them. A path is
  right if it is within 45 degrees of the median path of the saccade with all events.
- Made hand motion, also of objects that turn or come nearer meanwhile. A path is right if it is
  within 45 degrees of the direction of the swing.
- Noise of 50 to 3,000 events a window: uniform, all pixels flickering at once, of one polarity, in
  pairs of opposite polarity, and at hot pixels.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.resynthesis.moving_image import cell_for
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.resynthesis.reconstruction import SPAN, Reconstruction
from async_tnt.simulation.measured_pixels import Columns, MeasuredPixels, measure_pixels, part_of
from async_tnt.sources.files.nmnist import read_nmnist
from experiments.digit_data.recordings import SACCADE_US
from experiments.objects import hands
from experiments.scripts.options import add_count, add_folder, exit_with, run_script, script_parser
from experiments.speed.moments import made_columns
from experiments.speed.timing import machine

SIDE = 34
"""Width and height of the sensor of N-MNIST, in pixels."""

KEPT_SHARES = (1.0, 0.2)
"""Shares of the events that are kept."""

FEWEST = 50
"""Least number of events in a window of noise."""

MOST = 3_000
"""Largest number of events in a window of noise."""

FIRST, SECOND = hands.SESSIONS

HANDS = {
    "session 1": FIRST,
    "session 2": SECOND,
    "turning by 8°": replace(FIRST, turn_deg=8.0),
    "turning by 16°": replace(FIRST, turn_deg=16.0),
    "growing by 12 %": replace(FIRST, nearer=0.12),
    "growing by 25 %": replace(FIRST, nearer=0.25),
}
"""Title -> a session of hand motion. The numbers of titles are standard deviations for a swing."""

PARTS = np.arange(1, 17) / 16
"""Times in a window, as shares of its length, at which the places of a path are compared."""


def paths_of(
    windows: Sequence[Columns], sensor: tuple[int, int], window_us: int, pixels: MeasuredPixels
) -> Any:
    """The `MotionPath` of each window."""
    reconstruction = Reconstruction(sensor, window_us, cell_for(windows, sensor))
    return [path for path, _ in reconstruction(windows, pixels)]


def path_row(paths: Sequence[MotionPath], angles: np.ndarray) -> dict[str, Any]:
    """A row of the report, with shares of the windows of `paths`.

    "found" is the share of windows with a path that is not refused. "right" is the share of these
    paths that are right, and "opposite" the share that point in the opposite direction.
    "right_of_all" is the share of right paths among all paths, refused or not.

    A path is right if its mean place lies within 45 degrees of the window's angle in `angles`, in
    radians. It is opposite if it lies more than 135 degrees away.
    """
    means = np.array([path.at(PARTS).mean(0) for path in paths])
    path_angles = np.arctan2(means[:, 1], means[:, 0])
    # the difference of two angles, in [0, pi]
    angle_errors = np.abs(np.angle(np.exp(1j * (path_angles - angles))))
    is_found = np.array([not path.refused for path in paths])
    is_right = angle_errors < np.pi / 4
    is_opposite = angle_errors > 3 * np.pi / 4
    reasons = Counter(path.refused for path in paths if path.refused)
    return {
        "windows": len(paths),
        "found": float(is_found.mean()),
        "right": float(is_right[is_found].mean()) if is_found.any() else None,
        "opposite": float(is_opposite[is_found].mean()) if is_found.any() else None,
        "right_of_all": float(is_right.mean()),
        "refused": dict(reasons.most_common()),
    }


def saccades(folder: Path, n: int) -> dict[str, Any]:
    """The rows of N-MNIST's saccades, for each share of the events."""
    rng = np.random.default_rng(0)
    names = sorted(map(str, folder.glob("Train/*/*.bin")))
    files = [Path(name) for name in rng.permutation(names)[:n]]
    if not files:
        raise FileNotFoundError(f"no recordings {folder}/Train/<digit>/*.bin")
    n = len(files)
    rows: dict[str, Any] = {}
    angles: dict[int, float] = {}

    def cut(file: Path, from_us: int, until_us: int, rate: float, start_us: int) -> Columns:
        """A share of a file's events in [from_us, until_us), with times since `start_us`."""
        events = read_nmnist(file)
        inside = (events["t"] >= from_us) & (events["t"] < until_us)
        kept = events[inside & (rng.random(len(events)) < rate)]
        return _columns((kept["t"] - start_us, kept["x"], kept["y"], kept["p"]))

    for rate in KEPT_SHARES:
        for saccade in range(3):
            start_us = saccade * SACCADE_US
            windows = [cut(file, start_us, start_us + SACCADE_US, rate, start_us) for file in files]
            pixels = measure_pixels(windows, (SIDE, SIDE), SACCADE_US)
            paths = paths_of(windows, (SIDE, SIDE), SACCADE_US, pixels)
            ends = np.median([path.positions[-1] for path in paths], axis=0)
            true_angle = angles.setdefault(saccade, np.arctan2(ends[1], ends[0]))
            title = f"N-MNIST, saccade {saccade + 1}, {rate:.0%} of the events"
            rows[title] = path_row(paths, np.full(n, true_angle))

    third = SACCADE_US // 3
    rate = min(KEPT_SHARES)
    starts = third * (np.arange(n) % 9)
    wide_windows = [
        cut(file, start - third, start + 2 * third, rate, start)
        for file, start in zip(files, starts.tolist(), strict=True)
    ]
    true_angles = np.array([angles[k] for k in (starts // SACCADE_US).tolist()])
    for name, span in (("alone", 1), ("with those beside", SPAN)):
        windows = wide_windows if span > 1 else [part_of(window, third) for window in wide_windows]
        paths = paths_of(windows, (SIDE, SIDE), third, pixels)
        rows[f"N-MNIST, thirds of saccades, {rate:.0%}, {name}"] = path_row(paths, true_angles)
    return rows


def swings(n: int) -> dict[str, Any]:
    """The rows of made hand motion, in all directions."""
    rows = {}
    for k, (title, session) in enumerate(HANDS.items()):
        windows = []
        angles = 2 * np.pi * np.arange(n) / n
        for i, angle in enumerate(angles):
            name = list(hands.SHAPES)[i % len(hands.SHAPES)]
            recording = hands.record(name, float(angle), np.random.default_rng((k, i)), session)
            windows.append(_columns(recording[column] for column in "txyp"))
        pixels = measure_pixels(windows, hands.SENSOR, hands.WINDOW_US)
        paths = paths_of(windows, hands.SENSOR, hands.WINDOW_US, pixels)
        rows[f"hand motion, {title}"] = path_row(paths, angles)
    return rows


def _uniform(n: int, rng: np.random.Generator) -> Columns:
    return made_columns(rng, (SIDE, SIDE), n, SACCADE_US)


def _flicker(n: int, rng: np.random.Generator) -> list[np.ndarray]:
    """All pixels flicker at once: bursts of OFF and of ON take turns."""
    _, x, y, _ = _uniform(n, rng)
    n_bursts = 2 * rng.integers(3, 12)
    burst = np.sort(rng.integers(0, n_bursts, n))
    return [np.sort(burst * SACCADE_US // n_bursts + rng.integers(0, 500, n)), x, y, burst % 2]


def _one_polarity(n: int, rng: np.random.Generator) -> list[np.ndarray]:
    t, x, y, _ = _uniform(n, rng)
    return [t, x, y, np.full(n, rng.integers(0, 2))]


def _pairs(n: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Each OFF event is followed by an ON event at its pixel and time."""
    t, x, y, _ = _uniform(n // 2, rng)
    return [t.repeat(2), x.repeat(2), y.repeat(2), np.tile([0, 1], n // 2)]


def _hot_pixels(n: int, rng: np.random.Generator) -> list[np.ndarray]:
    """About .7 of the events are at one to five hot pixels, all other events anywhere."""
    t, x, y, p = _uniform(n, rng)
    hot_pixels = rng.integers(0, SIDE, (rng.integers(1, 6), 2))[:, :, None]
    which = rng.integers(0, len(hot_pixels), n)
    is_hot = rng.random(n) < 0.7
    return [
        t,
        np.where(is_hot, hot_pixels[which, 0, 0], x),
        np.where(is_hot, hot_pixels[which, 1, 0], y),
        p,
    ]


NOISE: dict[str, Callable[[int, np.random.Generator], Sequence[np.ndarray]]] = {
    "uniform": _uniform,
    "flicker": _flicker,
    "one polarity": _one_polarity,
    "pairs": _pairs,
    "hot pixels": _hot_pixels,
}
"""Name of a kind of noise -> function that makes about n events of it."""


def noise_windows(kind: str, n: int, rng: np.random.Generator) -> list[Columns]:
    """`n` windows of a kind of `NOISE`, with `FEWEST` to `MOST` events each."""
    counts = (int(np.exp(rng.uniform(np.log(FEWEST), np.log(MOST)))) for _ in range(n))
    return [_columns(NOISE[kind](count, rng)) for count in counts]


def noise(n: int) -> dict[str, Any]:
    """The rows of noise: windows in which nothing moves."""
    rng = np.random.default_rng(0)
    rows = {}
    for kind in NOISE:
        windows = noise_windows(kind, n, rng)
        paths = paths_of(windows, (SIDE, SIDE), SACCADE_US, MeasuredPixels())
        found_share = float(np.mean([not path.refused for path in paths]))
        rows[f"noise, {kind}"] = {"windows": n, "found": found_share}
    return rows


def _columns(columns: Iterable[np.ndarray]) -> Columns:
    t, x, y, p = columns
    return t.astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), p.astype(np.uint8)


def measure(nmnist: Path | None, n: int) -> dict[str, Any]:
    """The report. Without a folder of N-MNIST, its rows are left out."""
    rows = saccades(nmnist, n) if nmnist else {}
    rows |= swings(n)
    rows |= noise(n)
    return {"machine": machine(), "rows": rows}


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write the files that are asked for."""
    parser = script_parser("found_paths", __doc__, "eight windows of each kind")
    add_folder(parser, "--nmnist", "with Train/<digit>/*.bin (default: left out)")
    add_count(parser, "--windows", 200, "of each kind")
    args = parser.parse_args(argv)

    def measure_report(quick: bool) -> dict[str, Any]:
        return measure(args.nmnist, 8 if quick else args.windows)

    return run_script(parser, argv, measure_report, "found_paths")


if __name__ == "__main__":
    exit_with(main)
