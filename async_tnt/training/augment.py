"""Augmentation of events: every epoch changes every window at random. All of it is our choice.

A window is moved in time and on the sensor, thinned, and sometimes mirrored, cut short, or made to show nothing:

    start      a live stream's windows start at its first event, some milliseconds into N-MNIST's saccade;
               TNT magnifies what happens near the start, so the network must not rely on it
    position   (x', y') = A (x - c) + c + shift      A = rotation * shear * scale * mirror
    thinning   each event is kept with a probability that is drawn per window
    partial    the window ends early, as training for decisions before its end
    nothing    each event gets a position anywhere on the sensor: nothing is there, but as many events as ever

After a rotation, positions are not whole pixels. Rounding them would leave stripes in the volume, so augmented events
are on a sensor `FINE` times finer (see `fineness`) with the same corners; as the grid is mapped from corner to corner,
it stays the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from async_tnt.config import MAX_SIDE, TIME_IMAGES, TNTConfig

FINE = 32


@dataclass(frozen=True)
class Draws:
    """How each of N windows is augmented.

    Parameters
    ----------
    start_us : int64, (N,). Added to the window's start.
    until_us : int64, (N,). Events at or after this time since the window's start are dropped.
    matrix : float64, (N, 2, 3). (x', y') = matrix @ (x, y, 1), rounded, in pixels of `sensor`.
    keep : float64, (N,). Probability that an event is kept.
    seed : uint64, (N,). Decides which events are kept, and where they are scattered.
    scatter : bool, (N,). Events are put anywhere on `sensor` instead.
    sensor : (width, height) of the augmented events' sensor; events beyond it are dropped.
    """

    start_us: np.ndarray
    until_us: np.ndarray
    matrix: np.ndarray
    keep: np.ndarray
    seed: np.ndarray
    scatter: np.ndarray
    sensor: tuple[int, int]


def fineness(sensor: tuple[int, int]) -> int:
    """How many times finer the sensor of augmented events is: `FINE`, or less for a sensor of over 1024 pixels.

    Examples
    --------
    >>> fineness((34, 34)), fineness((1280, 720))
    (32, 25)
    """
    return max(1, min(FINE, (MAX_SIDE - 1) // (max(sensor) - 1)))


def unchanged(n: int, config: TNTConfig) -> Draws:
    """No augmentation: `n` unchanged windows."""
    matrix = np.zeros((n, 2, 3))
    matrix[:, 0, 0] = matrix[:, 1, 1] = 1.0
    return Draws(
        np.zeros(n, np.int64),
        np.full(n, config.window_us, np.int64),
        matrix,
        np.ones(n),
        np.zeros(n, np.uint64),
        np.zeros(n, bool),
        config.sensor,
    )


@dataclass(frozen=True)
class Augmentation:
    """The largest changes; every draw is uniform.

    Parameters
    ----------
    start_ms : shift of the window's start, in milliseconds, either way.
    shift_px : shift in x and in y, in sensor pixels.
    translate_px : an additional shift by a whole number of pixels, in x and in y (the thesis' augmentation).
    rotation_deg : rotation, in degrees, either way.
    scale : change of size, as a fraction.
    shear : shift of x, as a fraction of y.
    drop : fraction of the events that is dropped.
    partial : fraction of windows that end early, but not before `partial_from_ms`.
    mirror : half of the windows are mirrored from left to right.
    nothing : fraction of windows whose events are put anywhere on the sensor. They belong to no class.
    """

    start_ms: float = 5.0
    shift_px: float = 1.5
    translate_px: int = 0
    rotation_deg: float = 10.0
    scale: float = 0.1
    shear: float = 0.1
    drop: float = 0.3
    partial: float = 0.2
    partial_from_ms: float = 15.0
    mirror: bool = False
    nothing: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            limit = 1.0 if name in ("scale", "drop", "partial", "mirror", "nothing") else np.inf
            if not 0 <= value <= limit:
                raise ValueError(f"`{name}` must be in [0, {limit}], got {value}")

    @classmethod
    def for_sensor(cls, config: TNTConfig, **changes: Any) -> Augmentation:
        """The defaults, which are for N-MNIST's 34x34 pixels and 105 ms, scaled to another sensor and window.

        Parameters
        ----------
        config : has that sensor and window.
        changes : values of other fields.
        """
        larger = (min(config.sensor) - 1) / 33
        longer = config.window_us / 105_000
        scaled = cls(
            start_ms=cls.start_ms * longer,
            shift_px=cls.shift_px * larger,
            partial_from_ms=cls.partial_from_ms * longer,
        )
        return replace(scaled, **changes)

    def draw(self, n: int, config: TNTConfig, rng: np.random.Generator) -> Draws:
        """Random changes for `n` windows of this `config`, drawn by `rng`."""

        def spread(by: float) -> np.ndarray:
            return rng.uniform(-by, by, n)

        start_us = np.rint(spread(1e3 * self.start_ms)).astype(np.int64)
        angle = np.deg2rad(spread(self.rotation_deg))
        scale, shear = 1.0 + spread(self.scale), spread(self.shear)
        shift = np.stack([spread(self.shift_px), spread(self.shift_px)], axis=1)  # (n, 2)
        if self.translate_px:
            shift += rng.integers(-self.translate_px, self.translate_px + 1, (n, 2))
        keep = 1.0 - rng.uniform(0.0, self.drop, n)
        shortest = min(1e3 * self.partial_from_ms, config.window_us)
        until_us = np.rint(rng.uniform(shortest, config.window_us, n)).astype(np.int64)
        until_us[rng.random(n) >= self.partial] = config.window_us
        seed = rng.integers(0, 1 << 63, n, dtype=np.uint64)
        side = np.where(rng.random(n) < 0.5, -1.0, 1.0) if self.mirror else np.ones(n)
        scatter = rng.random(n) < self.nothing if self.nothing else np.zeros(n, bool)

        cos, sin = scale * np.cos(angle), scale * np.sin(angle)
        matrix = np.empty((n, 2, 3))
        matrix[:, 0, 0], matrix[:, 0, 1] = cos * side, cos * shear - sin
        matrix[:, 1, 0], matrix[:, 1, 1] = sin * side, sin * shear + cos
        center = (np.array(config.sensor) - 1) / 2
        matrix[:, :, 2] = center + shift - matrix[:, :, :2] @ center
        # an image of times takes an event between pixels for one of all of them
        fine = 1 if config.representation in TIME_IMAGES else fineness(config.sensor)
        sensor = ((config.sensor[0] - 1) * fine + 1, (config.sensor[1] - 1) * fine + 1)
        return Draws(start_us, until_us, fine * matrix, keep, seed, scatter, sensor)
