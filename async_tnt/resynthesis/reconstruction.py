"""From the events of windows to what they show and how it moved."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from async_tnt.resynthesis.events import MovedImage
from async_tnt.resynthesis.images import find_images
from async_tnt.resynthesis.moving_image import N_FRAMES, MovingImage
from async_tnt.resynthesis.paths import MotionPath, PathFinder
from async_tnt.resynthesis.pixels import Columns, MeasuredPixels

BATCH = 64
"""Windows at a time: some 40 MB of spectra and images."""


class Reconstruction:
    """Paths and images of windows of one sensor and length.

    Parameters
    ----------
    sensor : (width, height), in pixels.
    window_us : length of the windows.

    Attributes
    ----------
    model : the windows' `MovingImage`.
    """

    def __init__(self, sensor: tuple[int, int], window_us: int) -> None:
        self.model = MovingImage(sensor, window_us)
        self._finder = PathFinder(self.model)

    def shared_path(self, windows: Sequence[Columns], pixels: MeasuredPixels) -> MotionPath:
        """The path of `windows` that all move alike, with measured `pixels`."""
        band = np.concatenate([self.model.band_of(spectra) for _, spectra in self._batches(windows, pixels)])
        return self._finder.find_shared(band, [len(t) for t, _, _, _ in windows])

    def __call__(
        self, windows: Sequence[Columns], pixels: MeasuredPixels, known: Sequence[MotionPath | None] | None = None
    ) -> Iterator[tuple[MotionPath, MovedImage | None]]:
        """Path of each window, and its image where the path may be relied on.

        Parameters
        ----------
        windows : t, x, y, p of each.
        pixels : measured on recordings.
        known : the path of each window, where it is known; the others are found from the window's own events alone.
        """
        for first, spectra in self._batches(windows, pixels):
            band = self.model.band_of(spectra)
            n_events = [len(t) for t, _, _, _ in windows[first : first + BATCH]]
            given = [None] * len(band) if known is None else known[first : first + BATCH]
            unknown = [i for i, path in enumerate(given) if path is None]
            found = iter(self._finder.find(band[unknown], [n_events[i] for i in unknown]))
            paths = [
                next(found) if path is None else self._finder.of_window(path, one, n)
                for path, one, n in zip(given, band, n_events, strict=True)
            ]
            moving = np.flatnonzero([path.found for path in paths])
            positions = np.array([paths[i].positions for i in moving]).reshape(-1, N_FRAMES, 2) / self.model.cell
            images = dict(zip(moving, find_images(self.model, spectra[moving], positions), strict=True))
            for i, path in enumerate(paths):
                yield path, MovedImage(self.model, images[i], path) if i in images else None

    def image(self, window: Columns, pixels: MeasuredPixels, path: MotionPath) -> MovedImage:
        """The image of one `window` whose `path` is known, with measured `pixels`."""
        spectra = self.model.spectra(self.model.frames([window], pixels))
        return MovedImage(self.model, find_images(self.model, spectra, path.positions[None] / self.model.cell)[0], path)

    def _batches(self, windows: Sequence[Columns], pixels: MeasuredPixels) -> Iterator[tuple[int, np.ndarray]]:
        """The number of a batch's first window, and the spectra of its windows."""
        for first in range(0, len(windows), BATCH):
            yield first, self.model.spectra(self.model.frames(windows[first : first + BATCH], pixels))
