"""A statistical model of a window's events: one image moves over the sensor.

The image L is the log luminance at the window's start, in units of the pixels' threshold. The
window is divided into K equal parts, and r_k is the image's displacement at the end of the k-th
part. Then the sum of a pixel's events up to this moment, with OFF events negative, is

    c_k(x) = L(x - r_k) - L(x) + e_k(x)
    cov(e_k, e_m) = V_km = 1/3 (delta_km + 1) + 0.01 min(k, m)

with errors e_k of mean 0. A pixel's reference level is anywhere within a threshold of its light: a
uniform distribution, of variance 1/3. This variance occurs twice, at the start (the 1) and at r_k
(the delta). The last term of V is added by thresholds that differ from pixel to pixel.

The sensor is treated as a torus. There a displacement multiplies each spatial frequency q by a
phase and does nothing else. So the frequencies are independent, and the solution has a closed form:

    c_k(q) = a_k(q) L(q) + e_k(q)        a_k = exp(-i q r_k) - 1
    L(q) ~ N(0, 1 / Q(q))                Q = 16 (|D(q)|^2 + 1/16)
    h = a^* V^-1 a
    b = a^* V^-1 c
    E(L | c, r) = b / (h + Q)
    log p(c | r) - log p(c | no image) = 1/2 sum_q |b|^2 / (h + Q) - log(1 + h / Q)

D takes the differences of neighbouring cells. The last line is the *evidence* of a path: how
probable the path makes the events, in the mean over all images. It has two terms. The first one
grows with the part of the signal that the path explains. The second one is subtracted. It is larger
for a path that could also explain many other signals. Frequencies above `BAND` tell little about
the path and are left out.

Once the path is known, the image is found. It is as sharp as its events tell, and flat where they
tell nothing:

    L = argmin  1/2 sum_q h |L - b / h|^2  +  sum_x g(|D L|)  +  1/2 MEAN_PRECISION |L|^2
    g'(z) = SPARSENESS (sqrt(u^2 + 1) - u),  u = z / (2 EDGE)

The first term is the likelihood. The second term prefers few edges to many small ones, for two
reasons. It removes the small edges that noise leaves everywhere, because they would give events
under another motion. And it continues edges that run along the motion, because they have no events.
Total variation, with the same g' everywhere, would do both, too. But it flattens all edges, most of
all those along the motion. With this g, an edge well above `EDGE` costs little more than a small
edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from async_tnt.kernels.training.moving_image import contrast_frames, evidence_terms
from async_tnt.simulation.measured_pixels import Columns, MeasuredPixels, is_after_pulse, part_of

N_FRAMES = 16
"""K, the number of equal parts of a window. A path has a point at the end of each part."""
BAND = np.pi / 2
"""Highest frequency with which a path is found, in radians per cell."""
PHASE_VARIANCE = 1 / 3
"""Variance of a pixel's reference level about its light, in thresholds squared."""
WALK_VARIANCE = 0.01
"""Variance that each of the K parts adds because thresholds differ, in thresholds squared."""
ROUGHNESS = 16.0
"""Weight of the neighbours' differences in Q = ROUGHNESS |D|^2 + LEVEL."""
LEVEL = 1.0
"""The term of Q that is the same for all frequencies."""

# The model works on cells: squares of sensor pixels, over which the events are averaged.
MOST_CELLS = 80
"""Most cells along the sensor's longer side."""
OBJECT_CELLS = 16
"""Wanted number of cells across the moving object."""
FEWEST_CELLS = 40
"""Fewest cells along the sensor's longer side. With large cells short paths are missed. For
example, a path of two pixels does not show in cells of four pixels."""
MARGIN = 14
"""Number of cells beyond the sensor. Without them, an object that leaves the sensor on one side
would come in on the other side, as on any torus."""

SPARSENESS = 2.0
"""Cost of a small step in the image, per threshold of its height: g'(0)."""
EDGE = 2 / 3
"""Height of a step, in thresholds, above which more height costs little."""
STEPS = 40
"""Number of steps of the solver that finds the image."""
MEAN_PRECISION = 1e-2
"""Precision that keeps frequencies at 0 if the events tell nothing of them, such as the mean."""


class MovingImage:
    """The statistical model of windows, for one sensor and one length of windows.

    Parameters
    ----------
    sensor : (width, height), in pixels.
    window_us : length of the windows.
    cell : sensor pixels along a side of a cell, see `cell_for`.

    Attributes
    ----------
    rows, columns : number of cells of the sensor.
    shape : (rows, columns) of the torus. Both are odd, so that only frequency 0 is its own
        opposite.
    whitening : float64, (K, K): W with W V W^T = 1. Here V is the covariance of the mean over a
        cell's pixels, which is 1 / cell^2 of a pixel's.
    """

    def __init__(self, sensor: tuple[int, int], window_us: int, cell: int = 1) -> None:
        width, height = sensor
        self.sensor = sensor
        self.window_us = window_us
        self.cell = cell
        # rounded up: the last cells may reach beyond the sensor
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

        Negative qx are left out, as their values follow from those of positive qx.
        """
        rows, columns = self.shape
        return 2 * np.pi * np.fft.rfftfreq(columns), 2 * np.pi * np.fft.fftfreq(rows)

    @cached_property
    def band_frequencies(self) -> tuple[np.ndarray, np.ndarray]:
        """The frequencies (qx, qy) with which a path is found."""
        qx, qy = self.frequencies
        return qx[qx <= BAND], qy[np.abs(qy) <= BAND]

    @cached_property
    def band_weights(self) -> np.ndarray:
        """The weight of each qx of the band: 1 for qx = 0, and 2 for positive qx.

        Positive qx count twice, because negative qx are left out.
        """
        return np.where(self.band_frequencies[0] > 0, 2.0, 1.0)

    @cached_property
    def band_prior(self) -> np.ndarray:
        """Q of the band's F frequencies, (F,); qx changes fastest."""
        qx, qy = self.band_frequencies
        squared: np.ndarray = 4.0 - 2.0 * np.cos(qx) - 2.0 * np.cos(qy)[:, None]  # |D|^2
        return (ROUGHNESS * squared + LEVEL).ravel()

    def frames(
        self, windows: Sequence[Columns], pixels: MeasuredPixels, span: int = 1
    ) -> np.ndarray:
        """c, the change of log luminance since the start: float64, (N, K, rows, columns).

        After-pulses are left out.

        Parameters
        ----------
        windows : N windows.
        pixels : the pixels that recorded the windows.
        span : number of consecutive windows that the frames cover. Each of the N windows is the
            middle one of them.
        """
        frames = np.empty((len(windows), N_FRAMES, self.rows, self.columns))
        for window, out in zip(windows, frames, strict=True):
            part = part_of(window, self.window_us, span)
            is_kept = ~is_after_pulse(part)
            contrast_frames(
                *[column[is_kept] for column in part],
                span * self.window_us,
                pixels.step_on,
                pixels.step_off,
                self.cell,
                out,
            )
        return frames

    def spectra(self, frames: np.ndarray) -> np.ndarray:
        """W c(q) at all frequencies q: complex128, (N, ny, nx, K).

        frames : c, from `frames`.
        """
        spectra = np.fft.rfft2(frames, self.shape, norm="ortho")
        return np.ascontiguousarray(np.moveaxis(spectra, 1, -1) @ self.whitening.T)

    def band_of(self, spectra: np.ndarray) -> np.ndarray:
        """The part of `spectra` at the band's F frequencies, (N, F, K)."""
        qx, qy = self.frequencies
        band = spectra[:, np.abs(qy) <= BAND][:, :, qx <= BAND]
        return band.reshape(len(spectra), -1, N_FRAMES)

    def white_motion(self, paths: np.ndarray, qx: np.ndarray, qy: np.ndarray) -> np.ndarray:
        """W a at frequencies qx and qy, for paths (..., K, 2) in cells: (..., ny, nx, K)."""
        angle = (
            qy[:, None, None] * paths[..., None, None, :, 1]
            + qx[:, None] * paths[..., None, None, :, 0]
        )
        white: np.ndarray = (np.exp(-1j * angle) - 1.0) @ self.whitening.T
        return white

    def evidence(self, band: np.ndarray, path: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """The evidence of a path for all windows together, its gradient and its curvature.

        Parameters
        ----------
        band : complex128, (N, F, K), from `band_of`.
        path : float64, (K, 2), in cells.

        Returns
        -------
        The evidence E, its gradient dE/dr, (K, 2), and its curvature, (2K, 2K). The curvature is
        minus the second derivative of E for fixed images, in the Gauss-Newton approximation.
        """
        qx, qy = self.band_frequencies
        gradient = np.empty((N_FRAMES, 2))
        # `evidence_terms` fills in both: the gradient, and at each frequency the path's phases,
        # times the root of the images' weighted power
        weighted_phases = np.empty(band.shape[1:], np.complex128)
        evidence = evidence_terms(
            band,
            path,
            qx,
            qy,
            self.band_weights,
            self.band_prior,
            self.whitening,
            gradient,
            weighted_phases,
        )
        inverse = self.whitening.T @ self.whitening  # V^-1
        q = np.stack([np.tile(qx, len(qy)), np.repeat(qy, len(qx))])  # (2, F)
        curvature = np.empty((N_FRAMES, 2, N_FRAMES, 2))
        # the second derivatives in x and x, x and y, y and y
        for i, j in ((0, 0), (0, 1), (1, 1)):
            times_q = (q[i] * q[j])[:, None] * weighted_phases
            part = (weighted_phases.conj().T @ times_q).real * inverse
            curvature[:, i, :, j] = part
            curvature[:, j, :, i] = part.T
        return evidence, gradient, curvature.reshape(2 * N_FRAMES, 2 * N_FRAMES)

    def explained(self, band: np.ndarray, path: np.ndarray) -> float:
        """The share of one window's signal that a path explains, from 0 to 1.

        Parameters
        ----------
        band : complex128, (F, K), of one window, from `band_of`.
        path : float64, (K, 2), in cells.
        """
        white = self.white_motion(path, *self.band_frequencies).reshape(band.shape)
        weights = np.tile(self.band_weights, len(self.band_frequencies[1]))
        h = (np.abs(white) ** 2).sum(1)
        b = (white.conj() * band).sum(1)
        mean = b / (h + self.band_prior)  # the posterior mean of the image
        explained = weights * (2 * (mean.conj() * b).real - h * np.abs(mean) ** 2)
        power = float((weights * (np.abs(band) ** 2).sum(1)).sum())
        return float(explained.sum()) / max(power, 1e-12)


def cell_for(windows: Sequence[Columns], sensor: tuple[int, int]) -> int:
    """Choose the number of sensor pixels along a side of a cell.

    The moving object is to be about `OBJECT_CELLS` cells across. Its size in a window is the extent
    of the middle 70 % of the events, in x or in y, whichever is larger. The object's size is the
    median over the windows.
    """
    sizes = []
    for _, x, y, _ in windows:
        if len(x):
            sizes.append(max(np.ptp(np.quantile(axis, (0.15, 0.85))) for axis in (x, y)))
    wanted = round(float(np.median(sizes)) / OBJECT_CELLS) if sizes else 1
    least = -(-max(sensor) // MOST_CELLS)  # rounded up
    return int(np.clip(wanted, least, max(least, max(sensor) // FEWEST_CELLS)))


def find_images(model: MovingImage, spectra: np.ndarray, paths: np.ndarray) -> np.ndarray:
    """Find the images of N windows. Each image is where it was at the start of its path.

    The solver is ADMM (Boyd et al. 2011; for total variation: Goldstein and Osher 2009, the split
    Bregman method). It introduces z = D L and alternates two steps. For a fixed z, L has a closed
    form at each frequency. For a fixed L, z is D L times max(0, 1 - (EDGE / |D L|)^2), the garrote
    (Gao 1998), because the coupling of z and D L is SPARSENESS / EDGE.

    Parameters
    ----------
    model : the model of the windows.
    spectra : complex128, (N, ny, nx, K), from `MovingImage.spectra`.
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
    # `edges` is z, and `dual` is the dual variable of the constraint z = D L
    edges, dual = np.zeros((2, 2, len(spectra), *model.shape))
    for _ in range(STEPS):
        # the image for fixed edges
        edges_x, edges_y = np.fft.rfft2(edges - dual, norm="ortho")
        divergence = forward_x.conj() * edges_x + forward_y.conj() * edges_y
        spectrum = (b + coupling * divergence) / precision
        images = np.fft.irfft2(spectrum, model.shape, norm="ortho")
        # the edges for a fixed image; `slopes` becomes D L + dual, in the memory of `dual`
        slopes = dual
        slopes[0] += np.roll(images, -1, axis=-1) - images
        slopes[1] += np.roll(images, -1, axis=-2) - images
        size = np.sqrt(slopes[0] ** 2 + slopes[1] ** 2)
        edges = slopes * np.maximum(0.0, 1.0 - (EDGE / np.maximum(size, 1e-12)) ** 2)
        dual = slopes - edges
    return images


def finer(image: np.ndarray, factor: int) -> np.ndarray:
    """The same image on a grid that is `factor` times finer, without new frequencies."""
    spectrum = np.fft.rfft2(image)
    rows, columns = image.shape
    padded = np.zeros((rows * factor, columns * factor // 2 + 1), np.complex128)
    # the first rows are the frequencies from 0 up, the last rows are the negative frequencies
    half = rows // 2 + 1
    padded[:half, : spectrum.shape[1]] = spectrum[:half]
    padded[half - rows :, : spectrum.shape[1]] = spectrum[half:]
    return np.fft.irfft2(padded, (rows * factor, columns * factor)) * factor**2


def centre_of(image: np.ndarray) -> np.ndarray:
    """The middle (x, y) of the image's edges, in cells.

    In x and in y, it is the circular mean on the torus, weighted by squared differences.
    """
    power = sum((np.roll(image, -1, axis) - np.roll(image, 1, axis)) ** 2 for axis in (0, 1))
    centre = []
    for axis, n in ((0, image.shape[1]), (1, image.shape[0])):
        # place k of n is the angle 2 pi k / n on a circle
        on_circle = np.exp(2j * np.pi * np.arange(n) / n)
        angle = np.angle((power.sum(axis) * on_circle).sum())
        centre.append(angle % (2 * np.pi) / (2 * np.pi) * n)
    return np.array(centre)


def fft_size(least: int) -> int:
    """The smallest odd number, `least` or more, that has no prime factor above 7.

    The Fourier transform of such a size is fast.

    Examples
    --------
    >>> fft_size(48), fft_size(50), fft_size(53)
    (49, 63, 63)
    """
    size = least + 1 - least % 2
    # A high power of 3 * 5 * 7 is a multiple of `size`, unless `size` has another prime factor.
    while pow(3 * 5 * 7, size.bit_length(), size) != 0:
        size += 2
    return size
