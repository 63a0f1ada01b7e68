"""From the events of windows to the image that moved and its path, and from there to events under
another motion.

Other motions are drawn around the recorded ones: half to double their length, see `random_motion`.
At half time the object's centre lies between where it was recorded at half time and the sensor's
centre, and up to an eleventh of the sensor's smaller side (3 of 34 pixels) beside.
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
"""Pictures of a window; the light runs straight between them."""
FINENESS = 3
"""Places of the image along a cell: between them it is interpolated, which does not blur it
visibly."""
SPAN = 3
"""Windows that tell a path together where one alone does not: that of before, itself, and the
next."""
OTHER_LENGTHS, PLACE_SHARE = (0.5, 2.0), 1 / 11
BATCH = 64
"""Windows at a time: some 40 MB of spectra and images."""
THRESHOLD_SPREAD, REFRACTORY_SPREAD = 0.1, 0.4


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
        """The pixels of one window, drawn by `rng`: thresholds and refractory time vary from window
        to window."""
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
    """The image of one window, ready to be moved otherwise.

    Parameters
    ----------
    model : of the window.
    image : float64, (rows, columns) of the torus, in thresholds, where it is at the path's start.
    path : how it was recorded.

    Attributes
    ----------
    picture : the image, in thresholds, before the sensor.
    """

    def __init__(self, model: MovingImage, image: np.ndarray, path: MotionPath) -> None:
        self.model, self.path = model, path
        origin = (model.cell - 1) / 2  # the middle of the first cell, in sensor pixels
        self._halfway = path.before + path.at(np.array([0.5]))[0]
        centre = origin + model.cell * centre_of(image) + self._halfway
        torus, middle = model.cell * np.array(model.shape[::-1]), (np.array(model.sensor) - 1) / 2
        # the torus has no first cell: of the equivalent places, the one nearest to the sensor's
        # centre
        self._centre = middle + (centre - middle + torus / 2) % torus - torus / 2
        start = self._centre - self._halfway
        self.picture = PeriodicImage(
            finer(image, FINENESS), FINENESS / model.cell, origin, start, model.sensor
        )

    def as_recorded(self, pixels: SimulatedPixels, rng: np.random.Generator) -> np.ndarray:
        """Events of simulated `pixels` under the motion that was recorded; `rng` draws."""
        return self.events(
            self.path.before + self.path.at(shares()), np.zeros((N_PICTURES, 2)), pixels, rng
        )

    def moved(
        self, length: float, pixels: SimulatedPixels, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Events under a random motion, and the motion: displacement since the window's start, (n,
        2), in pixels.

        Parameters
        ----------
        length : of the recorded motions, in sensor pixels.
        pixels : of the simulated sensor.
        rng : draws the motion, the pixels and their noise.
        """
        motion, turn = random_motion(length * rng.uniform(*OTHER_LENGTHS), shares(), rng)
        middle = (np.array(self.model.sensor) - 1) / 2
        aside = PLACE_SHARE * (min(self.model.sensor) - 1)
        place = (
            self._centre + rng.random() * (middle - self._centre) + rng.uniform(-aside, aside, 2)
        )
        displacement = self._halfway + (place - self._centre) + motion
        return self.events(displacement, turn, pixels, rng), motion - motion[0]

    def events(
        self,
        displacement: np.ndarray,
        turn: np.ndarray,
        pixels: SimulatedPixels,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Events of `pixels` while the image moves, see `PeriodicImage.events`; `rng` draws."""
        return self.picture.events(
            self.model.window_us * shares(), displacement, turn, pixels.draw(rng), rng
        )


def shares() -> np.ndarray:
    """Of the window, from 0 to 1, at each picture."""
    return np.linspace(0.0, 1.0, N_PICTURES)


class Reconstruction:
    """Paths and images of windows of one sensor and length.

    Parameters
    ----------
    sensor : (width, height), in pixels.
    window_us : length of the windows.
    cell : sensor pixels along a side of the cells that a path is found on, see `cell_for`.

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
        """Path of each window, and its image where the path may be relied on.

        Parameters
        ----------
        windows : t, x, y, p of each. Where a window alone does not tell, its neighbours' events
            help, if there are any.
        pixels : measured on recordings.
        """
        for first in range(0, len(windows), BATCH):
            some = windows[first : first + BATCH]
            found = self._reconstruct(some, pixels, 1)
            wider = [
                i for i, one in enumerate(some) if found[i][0].refused and self._has_neighbours(one)
            ]
            for i, one in zip(
                wider, self._reconstruct([some[i] for i in wider], pixels, SPAN), strict=True
            ):
                if not one[0].refused:
                    found[i] = one
            yield from found

    def _has_neighbours(self, window: Columns) -> bool:
        return len(part_of(window, self.model.window_us, SPAN)[0]) > len(
            part_of(window, self.model.window_us)[0]
        )

    def _reconstruct(
        self, windows: Sequence[Columns], pixels: MeasuredPixels, span: int
    ) -> list[tuple[MotionPath, MovedImage | None]]:
        """Path and image of each window, found in `span` windows together."""
        if not windows:
            return []
        parts = [part_of(one, self.model.window_us, span) for one in windows]
        frames = self.model.frames(windows, pixels, span)
        spectra = self.model.spectra(frames)
        band = self.model.band_of(spectra)
        paths = self._finder.find(
            band, self._halves(parts, frames, band), [len(t) for t, _, _, _ in parts], span
        )
        moving = np.flatnonzero([not path.refused for path in paths])
        positions = (
            np.array([paths[i].positions for i in moving]).reshape(-1, N_FRAMES, 2)
            / self.model.cell
        )
        images = dict(zip(moving, find_images(self.model, spectra[moving], positions), strict=True))
        return [
            (path, MovedImage(self.model, images[i], path) if i in images else None)
            for i, path in enumerate(paths)
        ]

    def _halves(
        self, windows: Sequence[Columns], frames: np.ndarray, band: np.ndarray
    ) -> np.ndarray:
        """The band of what is left, right, above and below the middle of each window's events, (N,
        4, F, K)."""
        halves = np.empty((len(band), 4, *band.shape[1:]), np.complex128)
        for k, axis in enumerate((1, 2)):  # of (t, x, y, p)
            cut = frames.copy()
            for one, columns in zip(cut, windows, strict=True):
                middle = (
                    int(np.median(columns[axis])) // self.model.cell if len(columns[axis]) else 0
                )
                # of a frame (rows, columns): the last axis is x
                np.moveaxis(one, -axis, 0)[middle:] = 0
            halves[:, 2 * k] = self.model.band_of(self.model.spectra(cut))
            halves[:, 2 * k + 1] = band - halves[:, 2 * k]
        return halves

    def image(self, window: Columns, pixels: MeasuredPixels, path: MotionPath) -> MovedImage:
        """The image of one `window` whose `path` is known, with measured `pixels`."""
        spectra = self.model.spectra(self.model.frames([window], pixels, path.span))
        return MovedImage(
            self.model,
            find_images(self.model, spectra, path.positions[None] / self.model.cell)[0],
            path,
        )
