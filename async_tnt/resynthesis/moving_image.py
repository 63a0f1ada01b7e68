"""The statistical model of a window's events as one image that moves over the sensor.

The model has a closed form.

Let L be the image of log luminance where it is at the window's start, in units of the pixels'
threshold. Let r_k be its displacement at the end of the k-th of K equal parts of the window. Then
the events up to that moment sum up to

    c_k(x) = L(x - r_k) - L(x) + e_k(x)
    cov(e_k, e_m) = V_km = 1/3 (delta_km + 1) + 0.01 min(k, m)

A pixel's reference level is anywhere within a threshold of its light, at the start (the 1) and at
r_k (the delta): a uniform distribution, of variance 1/3. The last term is what thresholds that
differ from pixel to pixel add. On a torus a displacement only multiplies each spatial frequency q
by a phase, so that the frequencies are independent:

    c_k(q) = a_k(q) L(q) + e_k(q)        a_k = exp(-i q r_k) - 1
    L(q) ~ N(0, 1 / Q(q))                Q = 16 (|D(q)|^2 + 1/16)
    h = a^* V^-1 a
    b = a^* V^-1 c
    E(L | c, r) = b / (h + Q)
    log p(c | r) - log p(c | no image) = 1/2 sum_q |b|^2 / (h + Q) - log(1 + h / Q)

D are the differences of neighbours. The last line is the *evidence* of a path. It grows with the
signal that the path explains, averaged over all images, and shrinks with the freedom that the path
leaves to the image. Frequencies above `BAND` tell little about the path and are left out.

Once the path is known, the image is found as sharp as its events tell, and flat where they tell
nothing:

    L = argmin  1/2 sum_q h |L - b / h|^2  +  sum_x g(|D L|)  +  1/2 MEAN_PRECISION |L|^2
    g'(z) = SPARSENESS (sqrt(u^2 + 1) - u),  u = z / (2 EDGE)

The first term is the likelihood. The second prefers few edges to many small ones. It removes what
noise would otherwise leave everywhere: each bit of that would give events under another motion. It
also continues edges that run along the motion, which have no events. Total variation (g'
the same everywhere) does that, too, but flattens all edges, those along the motion most of all.
Here an edge well above `EDGE` costs little more than a small one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from async_tnt.kernels.training.moving_image import contrast_frames, evidence_terms
from async_tnt.simulation.measured_pixels import Columns, MeasuredPixels, is_after_pulse, part_of

N_FRAMES = 16
"""K, the number of equal parts of a window. A path has a point at the end of each."""
BAND = np.pi / 2
"""Highest frequency that a path is found by, in radians per cell."""
PHASE_VARIANCE = 1 / 3
"""Variance of a pixel's reference level about its light, in thresholds squared."""
WALK_VARIANCE = 0.01
"""Variance that each of the K parts adds, as pixels have different thresholds."""
ROUGHNESS = 16.0
"""Weight of the neighbours' differences in Q = ROUGHNESS |D|^2 + LEVEL."""
LEVEL = 1.0
"""The term of Q that is the same for all frequencies."""

# Larger sensors are averaged over squares of pixels, the cells.
MOST_CELLS = 80
"""Cells along the sensor's longer side, at most."""
OBJECT_CELLS = 16
"""Cells across what moves, about."""
FEWEST_CELLS = 40
"""Cells along the sensor, at least: a path of two pixels is not seen in cells of four."""
MARGIN = 14
"""Cells beyond the sensor, so that what leaves it on one side does not come in on the other."""

SPARSENESS = 2.0
"""What a step in the image costs, per threshold of a small step: g'(0)."""
EDGE = 2 / 3
"""Height of a step, in thresholds, from which on more height costs little."""
STEPS = 40
"""Steps of the solver that finds the image."""
MEAN_PRECISION = 1e-2
"""Keeps frequencies that nothing is known of, such as the mean, at 0."""


class MovingImage:
    """The model for windows of one sensor and length.

    Parameters
    ----------
    sensor : (width, height), in pixels.
    window_us : length of the windows.
    cell : sensor pixels along a side of a cell, see `cell_for`.

    Attributes
    ----------
    rows, columns : cells of the sensor.
    shape : (rows, columns) of the torus; odd, so that no frequency is its own opposite.
    whitening : float64, (K, K), W with W V W^T = 1, for the mean of a cell's pixels.
    """

    def __init__(self, sensor: tuple[int, int], window_us: int, cell: int = 1) -> None:
        width, height = sensor
        self.sensor = sensor
        self.window_us = window_us
        self.cell = cell
        self.columns = -(-width // cell)
        self.rows = -(-height // cell)
        self.shape = fft_size(self.rows + MARGIN), fft_size(self.columns + MARGIN)
        k = np.arange(1, N_FRAMES + 1)
        walk = WALK_VARIANCE * np.minimum(k[:, None], k)
        covariance = PHASE_VARIANCE * (np.eye(N_FRAMES) + 1) + walk
        self.whitening = self.cell * np.linalg.inv(np.linalg.cholesky(covariance))

    @cached_property
    def frequencies(self) -> tuple[np.ndarray, np.ndarray]:
        """All frequencies (qx, qy), in radians per cell.

        Negative qx are left out, as their values follow from the others.
        """
        rows, columns = self.shape
        return 2 * np.pi * np.fft.rfftfreq(columns), 2 * np.pi * np.fft.fftfreq(rows)

    @cached_property
    def band(self) -> tuple[np.ndarray, np.ndarray]:
        """The frequencies (qx, qy) that a path is found by."""
        qx, qy = self.frequencies
        return qx[qx <= BAND], qy[np.abs(qy) <= BAND]

    @cached_property
    def band_weights(self) -> np.ndarray:
        """How often each qx of the band counts: 2 where its opposite is left out."""
        return np.where(self.band[0] > 0, 2.0, 1.0)

    @cached_property
    def band_prior(self) -> np.ndarray:
        """Q of the band's frequencies, (F,); x changes fastest.

        |D|^2 is the power of the differences of neighbours.
        """
        qx, qy = self.band
        squared: np.ndarray = 4.0 - 2.0 * np.cos(qx) - 2.0 * np.cos(qy)[:, None]
        return (ROUGHNESS * squared + LEVEL).ravel()

    def frames(
        self, windows: Sequence[Columns], pixels: MeasuredPixels, span: int = 1
    ) -> np.ndarray:
        """c, the change of log luminance since the start: float64, (N, K, rows, columns).

        After-pulses are left out.

        Parameters
        ----------
        windows : N windows.
        pixels : the pixels that recorded them.
        span : the frames are those of so many windows together, with each window in the middle.
        """
        frames = np.empty((len(windows), N_FRAMES, self.rows, self.columns))
        for window, out in zip(windows, frames, strict=True):
            part = part_of(window, self.window_us, span)
            seen = ~is_after_pulse(part)
            contrast_frames(
                *[column[seen] for column in part],
                span * self.window_us,
                pixels.step_on,
                pixels.step_off,
                self.cell,
                out,
            )
        return frames

    def spectra(self, frames: np.ndarray) -> np.ndarray:
        """W c(q) of all frequencies, (N, ny, nx, K)."""
        spectra = np.fft.rfft2(frames, self.shape, norm="ortho")
        return np.ascontiguousarray(np.moveaxis(spectra, 1, -1) @ self.whitening.T)

    def band_of(self, spectra: np.ndarray) -> np.ndarray:
        """The band's part of `spectra`, (N, F, K)."""
        qx, qy = self.frequencies
        band = spectra[:, np.abs(qy) <= BAND][:, :, qx <= BAND]
        return band.reshape(len(spectra), -1, N_FRAMES)

    def white_motion(self, paths: np.ndarray, qx: np.ndarray, qy: np.ndarray) -> np.ndarray:
        """W a of paths (..., K, 2) in cells: (..., ny, nx, K)."""
        angle = (
            qy[:, None, None] * paths[..., None, None, :, 1]
            + qx[:, None] * paths[..., None, None, :, 0]
        )
        white: np.ndarray = (np.exp(-1j * angle) - 1.0) @ self.whitening.T
        return white

    def evidence(self, band: np.ndarray, path: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """The evidence of a path for all windows together, with two derivatives.

        Parameters
        ----------
        band : complex128, (N, F, K), of `band_of`.
        path : float64, (K, 2), in cells.

        Returns
        -------
        The evidence E, its gradient dE/dr (K, 2), and its curvature (2K, 2K) with the images held
        fixed.
        """
        qx, qy = self.band
        gradient = np.empty((N_FRAMES, 2))
        moving = np.empty(band.shape[1:], np.complex128)
        found = evidence_terms(
            band, path, qx, qy, self.band_weights, self.band_prior, self.whitening, gradient, moving
        )
        inverse = self.whitening.T @ self.whitening
        q = np.stack([np.tile(qx, len(qy)), np.repeat(qy, len(qx))])  # (2, F)
        curvature = np.empty((N_FRAMES, 2, N_FRAMES, 2))
        for i, j in ((0, 0), (0, 1), (1, 1)):
            part = (moving.conj().T @ ((q[i] * q[j])[:, None] * moving)).real * inverse
            curvature[:, i, :, j] = part
            curvature[:, j, :, i] = part.T
        return found, gradient, curvature.reshape(2 * N_FRAMES, 2 * N_FRAMES)

    def explained(self, band: np.ndarray, path: np.ndarray) -> float:
        """The share of one window's signal that a path explains, from 0 to 1.

        Parameters
        ----------
        band : complex128, (F, K), one window of `band_of`.
        path : float64, (K, 2), in cells.
        """
        white = self.white_motion(path, *self.band).reshape(band.shape)
        weights = np.tile(self.band_weights, len(self.band[1]))
        h = (np.abs(white) ** 2).sum(1)
        b = (white.conj() * band).sum(1)
        mean = b / (h + self.band_prior)
        explained = weights * (2 * (mean.conj() * b).real - h * np.abs(mean) ** 2)
        power = float((weights * (np.abs(band) ** 2).sum(1)).sum())
        return float(explained.sum()) / max(power, 1e-12)


def cell_for(windows: Sequence[Columns], sensor: tuple[int, int]) -> int:
    """The number of sensor pixels along a side of a cell.

    What moves is to have `OBJECT_CELLS` across. Its size is the median, over the windows, of how
    far the middle 70 % of the events reach.
    """
    reach = []
    for _, x, y, _ in windows:
        if len(x):
            reach.append(max(np.ptp(np.quantile(axis, (0.15, 0.85))) for axis in (x, y)))
    wanted = round(float(np.median(reach)) / OBJECT_CELLS) if reach else 1
    least = -(-max(sensor) // MOST_CELLS)
    return int(np.clip(wanted, least, max(least, max(sensor) // FEWEST_CELLS)))


def find_images(model: MovingImage, spectra: np.ndarray, paths: np.ndarray) -> np.ndarray:
    """The images of N windows where they are at their window's start.

    They are found by ADMM (Boyd et al. 2011; for total variation: Goldstein and Osher 2009, the
    split Bregman method), with z = D L. With z held fixed, L has a closed form for each frequency.
    With L held fixed, z is D L times 1 - (EDGE / |D L|)^2, or 0 (the garrote, Gao 1998), if the
    coupling of both is SPARSENESS / EDGE.

    Parameters
    ----------
    spectra : complex128, (N, ny, nx, K), of `MovingImage.spectra`.
    paths : float64, (N, K, 2), in cells.

    Returns
    -------
    float64, (N, *model.shape), in thresholds.
    """
    qx, qy = model.frequencies
    coupling = SPARSENESS / EDGE
    forward_x = np.exp(1j * qx) - 1.0
    forward_y = (np.exp(1j * qy) - 1.0)[:, None]
    white = model.white_motion(paths, qx, qy)
    b = (white.conj() * spectra).sum(-1)
    squared = np.abs(forward_x) ** 2 + np.abs(forward_y) ** 2
    precision = (np.abs(white) ** 2).sum(-1) + MEAN_PRECISION + coupling * squared
    # z, and the dual variable of z = D L
    edges, dual = np.zeros((2, 2, len(spectra), *model.shape))
    for _ in range(STEPS):
        along_x, along_y = np.fft.rfft2(edges - dual, norm="ortho")
        pulled = forward_x.conj() * along_x + forward_y.conj() * along_y
        spectrum = (b + coupling * pulled) / precision
        images = np.fft.irfft2(spectrum, model.shape, norm="ortho")
        slopes = dual
        slopes[0] += np.roll(images, -1, axis=-1) - images
        slopes[1] += np.roll(images, -1, axis=-2) - images
        size = np.sqrt(slopes[0] ** 2 + slopes[1] ** 2)
        edges = slopes * np.maximum(0.0, 1.0 - (EDGE / np.maximum(size, 1e-12)) ** 2)
        dual = slopes - edges
    return images


def finer(image: np.ndarray, factor: int) -> np.ndarray:
    """The same image on a grid that is `factor` times finer. It gains no frequencies."""
    spectrum = np.fft.rfft2(image)
    rows, columns = image.shape
    padded = np.zeros((rows * factor, columns * factor // 2 + 1), np.complex128)
    # the first rows have the frequencies from 0 up; the negative ones are at the end
    half = rows // 2 + 1
    padded[:half, : spectrum.shape[1]] = spectrum[:half]
    padded[half - rows :, : spectrum.shape[1]] = spectrum[half:]
    return np.fft.irfft2(padded, (rows * factor, columns * factor)) * factor**2


def centre_of(image: np.ndarray) -> np.ndarray:
    """The middle (x, y) of the image's edges, in cells.

    This is the mean direction on the torus, weighted by |D L|^2.
    """
    power = sum((np.roll(image, -1, axis) - np.roll(image, 1, axis)) ** 2 for axis in (0, 1))
    centre = []
    for axis, n in ((0, image.shape[1]), (1, image.shape[0])):
        angle = np.angle((power.sum(axis) * np.exp(2j * np.pi * np.arange(n) / n)).sum())
        centre.append(angle % (2 * np.pi) / (2 * np.pi) * n)
    return np.array(centre)


def fft_size(least: int) -> int:
    """The smallest odd number from `least` on without a prime factor above 7.

    Examples
    --------
    >>> fft_size(48), fft_size(50), fft_size(53)
    (49, 63, 63)
    """
    size = least + 1 - least % 2
    while pow(3 * 5 * 7, size.bit_length(), size):  # 0, unless it has another prime factor
        size += 2
    return size
