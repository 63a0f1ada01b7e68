"""Motions that nobody recorded, drawn at random.

direction   uniform
time        half of them last the whole window; the others .4 to 1 of it, somewhere in it
speed       half of them constant, half minimum jerk
shape       half of them straight; the others also go sideways meanwhile, by up to .4 of their
            length
turn        meanwhile they turn and grow or shrink
back        some turn round on their way, and come back
"""

from __future__ import annotations

import numpy as np

SHORTEST_TIME, WIDEST_BEND, TURNS_AT = 0.4, 0.4, (0.4, 0.9)
TURN, GROWTH = np.radians(6.0), 0.06


def random_motion(
    length: float,
    shares: np.ndarray,
    rng: np.random.Generator,
    *,
    most_turn: float = TURN,
    most_growth: float = GROWTH,
    back: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement at `shares` of the window, (n, 2), and turn, (n, 2), see `PeriodicImage`; 0 at
    half time.

    Parameters
    ----------
    length : of the motion, one way; the displacement's unit.
    shares : float64, (n,), increasing from 0 to 1.
    most_turn : in all, either way, in radians.
    most_growth : in all, either way: of the logarithm of the size.
    back : share of motions that turn round, at .4 to .9 of their time, and come back.
    """
    angle = rng.uniform(0.0, 2 * np.pi)
    lasts = 1.0 if rng.random() < 0.5 else rng.uniform(SHORTEST_TIME, 1.0)
    starts = rng.uniform(0.0, 1.0 - lasts)
    constant, curved = rng.random(2) < 0.5
    bend = rng.uniform(-WIDEST_BEND, WIDEST_BEND) if curved else 0.0
    bend_starts = rng.uniform(0.0, 0.5)
    turn = rng.uniform(-1, 1, 2) * (most_turn, most_growth)
    turns_at = rng.uniform(*TURNS_AT) if back and rng.random() < back else 1.0

    def position(share: np.ndarray) -> np.ndarray:
        u = np.clip((share - starts) / lasts, 0.0, 1.0)
        # at the same speed, to the start
        u = np.where(u < turns_at, u / turns_at, np.maximum(0.0, 2.0 - u / turns_at))
        forward = u if constant else minimum_jerk(u)
        aside = bend * minimum_jerk((u - bend_starts) / 0.5)
        cos, sin = length * np.cos(angle), length * np.sin(angle)
        displacement = forward * cos - aside * sin, forward * sin + aside * cos
        return np.stack([*displacement, forward * turn[0], forward * turn[1]], axis=-1)

    motion = position(shares) - position(np.array(0.5))
    return motion[:, :2], motion[:, 2:]


def minimum_jerk(share: np.ndarray) -> np.ndarray:
    """10 u^3 - 15 u^4 + 6 u^5: from 0 to 1, at rest at both ends."""
    u = np.clip(share, 0.0, 1.0)
    return np.asarray(u**3 * (10.0 - 15.0 * u + 6.0 * u**2))
