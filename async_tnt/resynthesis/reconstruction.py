"""Find the image and the path of a window from its events, and simulate other motions of the image.

Another motion is drawn at random, see `random_motion`. Its length is between half and double the
length of the recorded motions. The place of the object's centre at half time is drawn in two steps.
First, a point is drawn on the line from the centre's recorded place at half time to the sensor's
centre. Then this point is moved in x and in y, by up to an eleventh of the sensor's smaller side
(3 of 34 pixels).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from async_tnt.resynthesis.moving_image import N_FRAMES, MovingImage, centre_of, find_images, finer
from async_tnt.resynthesis.paths import MotionPath, PathFinder
from async_tnt.simulation.measured_pixels import Columns, MeasuredPixels, part_of
from async_tnt.simulation.periodic_image import PeriodicImage
from async_tnt.simulation.random_motion import random_motion
from async_tnt.simulation.simulator import PixelModel

N_PICTURES = 52
"""Number of pictures of a window. The light changes linearly from one picture to the next."""
FINENESS = 3
"""Number of places of the image along a side of a cell. The image is interpolated between these
places. With three of them, the interpolation does not blur it visibly."""
SPAN = 3
"""Number of windows in which a path is searched if one window alone does not tell its path: the
window before it, the window itself, and the window after it."""
OTHER_LENGTHS = (0.5, 2.0)
"""Range of the length of another motion, as a share of the recorded length."""
PLACE_SHARE = 1 / 11
"""Largest distance by which the object is moved in x and in y, as a share of the sensor's smaller
side."""
BATCH = 64
"""Number of windows that are processed at a time. Their spectra and images take about 40 MB."""
THRESHOLD_SPREAD = 0.1
"""Standard deviation, over windows, of the log of the thresholds."""
REFRACTORY_SPREAD = 0.4
"""Largest difference between the refractory time of a window and the calibrated one, as a share."""


@dataclass(frozen=True)
class SimulatedPixels:
    """The distribution of the pixels that re-synthesized events come from.

    Parameters
    ----------
    measured : the pixels as measured on recordings, with the mean refractory time.
    scale : factor of the thresholds. The unit of the images is the thresholds with scale 1.
        `calibrate` finds the scale.
    """

    measured: MeasuredPixels
    scale: float = 1.0

    def draw(self, rng: np.random.Generator) -> PixelModel:
        """Draw the pixels of one window. Thresholds and refractory time vary between windows."""
        scale = self.scale * np.exp(THRESHOLD_SPREAD * rng.standard_normal())
        spread = rng.uniform(1 - REFRACTORY_SPREAD, 1 + REFRACTORY_SPREAD)
        return PixelModel(
            threshold_on=scale * self.measured.step_on,
            threshold_off=scale * self.measured.step_off,
            refractory_us=self.measured.refractory_us * spread,
            noise_hz=self.measured.noise_hz,
            noise_on_share=self.measured.noise_on_share,
            after_share=self.measured.after_share,
        )


class MovedImage:
    """The image of one window, which can be moved on other paths.

    Parameters
    ----------
    model : the model with which the image was found.
    image : float64, (rows, columns) of the torus, in thresholds: the image at the path's start.
    path : the path on which the image was recorded.

    Attributes
    ----------
    picture : the same image, in thresholds, in front of the sensor.
    """

    def __init__(self, model: MovingImage, image: np.ndarray, path: MotionPath) -> None:
        self.model = model
        self.path = path
        # the middle of the first cell, in sensor pixels
        origin = (model.cell - 1) / 2
        # the displacement at half time, since the path's start
        self._halfway = path.window_start + path.at(np.array([0.5]))[0]
        centre = origin + model.cell * centre_of(image) + self._halfway
        torus = model.cell * np.array(model.shape[::-1])
        middle = (np.array(model.sensor) - 1) / 2
        # Because of the torus, the centre has many equivalent places. Take the place that is
        # nearest to the sensor's centre.
        self._centre = middle + (centre - middle + torus / 2) % torus - torus / 2
        start = self._centre - self._halfway
        self.picture = PeriodicImage(
            finer(image, FINENESS), FINENESS / model.cell, origin, start, model.sensor
        )

    def as_recorded(self, distribution: SimulatedPixels, rng: np.random.Generator) -> np.ndarray:
        """Events under the recorded motion. `rng` draws pixels from `distribution`, and noise."""
        displacement = self.path.window_start + self.path.at(shares())
        return self.events(displacement, np.zeros((N_PICTURES, 2)), distribution, rng)

    def moved(
        self, length: float, distribution: SimulatedPixels, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Events under a random motion.

        Parameters
        ----------
        length : length of the recorded motions, in sensor pixels.
        distribution : the distribution of the pixels.
        rng : draws the motion, the pixels and their noise.

        Returns
        -------
        The events, and the motion: the displacement since the window's start, (n, 2), in pixels.
        """
        motion, turn = random_motion(length * rng.uniform(*OTHER_LENGTHS), shares(), rng)
        middle = (np.array(self.model.sensor) - 1) / 2
        most_px = PLACE_SHARE * (min(self.model.sensor) - 1)
        to_middle = rng.random() * (middle - self._centre)
        place = self._centre + to_middle + rng.uniform(-most_px, most_px, 2)
        displacement = self._halfway + (place - self._centre) + motion
        return self.events(displacement, turn, distribution, rng), motion - motion[0]

    def events(
        self,
        displacement: np.ndarray,
        turn: np.ndarray,
        distribution: SimulatedPixels,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Events under a given motion.

        Parameters
        ----------
        displacement, turn : the motion at the times `shares()`, see `PeriodicImage.frames`.
        distribution : the distribution of the pixels.
        rng : draws the pixels and their noise.
        """
        times_us = self.model.window_us * shares()
        pixels = distribution.draw(rng)
        return self.picture.events(times_us, displacement, turn, pixels, rng)


def shares() -> np.ndarray:
    """The share of the window that has passed at each of the `N_PICTURES`, from 0 to 1."""
    return np.linspace(0.0, 1.0, N_PICTURES)


class Reconstruction:
    """Finds the paths and images of windows, for one sensor and one length of windows.

    Parameters
    ----------
    sensor : (width, height), in pixels.
    window_us : length of the windows.
    cell : number of sensor pixels along a side of the model's cells, see `cell_for`.

    Attributes
    ----------
    model : the windows' `MovingImage`.
    """

    def __init__(self, sensor: tuple[int, int], window_us: int, cell: int = 1) -> None:
        self.model = MovingImage(sensor, window_us, cell)
        self._finder = PathFinder(self.model)

    def __call__(
        self, windows: Sequence[Columns], pixels: MeasuredPixels
    ) -> Iterator[tuple[MotionPath, MovedImage | None]]:
        """Yield the path of each window, and its image if the path can be relied on.

        Parameters
        ----------
        windows : t, x, y, p of each window. They may include events of the neighbouring windows.
            These are used only if the window alone does not tell its path.
        pixels : the sensor's pixels, measured on recordings.
        """
        for first in range(0, len(windows), BATCH):
            batch = windows[first : first + BATCH]
            paths_and_images = self._reconstruct(batch, pixels, 1)
            # windows that do not tell their path alone, but have events of their neighbours
            unclear = [
                i
                for i, window in enumerate(batch)
                if paths_and_images[i][0].refused and self._has_neighbours(window)
            ]
            with_neighbours = self._reconstruct([batch[i] for i in unclear], pixels, SPAN)
            for i, (path, image) in zip(unclear, with_neighbours, strict=True):
                if not path.refused:
                    paths_and_images[i] = (path, image)
            yield from paths_and_images

    def _has_neighbours(self, window: Columns) -> bool:
        """Whether a window also holds events of its neighbours."""
        alone, _, _, _ = part_of(window, self.model.window_us)
        together, _, _, _ = part_of(window, self.model.window_us, SPAN)
        return len(together) > len(alone)

    def _reconstruct(
        self, windows: Sequence[Columns], pixels: MeasuredPixels, span: int
    ) -> list[tuple[MotionPath, MovedImage | None]]:
        """The path and the image of each window, found from the events of `span` windows.

        A window whose path cannot be relied on has no image.
        """
        if not windows:
            return []
        model = self.model
        parts = [part_of(window, model.window_us, span) for window in windows]
        n_events = [len(t) for t, _, _, _ in parts]
        frames = model.frames(windows, pixels, span)
        spectra = model.spectra(frames)
        band = model.band_of(spectra)
        paths = self._finder.find(band, self._halves(parts, frames, band), n_events, span)

        reliable = np.flatnonzero([not path.refused for path in paths])
        positions = np.array([paths[i].positions for i in reliable]).reshape(-1, N_FRAMES, 2)
        images = find_images(model, spectra[reliable], positions / model.cell)
        result: list[tuple[MotionPath, MovedImage | None]] = [(path, None) for path in paths]
        for i, image in zip(reliable, images, strict=True):
            result[i] = (paths[i], MovedImage(model, image, paths[i]))
        return result

    def _halves(
        self, windows: Sequence[Columns], frames: np.ndarray, band: np.ndarray
    ) -> np.ndarray:
        """The band of each of the four halves of the pictures: complex128, (N, 4, F, K).

        The halves are those left, right, above and below the middle of each window's events.

        Parameters
        ----------
        windows : N windows.
        frames : `MovingImage.frames` of the windows.
        band : the band of these frames, from `MovingImage.band_of`.
        """
        halves = np.empty((len(band), 4, *band.shape[1:]), np.complex128)
        for k, axis in enumerate((1, 2)):  # x and y in (t, x, y, p)
            # The band of the first half comes from frames whose second half is set to 0. The band
            # is linear in the frames, so the rest of it is that of the second half.
            first_halves = frames.copy()
            for pictures, columns in zip(first_halves, windows, strict=True):
                positions = columns[axis]
                middle = int(np.median(positions)) // self.model.cell if len(positions) else 0
                # a frame is (rows, columns), so axis 1 (x) is its last axis
                np.moveaxis(pictures, -axis, 0)[middle:] = 0
            halves[:, 2 * k] = self.model.band_of(self.model.spectra(first_halves))
            halves[:, 2 * k + 1] = band - halves[:, 2 * k]
        return halves

    def image(self, window: Columns, pixels: MeasuredPixels, path: MotionPath) -> MovedImage:
        """Find the image of one window whose path is known."""
        spectra = self.model.spectra(self.model.frames([window], pixels, path.span))
        images = find_images(self.model, spectra, path.positions[None] / self.model.cell)
        return MovedImage(self.model, images[0], path)
