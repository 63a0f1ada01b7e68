"""How the image moves over the sensor: displacement in pixels as a function of time.

A displacement (dx, dy) puts the image's pixel (column 0, row 0) on the sensor's point (x, y) = (dx,
dy); x grows to the right, y downwards. The image moves as a whole: its optical flow is the
derivative of the displacement, the same at every point of the image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike


class Trajectory(Protocol):
    """A motion, as the simulator needs it."""

    @property
    def duration_us(self) -> int:
        """Time from the first frame to the last, in microseconds."""
        ...

    def position(self, t_us: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Displacement (dx, dy) at each time, in pixels; each of the shape of `t_us`."""
        ...


@dataclass(frozen=True)
class ConstantVelocity:
    """Motion at constant velocity: (dx, dy)(t) = start + velocity t.

    Attributes
    ----------
    velocity : (vx, vy) in pixels per second.
    start : displacement at t = 0, in pixels. (3, 3) centres a 28 x 28 image on a 34 x 34 sensor.
    duration_us : duration of the motion, in microseconds.
    """

    velocity: tuple[float, float]
    start: tuple[float, float] = (3.0, 3.0)
    duration_us: int = 105_000

    def __post_init__(self) -> None:
        _check_pair("velocity", self.velocity)
        _check_pair("start", self.start)
        _check_duration(self.duration_us)

    @classmethod
    def towards(
        cls,
        angle_deg: float,
        speed: float,
        *,
        centre: tuple[float, float] = (3.0, 3.0),
        duration_us: int = 105_000,
    ) -> ConstantVelocity:
        """The motion at `speed` pixels per second towards `angle_deg`.

        An angle of 0 degrees is to the right, 90 degrees downwards. The displacement is `centre` at
        half of `duration_us`.
        """
        vx = speed * math.cos(math.radians(angle_deg))
        vy = speed * math.sin(math.radians(angle_deg))
        half_s = duration_us * 0.5e-6
        return cls((vx, vy), (centre[0] - vx * half_s, centre[1] - vy * half_s), duration_us)

    def position(self, t_us: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Displacement (dx, dy) at the times `t_us`, in pixels; each of their shape."""
        t_s = np.asarray(t_us, np.float64) * 1e-6
        return self.start[0] + self.velocity[0] * t_s, self.start[1] + self.velocity[1] * t_s


@dataclass(frozen=True)
class Saccade:
    """One quick movement by (`dx`, `dy`) pixels from `start_us` on, with bell-shaped speed.

    The movement takes `duration_us`. With u = (t - start_us) / duration_us, clipped to [0, 1], the
    covered share of the path is

        s(u) = 10 u^3 - 15 u^4 + 6 u^5.

    This is the minimum-jerk profile (Flash and Hogan 1985): at rest at both ends, halfway at 15/8
    of the mean speed.
    """

    start_us: float
    duration_us: float
    dx: float
    dy: float

    def __post_init__(self) -> None:
        _check_pair("dx, dy", (self.dx, self.dy))
        _check_duration(self.duration_us)

    def progress(self, t_us: ArrayLike) -> np.ndarray:
        """The covered share s of the path at times `t_us`: 0 before the saccade, 1 after it."""
        u = np.clip((np.asarray(t_us, np.float64) - self.start_us) / self.duration_us, 0.0, 1.0)
        return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


@dataclass(frozen=True)
class Saccades:
    """Several saccades: (dx, dy)(t) = start + the sum of their displacements at t.

    Saccades may overlap in time. Two of them that overlap make a curved path, if their directions
    differ.

    Attributes
    ----------
    start : displacement before the first saccade, in pixels.
    saccades : the movements.
    duration_us : duration of the recording, in microseconds.
    """

    start: tuple[float, float]
    saccades: tuple[Saccade, ...]
    duration_us: int

    def __post_init__(self) -> None:
        _check_pair("start", self.start)
        _check_duration(self.duration_us)

    def position(self, t_us: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Displacement (dx, dy) at the times `t_us`, in pixels; each of their shape."""
        dx = np.full(np.shape(t_us), float(self.start[0]))
        dy = np.full(np.shape(t_us), float(self.start[1]))
        for saccade in self.saccades:
            progress = saccade.progress(t_us)
            dx += saccade.dx * progress
            dy += saccade.dy * progress
        return dx, dy


_NMNIST_START = (0.46, 1.1)  # px
_NMNIST_MOVES_X = (  # saccade (0, 1, 2), centre (ms), duration (ms), distance (px)
    (0, 18.2, 37.0, -0.15),
    (0, 60.4, 44.5, 1.56),
    (1, 125.0, 109.1, 1.32),
    (1, 135.6, 45.1, 1.34),
    (1, 169.7, 40.3, 0.79),
    (1, 201.0, 45.0, 0.55),
    (2, 237.6, 31.7, -1.76),
    (2, 257.1, 37.2, -2.32),
    (2, 278.6, 41.2, -1.18),
)
_NMNIST_MOVES_Y = (
    (0, 41.5, 79.7, 5.37),
    (1, 99.9, 32.8, -0.10),
    (1, 151.9, 75.0, -5.03),
    (2, 265.6, 52.3, -0.32),
)
_NMNIST_DELAY_SD_MS = (0.6, 3.2, 2.4)


def nmnist_saccades(rng: np.random.Generator | None = None) -> Saccades:
    """The motion in an N-MNIST recording: three saccades round a triangle, in 308 ms.

    The image moves by (1.4, 5.4) px, then by (4.0, -5.1), then by (-5.3, -0.3). The camera's motors
    moved unevenly, so the displacement along each axis is a sum of bell-shaped movements.

    The movements are fitted to the flow in 200 of N-MNIST's first 1,000 training recordings. For
    every 4 ms, the signed event counts of these recordings were regressed on the gradients of the
    log images that they show. The images were displaced so that they explain most of the counts:
    about two thirds of their variance in mid-saccade. This displacement gives the position, and the
    regression gives the velocity, each measured independently. The integral of the velocity agrees
    with the position within 0.12 px (standard deviation).

    Parameters
    ----------
    rng : draws a delay for each saccade, as measured: normal with standard deviations of 0.6, 3.2
        and 2.4 ms. (Real delays come in steps of about 5 ms.) None: no delays.

    References
    ----------
    Orchard et al. 2015, Converting Static Image Datasets to Spiking Neuromorphic Datasets Using
    Saccades: three movements of about 100 ms each along an isosceles triangle.
    """
    delays_ms = np.zeros(3) if rng is None else rng.normal(0.0, _NMNIST_DELAY_SD_MS)

    def start_us(saccade: int, centre: float, duration: float) -> float:
        return 1e3 * (centre - duration / 2 + float(delays_ms[saccade]))

    along_x = [
        Saccade(start_us(saccade_number, centre_ms, lasting_ms), 1e3 * lasting_ms, px, 0.0)
        for saccade_number, centre_ms, lasting_ms, px in _NMNIST_MOVES_X
    ]
    along_y = [
        Saccade(start_us(saccade_number, centre_ms, lasting_ms), 1e3 * lasting_ms, 0.0, px)
        for saccade_number, centre_ms, lasting_ms, px in _NMNIST_MOVES_Y
    ]
    return Saccades(_NMNIST_START, tuple(along_x + along_y), duration_us=308_000)


def _check_pair(name: str, pair: tuple[float, float]) -> None:
    if len(pair) != 2 or not all(math.isfinite(value) for value in pair):
        raise ValueError(f"`{name}` must be two finite numbers, got {pair}")


def _check_duration(duration_us: float) -> None:
    if not (math.isfinite(duration_us) and duration_us > 0):
        raise ValueError(
            f"`duration_us` must be a positive number of microseconds, got {duration_us}"
        )
