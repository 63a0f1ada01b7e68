"""Motions that were not recorded, drawn at random around the length of the recorded ones.

direction   uniform
length      half to double the recorded motions' length
time        half of them last the whole window; the others .4 to 1 of it, somewhere in it
speed       half of them constant, half minimum jerk
shape       half of them straight; the others also go sideways meanwhile, by up to .4 of their length
place       at half time the object's centre lies between where it was recorded at half time and the sensor's
            centre, and up to an eleventh of the sensor's smaller side (3 of 34 pixels) beside
"""

from __future__ import annotations

import numpy as np

from async_tnt.resynthesis.paths import minimum_jerk

LENGTHS = (0.5, 2.0)
SHORTEST_TIME = 0.4
WIDEST_BEND = 0.4
PLACE_SHARE = 1 / 11


def random_motion(length: float, shares: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Displacement at `shares` of the window, (n, 2), 0 at half time.

    Parameters
    ----------
    length : of the recorded motions; the result's unit.
    shares : float64, (n,), increasing from 0 to 1.
    """
    length = length * rng.uniform(*LENGTHS)
    angle = rng.uniform(0.0, 2 * np.pi)
    lasts = 1.0 if rng.random() < 0.5 else rng.uniform(SHORTEST_TIME, 1.0)
    starts = rng.uniform(0.0, 1.0 - lasts)
    constant, curved = rng.random(2) < 0.5
    bend = rng.uniform(-WIDEST_BEND, WIDEST_BEND) if curved else 0.0
    bend_starts = rng.uniform(0.0, 0.5)

    def position(share: np.ndarray) -> np.ndarray:
        u = np.clip((share - starts) / lasts, 0.0, 1.0)
        forward = length * (u if constant else minimum_jerk(u))
        aside = length * bend * minimum_jerk((u - bend_starts) / 0.5)
        cos, sin = np.cos(angle), np.sin(angle)
        return np.stack([forward * cos - aside * sin, forward * sin + aside * cos], axis=-1)

    return np.asarray(position(shares) - position(np.array(0.5)))


def random_place(recorded: np.ndarray, sensor: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Where the object's centre is at half time, (x, y), if it was recorded at `recorded`, in pixels."""
    centre = (np.array(sensor) - 1) / 2
    aside = PLACE_SHARE * (min(sensor) - 1)
    return np.asarray(recorded + rng.random() * (centre - recorded) + rng.uniform(-aside, aside, 2))
