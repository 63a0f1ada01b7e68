"""The motions of N-MOVING-MNIST: 10 directions x 3 distances, the same for every digit.

The thesis has 30 motions (in one place, "30 motion directions"), and names neither their directions
nor their distances. Ours have directions of 0, 36, ... 324 degrees (0 to the right, 90 downwards)
and distances of 3, 5 and 8 pixels in one window of 105 ms, which is 29 to 76 px/s. N-MNIST's own
saccades cover about 5 px in such a window.

Each motion is a straight line that passes the centre at half time. So the mean position of a digit
is the same for all motions, and a network cannot tell the motions apart by this position. These
motions start at different places, so TNT about the image centre does not turn them into
translations of each other: Proposition 2 asks for motions from one place. The kinds
"...-from-centre" start at one place, the centre. The thesis seems to have used motions from the
centre, with constant velocity.

The kind "beyond" has motions that motion re-synthesis never draws: 14 pixels along a line, 5 pixels
out and back, and round a loop of 4 by 4 pixels.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass

import numpy as np

from experiments.motions.trajectories import (
    ConstantVelocity,
    Saccade,
    Saccades,
    Trajectory,
    nmnist_saccades,
)

FROM_CENTRE = "-from-centre"
"""Ending of the kinds whose motions start at the sensor's centre."""

KINDS = ("constant", "bell", "constant" + FROM_CENTRE, "bell" + FROM_CENTRE, "beyond", "nmnist")
"""Kinds of motions, see `Motion`."""

DIRECTIONS_DEG = tuple(range(0, 360, 36))
"""Directions of motion, in degrees, 0 to the right and 90 downwards."""

DISTANCES_PX = (3, 5, 8)
"""Lengths of the displacement in a window, in pixels."""

BEYOND_PX = {"line": 14, "back": 5, "loop": 4}
"""Shape of a path of kind "beyond" -> its distance in pixels."""

WINDOW_US = 105_000
"""Duration of a motion, in microseconds."""

NMNIST_US = 308_000
"""Duration of the three saccades of N-MNIST, in microseconds."""

FLOW_STEP_US = 3_500
"""Time between two samples of a flow that changes, in microseconds. It divides `WINDOW_US` and
`NMNIST_US`."""

NMNIST_SENSOR = (34, 34)
"""N-MNIST's sensor, width and height in pixels."""


@dataclass(frozen=True)
class Motion:
    """One motion of the set.

    Attributes
    ----------
    kind : "constant" velocity; "bell", the same displacement with the bell-shaped speed of a
        saccade (minimum jerk: at rest at both ends, 15/8 of its mean speed halfway);
        "constant-from-centre" and "bell-from-centre", the same displacements, which start at the
        sensor's centre; "beyond", see `BEYOND_PX`; or "nmnist", N-MNIST's three saccades.
    index : index in `motions_of(kind)`. It is part of every recording's seed.
    name : name such as "036deg-5px". Names have the same order as indices.
    direction_deg, distance_px : direction and length of the displacement; None for "nmnist". For
        the shape "back" they describe the way out, for "loop" the first side.
    shape : shape of the path: "line", "back" or "loop".
    """

    kind: str
    index: int
    name: str
    direction_deg: int | None
    distance_px: int | None
    shape: str = "line"

    @property
    def duration_us(self) -> int:
        """How long a recording of this motion lasts, in microseconds."""
        return NMNIST_US if self.kind == "nmnist" else WINDOW_US

    @property
    def flow_times_us(self) -> np.ndarray:
        """Times at which the optical flow is sampled, int64, shape (K,).

        A constant flow is sampled once, at half time.
        """
        if self.kind.removesuffix(FROM_CENTRE) == "constant":
            return np.array([self.duration_us // 2], np.int64)
        return np.arange(0, self.duration_us + 1, FLOW_STEP_US, dtype=np.int64)

    def trajectory(
        self,
        rng: np.random.Generator,
        *,
        image: tuple[int, int] = (28, 28),
        sensor: tuple[int, int] = NMNIST_SENSOR,
    ) -> Trajectory:
        """The displacement over time.

        Parameters
        ----------
        rng : draws the delays of N-MNIST's saccades; the other kinds do not use it.
        image, sensor : sizes (width, height) in pixels. The image is in the sensor's centre at half
            time, or at the start for the kinds from the centre. N-MNIST's path was measured on a
            sensor of 34 x 34 pixels; it is moved with the centre of other sensors.
        """
        centre = ((sensor[0] - image[0]) / 2, (sensor[1] - image[1]) / 2)
        if self.kind == "nmnist":
            saccades = nmnist_saccades(rng)
            start = (saccades.start[0] + (centre[0] - 3.0), saccades.start[1] + (centre[1] - 3.0))
            return dataclasses.replace(saccades, start=start)

        # for mypy: only the motion of "nmnist" has no direction
        assert self.direction_deg is not None and self.distance_px is not None
        starts_at_centre = self.kind.endswith(FROM_CENTRE)
        if self.kind.startswith("constant") or (self.kind, self.shape) == ("beyond", "line"):
            speed = self.distance_px / (self.duration_us * 1e-6)
            motion = ConstantVelocity.towards(
                self.direction_deg, speed, centre=centre, duration_us=self.duration_us
            )
            return dataclasses.replace(motion, start=centre) if starts_at_centre else motion
        angle = math.radians(self.direction_deg)
        dx = self.distance_px * math.cos(angle)
        dy = self.distance_px * math.sin(angle)
        start = centre if starts_at_centre else (centre[0] - dx / 2, centre[1] - dy / 2)
        sides = {
            "line": [(dx, dy)],
            "back": [(dx, dy), (-dx, -dy)],
            "loop": [(dx, dy), (-dy, dx), (-dx, -dy), (dy, -dx)],
        }[self.shape]
        # The saccades of a loop's sides overlap by half of their time, which rounds the corners. So
        # a new side begins at each step, and a side of a loop takes two steps.
        steps_of_side = 2 if self.shape == "loop" else 1
        step_us = self.duration_us / (len(sides) + steps_of_side - 1)
        side_us = steps_of_side * step_us
        moves = (Saccade(k * step_us, side_us, *side) for k, side in enumerate(sides))
        return Saccades(start, tuple(moves), self.duration_us)


def flow_of(trajectory: Trajectory, times_us: np.ndarray) -> np.ndarray:
    """Optical flow (vx, vy), in pixels per second, shape (K, 2).

    It is the derivative of the displacement, by differences over two microseconds.
    """
    after = np.stack(trajectory.position(times_us + 1.0), axis=1)
    before = np.stack(trajectory.position(times_us - 1.0), axis=1)
    return np.asarray((after - before) / 2e-6)


def motions_of(kind: str = "constant") -> tuple[Motion, ...]:
    """All motions of a kind, in order of their index.

    The kind "nmnist" has one motion. Every other kind has 30: three for each of ten directions.

    Raises
    ------
    ValueError : unknown kind.

    Example
    -------
    >>> [motion.name for motion in motions_of()][:4]
    ['000deg-3px', '000deg-5px', '000deg-8px', '036deg-3px']
    """
    if kind not in KINDS:
        raise ValueError(
            f"`kind` of motion must be one of {', '.join(map(repr, KINDS))}, got {kind!r}"
        )
    if kind == "nmnist":
        return (Motion(kind, 0, "nmnist", None, None),)
    if kind == "beyond":
        paths = list(BEYOND_PX.items())
    else:
        paths = [("line", distance) for distance in DISTANCES_PX]
    motions: list[Motion] = []
    for direction, (shape, px) in itertools.product(DIRECTIONS_DEG, paths):
        path = f"{px}px" if shape == "line" else shape
        name = f"{direction:03}deg-{path}"
        motions.append(Motion(kind, len(motions), name, direction, px, shape))
    return tuple(motions)
