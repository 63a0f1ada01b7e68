"""Draw motions at random.

direction   All directions are equally likely.
time        Half of the motions last the whole window. The others last .4 to 1 of the window, and
            begin at a random time.
speed       Half of the motions have a constant speed. The others have a speed of minimum jerk, see
            `minimum_jerk`.
shape       Half of the motions are straight. The others also go sideways, by up to .4 of their
            length.
turn        During a motion the object turns, and grows or shrinks.
back        Some motions turn round on their way and come back.
"""

from __future__ import annotations

import numpy as np

SHORTEST_TIME = 0.4
"""Least duration of a motion, as a share of the window."""
WIDEST_BEND = 0.4
"""Largest distance that a motion goes sideways, as a share of its length."""
TURNS_AT = (0.4, 0.9)
"""Range of the moment at which a motion turns round, as a share of the motion's duration."""
MOST_TURN = np.radians(6.0)
"""Largest turn of a whole motion, in radians."""
MOST_GROWTH = 0.06
"""Largest change of the logarithm of the object's size in a whole motion."""


def random_motion(
    length: float,
    shares: np.ndarray,
    rng: np.random.Generator,
    *,
    most_turn: float = MOST_TURN,
    most_growth: float = MOST_GROWTH,
    back: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Draw a motion.

    Parameters
    ----------
    length : distance from the start to the farthest point, without the sideways motion. The
        displacement has the same unit.
    shares : float64, (n,), moments as shares of the window, increasing from 0 to 1.
    rng : draws the motion.
    most_turn : largest turn of the whole motion, in either direction, in radians.
    most_growth : largest change of the logarithm of the size, in either direction.
    back : share of the motions that turn round and come back, see `TURNS_AT`.

    Returns
    -------
    Displacement and turn at these moments, float64, (n, 2) each, see `PeriodicImage.frames`. Both
    are 0 at half of the window.
    """
    angle = rng.uniform(0.0, 2 * np.pi)
    duration = 1.0 if rng.random() < 0.5 else rng.uniform(SHORTEST_TIME, 1.0)
    start = rng.uniform(0.0, 1.0 - duration)
    is_constant, is_curved = rng.random(2) < 0.5
    bend = rng.uniform(-WIDEST_BEND, WIDEST_BEND) if is_curved else 0.0
    bend_start = rng.uniform(0.0, 0.5)
    turn = rng.uniform(-1, 1, 2) * (most_turn, most_growth)
    # 1: the motion does not turn round
    turning_point = rng.uniform(*TURNS_AT) if back and rng.random() < back else 1.0

    def position(share: np.ndarray) -> np.ndarray:
        """The change of x, y, angle and log size since the motion's start: (n, 4)."""
        u = np.clip((share - start) / duration, 0.0, 1.0)
        # the way back is as fast as the way out, and ends at the start
        u = np.where(u < turning_point, u / turning_point, np.maximum(0.0, 2.0 - u / turning_point))
        # the distances forwards and sideways, as shares of the length
        forward = u if is_constant else minimum_jerk(u)
        aside = bend * minimum_jerk((u - bend_start) / 0.5)
        cos = length * np.cos(angle)
        sin = length * np.sin(angle)
        x = forward * cos - aside * sin
        y = forward * sin + aside * cos
        return np.stack([x, y, forward * turn[0], forward * turn[1]], axis=-1)

    motion = position(shares) - position(np.array(0.5))
    return motion[:, :2], motion[:, 2:]


def minimum_jerk(share: np.ndarray) -> np.ndarray:
    """The position 10 u^3 - 15 u^4 + 6 u^5 at the time u = `share`.

    It goes from 0 to 1, and is at rest at both ends.
    """
    u = np.clip(share, 0.0, 1.0)
    return np.asarray(u**3 * (10.0 - 15.0 * u + 6.0 * u**2))
