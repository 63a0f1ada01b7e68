"""Events of an image under another motion: the project's simulator on the image of log luminance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from async_tnt.events import EVENT_DTYPE
from async_tnt.kernels.moving_image import move_periodic
from async_tnt.resynthesis.images import centre_of, finer
from async_tnt.resynthesis.moving_image import MovingImage
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.resynthesis.pixels import MeasuredPixels
from async_tnt.resynthesis.random_motions import random_motion, random_place
from async_tnt.simulation.simulator import PixelModel, simulate

N_PICTURES = 52
"""Pictures of a window; the light runs straight between them."""
FINENESS = 3
"""Places of the image along a cell: between them it is interpolated, which does not blur it visibly."""
MISMATCH = 0.12
"""Of the thresholds from pixel to pixel, as in `PixelModel`."""
THRESHOLD_SPREAD, REFRACTORY_SPREAD = 0.1, 0.4
MOST_VALUES = 1 << 22
"""Of pictures in memory: a large sensor is simulated in bands of rows."""


@dataclass(frozen=True)
class SimulatedPixels:
    """The sensor that re-synthesized events come from.

    Parameters
    ----------
    measured : what the recordings tell.
    scale : thresholds, in units of those that images are measured in; `calibration` finds it.
    """

    measured: MeasuredPixels
    scale: float = 1.0

    def draw(self, rng: np.random.Generator) -> PixelModel:
        """The pixels of one window, drawn by `rng`: thresholds and refractory time vary from window to window."""
        scale = self.scale * np.exp(THRESHOLD_SPREAD * rng.standard_normal())
        spread = rng.uniform(1 - REFRACTORY_SPREAD, 1 + REFRACTORY_SPREAD)
        return PixelModel(
            threshold_on=scale * self.measured.step_on,
            threshold_off=scale * self.measured.step_off,
            mismatch=MISMATCH,
            refractory_us=self.measured.refractory_us * spread,
            noise_hz=self.measured.noise_hz,
            noise_on_share=self.measured.noise_on_share,
        )


class MovedImage:
    """The image of one window, ready to be moved otherwise.

    Parameters
    ----------
    model : of the window.
    image : float64, (rows, columns) of the torus, in thresholds.
    path : how it was recorded.
    """

    def __init__(self, model: MovingImage, image: np.ndarray, path: MotionPath) -> None:
        self.model, self.path = model, path
        self._fine = finer(image, FINENESS)
        self._origin = (model.cell - 1) / 2  # the middle of the first cell, in sensor pixels
        self._halfway = path.at(np.array([0.5]))[0]
        centre = self._origin + model.cell * centre_of(image) + self._halfway
        torus, middle = model.cell * np.array(model.shape[::-1]), (np.array(model.sensor) - 1) / 2
        # the torus has no first cell: of the equivalent places, the one nearest to the sensor's centre
        self._centre = middle + (centre - middle + torus / 2) % torus - torus / 2

    def as_recorded(self, pixels: SimulatedPixels, rng: np.random.Generator) -> np.ndarray:
        """Events of simulated `pixels` under the motion that was recorded; `rng` draws."""
        return self.events(self.path.at(shares()), pixels, rng)

    def moved(self, length: float, pixels: SimulatedPixels, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Events under a random motion, and the motion: displacement since the window's start, (n, 2), in pixels.

        Parameters
        ----------
        length : of the recorded motions, in sensor pixels.
        pixels : of the simulated sensor.
        rng : draws the motion, the pixels and their noise.
        """
        motion = random_motion(length, shares(), rng)
        place = random_place(self._centre, self.model.sensor, rng)
        displacement = self._halfway + (place - self._centre) + motion
        return self.events(displacement, pixels, rng), motion - motion[0]

    def events(self, displacement: np.ndarray, pixels: SimulatedPixels, rng: np.random.Generator) -> np.ndarray:
        """Events of `pixels` while the image moves by `displacement`, (N_PICTURES, 2), in sensor pixels; `rng` draws.

        Returns
        -------
        Structured array of `EVENT_DTYPE`, in order, times in [0, window_us).
        """
        width, height = self.model.sensor
        times_us = self.model.window_us * shares()
        drawn = pixels.draw(rng)
        n_rows = max(1, MOST_VALUES // (N_PICTURES * width))
        parts = []
        for first in range(0, height, n_rows):
            part = simulate(self.pictures(displacement, first, min(n_rows, height - first)), times_us, rng, drawn)
            part["y"] += first
            parts.append(part)
        events = np.concatenate(parts).astype(EVENT_DTYPE, copy=False)
        if len(parts) > 1:
            events = events[np.argsort(events["t"], kind="stable")]
        return events[events["t"] < self.model.window_us]  # the last half microsecond is rounded up

    def pictures(self, displacement: np.ndarray, first: int = 0, n_rows: int | None = None) -> np.ndarray:
        """What `n_rows` of the sensor's rows (None: all) from `first` on see at each `displacement`, (n, 2): shape
        (n, n_rows, width), in thresholds."""
        width, height = self.model.sensor
        dx, dy = np.ascontiguousarray(displacement.T)
        pictures = np.empty((len(dx), height - first if n_rows is None else n_rows, width))
        move_periodic(pictures, self._fine, dx, dy, first, self._origin, FINENESS / self.model.cell)
        return pictures


def shares() -> np.ndarray:
    """Of the window, from 0 to 1, at each picture."""
    return np.linspace(0.0, 1.0, N_PICTURES)
