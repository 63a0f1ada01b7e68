"""Made noise of several kinds: recordings in which nothing is there."""

from __future__ import annotations

import numpy as np

from async_tnt.events import structured
from experiments.bench_moments import made_columns

KINDS = {
    "uniform": "over pixels, time and polarity, as in training",
    "few": "the same, a fifteenth of the events",
    "flicker": "of the light: everywhere at once, every 10 ms, ON and OFF in turns",
    "pairs": "two neighbouring pixels at a time",
    "one polarity": "ON alone, as leak events are",
}
FLICKER_US, BURST_US = 10_000, 1_000


def made_noise(kind: str, rng: np.random.Generator, sensor: tuple[int, int], n: int, duration_us: int) -> np.ndarray:
    """About n events of one of `KINDS`, in order of time."""
    if kind == "pairs":
        t, x, y, p = (c.repeat(2) for c in made_columns(rng, (sensor[0] - 1, sensor[1]), n // 2, duration_us))
        x[1::2] += 1
        return structured((t, x, y, p))
    t, x, y, p = made_columns(rng, sensor, n // 15 if kind == "few" else n, duration_us)
    if kind == "flicker":
        t = np.sort(rng.integers(0, duration_us // FLICKER_US, n) * FLICKER_US + rng.integers(0, BURST_US, n))
        p = (t // FLICKER_US % 2).astype(np.uint8)
    elif kind == "one polarity":
        p = np.ones_like(p)
    return structured((t, x, y, p))
