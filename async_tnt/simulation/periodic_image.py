"""An image that moves, turns and grows in front of a sensor, and the sensor's events.

The image repeats itself in x and in y, so that it has no border.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from async_tnt.kernels.training.moving_image import move_periodic
from async_tnt.simulation.simulator import PixelModel, simulate
from async_tnt.volume.events import EVENT_DTYPE

MOST_VALUES = 1 << 22
"""Most values of frames in memory. A large sensor is simulated in bands of rows, band by band."""


@dataclass(frozen=True)
class PeriodicImage:
    """An image in front of a sensor.

    Parameters
    ----------
    image : float64, (h, w): log luminance at h times w places. It is bilinear between the places.
    step : number of places along a side of a sensor pixel.
    origin : the x of the first place, in sensor pixels. Its y is the same.
    centre : float64, (2,): the point (x, y) about which the image turns, in sensor pixels.
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
        """The pictures that the sensor sees, at n moments.

        Parameters
        ----------
        displacement : float64, (n, 2): displacement of the image's centre, in sensor pixels.
        turn : float64, (n, 2). The first column is the angle by which the image is turned about its
            centre, in radians, from x to y. The second column is the logarithm of the image's size.
            None: both are 0.
        first : the first row of the sensor that is in the pictures.
        n_rows : number of rows of the sensor in the pictures. None: all rows from `first` on.

        Returns
        -------
        float64, (n, n_rows, width): log luminance.
        """
        width, height = self.sensor
        if turn is None:
            turn = np.zeros((len(displacement), 2))
        angle, growth = turn.T
        cos = np.exp(-growth) * np.cos(angle)
        sin = np.exp(-growth) * np.sin(angle)
        # These matrices turn a displacement on the sensor into a displacement in the image.
        to_image = np.stack([cos, sin, -sin, cos], axis=-1).reshape(-1, 2, 2)
        centre_on_sensor = self.centre + displacement
        places = np.empty((len(displacement), 2, 3))
        places[..., :2] = to_image
        places[..., 2] = self.centre - np.einsum("kij,kj->ki", to_image, centre_on_sensor)
        if n_rows is None:
            n_rows = height - first
        frames = np.empty((len(places), n_rows, width))
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
        """Events of the sensor while the image moves in front of it.

        Parameters
        ----------
        times_us : float64, (n,), increasing, in microseconds.
        displacement, turn : the motion of the image at these times, see `frames`.
        pixels : the sensor's pixels.
        rng : draws the differences between pixels, and noise.

        Returns
        -------
        Structured array of `EVENT_DTYPE`, in order of time. All times are before the last of
        `times_us`.
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
        # times are rounded, so an event of the last half microsecond may be at the end
        return events[events["t"] < times_us[-1]]
