"""An image that moves, turns and grows before a sensor, and its events. It repeats itself, so that
it has no border."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from async_tnt.kernels.training.moving_image import move_periodic
from async_tnt.simulation.simulator import PixelModel, simulate
from async_tnt.volume.events import EVENT_DTYPE

MOST_VALUES = 1 << 22
"""Of frames in memory: a large sensor is simulated in bands of rows."""


@dataclass(frozen=True)
class PeriodicImage:
    """An image before a sensor.

    Parameters
    ----------
    image : float64, (h, w): log luminance, bilinear between its places.
    step : its places in a sensor pixel.
    origin : where its first place is, in sensor pixels, in x and in y.
    centre : float64, (2,): what it turns about, (x, y) in sensor pixels.
    sensor : (width, height), in pixels.
    """

    image: np.ndarray
    step: float
    origin: float
    centre: np.ndarray
    sensor: tuple[int, int]

    def frames(
        self,
        displacement: np.ndarray,
        turn: np.ndarray | None = None,
        first: int = 0,
        n_rows: int | None = None,
    ) -> np.ndarray:
        """What the sensor sees.

        Parameters
        ----------
        displacement : float64, (n, 2): of the centre, in sensor pixels.
        turn : float64, (n, 2): by which angle the image is turned about its centre, in radians,
            from x to y, and the logarithm of its size; None: 0.
        first, n_rows : the sensor's rows; None: all from `first` on.

        Returns
        -------
        float64, (n, n_rows, width).
        """
        width, height = self.sensor
        angle, growth = np.zeros((2, len(displacement))) if turn is None else turn.T
        cos, sin = np.exp(-growth) * np.cos(angle), np.exp(-growth) * np.sin(angle)
        # from the sensor to the image
        back = np.stack([cos, sin, -sin, cos], axis=-1).reshape(-1, 2, 2)
        places = np.empty((len(displacement), 2, 3))
        places[..., :2] = back
        places[..., 2] = self.centre - np.einsum("kij,kj->ki", back, self.centre + displacement)
        frames = np.empty((len(places), height - first if n_rows is None else n_rows, width))
        move_periodic(frames, self.image, places, first, self.origin, self.step)
        return frames

    def events(
        self,
        times_us: np.ndarray,
        displacement: np.ndarray,
        turn: np.ndarray | None,
        pixels: PixelModel,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Events of `pixels` while the image moves, see `frames`, from one time to the next; `rng`
        draws.

        Returns
        -------
        Structured array of `EVENT_DTYPE`, in order, times before the last of `times_us`.
        """
        width, height = self.sensor
        n_rows = max(1, MOST_VALUES // (len(times_us) * width))
        parts = []
        for first in range(0, height, n_rows):
            frames = self.frames(displacement, turn, first, min(n_rows, height - first))
            part = simulate(frames, times_us, rng, pixels)
            part["y"] += first
            parts.append(part)
        events = np.concatenate(parts).astype(EVENT_DTYPE, copy=False)
        if len(parts) > 1:
            events = events[np.argsort(events["t"], kind="stable")]
        return events[events["t"] < times_us[-1]]  # the last half microsecond is rounded up
