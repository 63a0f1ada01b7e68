"""Made recordings of bars that move: classes that a small network tells apart in seconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from made import events_of

from experiments.digit_data.nmnist_files import write_nmnist

SLOPES = {"upright": 0.0, "flat": 0.5 * np.pi, "slanted": 0.25 * np.pi}


def bar(
    kind: str,
    seed: int,
    *,
    side: int = 128,
    n: int = 1500,
    duration_us: int = 100_000,
    start_us: int = 0,
):
    """A bar of that slope, drifting across itself: edges ahead ON, behind OFF."""
    rng = np.random.default_rng((seed, *map(ord, kind)))
    t = np.sort(rng.integers(0, duration_us, n))
    t[0] = 0
    along = rng.uniform(-0.35, 0.35, n) * side
    p = rng.integers(0, 2, n)
    drift = rng.choice([-1, 1]) * 0.06 * side * (t / 100_000 % 1)
    place = rng.uniform(-0.06, 0.06) * side
    edge = (2 * p - 1) * 0.04 * side
    across = place + drift + edge + rng.normal(0, 0.01 * side, n)
    cos = np.cos(SLOPES[kind])
    sin = np.sin(SLOPES[kind])
    x = np.rint(across * cos - along * sin + side / 2)
    y = np.rint(across * sin + along * cos + side / 2)
    x = np.clip(x, 0, side - 1).astype(int)
    y = np.clip(y, 0, side - 1).astype(int)
    return events_of(start_us + t, x, y, p)


def write(path: Path, events: np.ndarray, *, sensor: tuple[int, int] | None = (128, 128)) -> Path:
    """Write a recording as its suffix says; `.npz` with its sensor, unless that is None."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, events)
    elif path.suffix == ".npz":
        np.savez(path, events=events, **({} if sensor is None else {"sensor": np.array(sensor)}))
    elif path.suffix == ".csv":
        columns = np.column_stack([events[name] for name in "txyp"])
        np.savetxt(path, columns, fmt="%d", delimiter=",", header="t,x,y,p", comments="")
    else:
        write_nmnist(path, events)
    return path


def write_set(
    folder: Path,
    counts: dict[str, int],
    *,
    seed: int = 0,
    suffixes=(".npy", ".npz"),
    side: int = 128,
) -> Path:
    """So many recordings of each class, in the formats by turns, each with a start of its own."""
    for name, n in counts.items():
        for k in range(n):
            events = bar(name, 1000 * seed + k, side=side, start_us=10_000 * k)
            write(
                folder / name / f"{k:02d}{suffixes[k % len(suffixes)]}", events, sensor=(side, side)
            )
    return folder
