"""The events of a window as one image that moves over the sensor: the statistical model, and its
closed form.

With L the image of log luminance where it is at the window's start, in units of the pixels'
threshold, and r_k its displacement at the end of the k-th of K equal parts of the window, the
events up to then sum up to

    c_k(x) = L(x - r_k) - L(x) + e_k(x)        cov(e_k, e_m) = V_km = 1/3 (delta_km + 1) + 0.01 min(k, m)

A pixel's reference level is anywhere within a threshold of its light, at the start (+ 1) and at r_k
(delta): a uniform distribution, of variance 1/3. The last term is what thresholds that differ from
pixel to pixel add. On a torus a displacement only multiplies each spatial frequency q by a phase,
so that the frequencies are independent:

    c_k(q) = a_k(q) L(q) + e_k(q)              a_k = exp(-i q r_k) - 1
    L(q) ~ N(0, 1 / Q(q))                      Q = 16 (|D(q)|^2 + 1/16),  D the differences of neighbours
    h = a^* V^-1 a,  b = a^* V^-1 c            E(L | c, r) = b / (h + Q)
    log p(c | r) - log p(c | no image) = 1/2 sum_q |b|^2 / (h + Q) - log(1 + h / Q)

The last line is the *evidence* of a path. It grows with the signal that the path explains, averaged
over all images, and shrinks with the freedom that the path leaves to the image. Frequencies above
`BAND` tell little about the path and are left out.

Once the path is known, the image is found as sharp as its events tell, and flat where they tell
nothing:

    L = argmin  1/2 sum_q h |L - b / h|^2  +  sum_x g(|D L|)  +  1/2 MEAN_PRECISION |L|^2
    g'(z) = SPARSENESS (sqrt(u^2 + 1) - u),  u = z / (2 EDGE)

The first term is the likelihood; the second prefers few edges to many small ones: it removes what
noise would otherwise leave everywhere, each bit of which would give events under another motion,
and continues edges that run along the motion, of which there are no events. Total variation (g' the
same everywhere) does that too, but flattens all edges, those along the motion most of all; here an
edge well above `EDGE` costs little more than a small one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from async_tnt.kernels.training.moving_image import contrast_frames, evidence_terms
from async_tnt.simulation.measured_pixels import Columns, MeasuredPixels, is_after_pulse, part_of

N_FRAMES = 16
BAND = np.pi / 2  # of the frequencies that a path is found by, in radians per cell
PHASE_VARIANCE, WALK_VARIANCE = 1 / 3, 0.01
ROUGHNESS, LEVEL = 16.0, 1.0  # Q = ROUGHNESS |D|^2 + LEVEL
MOST_CELLS, OBJECT_CELLS, FEWEST_CELLS = 80, 16, 40
"""Larger sensors are averaged over squares of pixels, cells: at most so many along the sensor's
longer side, and about so many across what moves, but at least so many along the sensor: a path of
two pixels is not seen in cells of four."""
MARGIN = 14
"""Cells beyond the sensor, so that what leaves it on one side does not come in on the other."""
SPARSENESS, EDGE, STEPS = 2.0, 2 / 3, 40
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
        self.sensor, self.window_us, self.cell = sensor, window_us, cell
        self.columns, self.rows = (-(-side // self.cell) for side in sensor)
        self.shape = fft_size(self.rows + MARGIN), fft_size(self.columns + MARGIN)
        k = np.arange(1, N_FRAMES + 1)
        covariance = PHASE_VARIANCE * (np.eye(N_FRAMES) + 1) + WALK_VARIANCE * np.minimum(
            k[:, None], k
        )
        self.whitening = self.cell * np.linalg.inv(np.linalg.cholesky(covariance))

    @cached_property
    def frequencies(self) -> tuple[np.ndarray, np.ndarray]:
        """(qx, qy) of all frequencies, in radians per cell; those of negative qx follow from
        them."""
        return 2 * np.pi * np.fft.rfftfreq(self.shape[1]), 2 * np.pi * np.fft.fftfreq(self.shape[0])

    @cached_property
    def band(self) -> tuple[np.ndarray, np.ndarray]:
        """(qx, qy) of the frequencies that a path is found by."""
        qx, qy = self.frequencies
        return qx[qx <= BAND], qy[np.abs(qy) <= BAND]

    @cached_property
    def band_weights(self) -> np.ndarray:
        """How often each of the band's qx counts: 2 where its opposite is left out."""
        return np.where(self.band[0] > 0, 2.0, 1.0)

    @cached_property
    def band_prior(self) -> np.ndarray:
        """Q of the band's frequencies, (F,), x changes fastest; |D|^2 is the power of neighbours'
        differences."""
        qx, qy = self.band
        squared: np.ndarray = 4.0 - 2.0 * np.cos(qx) - 2.0 * np.cos(qy)[:, None]
        return (ROUGHNESS * squared + LEVEL).ravel()

    def frames(
        self, windows: Sequence[Columns], pixels: MeasuredPixels, span: int = 1
    ) -> np.ndarray:
        """c: the change of log luminance since the start, (N, K, rows, columns), from the events
        but for after-pulses of N windows, or of `span` windows in whose middle each is."""
        frames = np.empty((len(windows), N_FRAMES, self.rows, self.columns))
        for window, out in zip(windows, frames, strict=True):
            part = part_of(window, self.window_us, span)
            seen = ~is_after_pulse(part)
            t, x, y, p = (column[seen] for column in part)
            contrast_frames(
                t, x, y, p, span * self.window_us, pixels.step_on, pixels.step_off, self.cell, out
            )
        return frames

    def spectra(self, frames: np.ndarray) -> np.ndarray:
        """W c(q) of all frequencies, (N, ny, nx, K)."""
        spectra = np.fft.rfft2(frames, self.shape, norm="ortho")
        return np.ascontiguousarray(np.moveaxis(spectra, 1, -1) @ self.whitening.T)

    def band_of(self, spectra: np.ndarray) -> np.ndarray:
        """The band's part of `spectra`, (N, F, K)."""
        qx, qy = self.frequencies
        some = spectra[:, np.abs(qy) <= BAND][:, :, qx <= BAND]
        return some.reshape(len(spectra), -1, N_FRAMES)

    def white_motion(self, paths: np.ndarray, qx: np.ndarray, qy: np.ndarray) -> np.ndarray:
        """W a of paths (..., K, 2) in cells: (..., ny, nx, K)."""
        angle = (
            qy[:, None, None] * paths[..., None, None, :, 1]
            + qx[:, None] * paths[..., None, None, :, 0]
        )
        white: np.ndarray = (np.exp(-1j * angle) - 1.0) @ self.whitening.T
        return white

    def evidence(self, band: np.ndarray, path: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """E of one path for all windows together, dE/dr (K, 2), and its curvature (2K, 2K), images
        held fixed."""
        (qx, qy), gradient = self.band, np.empty((N_FRAMES, 2))
        moving = np.empty(band.shape[1:], np.complex128)
        found = evidence_terms(
            band, path, qx, qy, self.band_weights, self.band_prior, self.whitening, gradient, moving
        )
        inverse = self.whitening.T @ self.whitening
        q = np.stack([np.tile(qx, len(qy)), np.repeat(qy, len(qx))])  # (2, F)
        curvature = np.empty((N_FRAMES, 2, N_FRAMES, 2))
        for i, j in ((0, 0), (0, 1), (1, 1)):
            part = (moving.conj().T @ ((q[i] * q[j])[:, None] * moving)).real * inverse
            curvature[:, i, :, j], curvature[:, j, :, i] = part, part.T
        return found, gradient, curvature.reshape(2 * N_FRAMES, 2 * N_FRAMES)

    def explained(self, band: np.ndarray, path: np.ndarray) -> float:
        """Which share of one window's signal, (F, K), the path explains: from 0 to 1."""
        white = self.white_motion(path, *self.band).reshape(band.shape)
        weights = np.tile(self.band_weights, len(self.band[1]))
        h, b = (np.abs(white) ** 2).sum(1), (white.conj() * band).sum(1)
        mean = b / (h + self.band_prior)
        power = float((weights * (np.abs(band) ** 2).sum(1)).sum())
        return float((weights * (2 * (mean.conj() * b).real - h * np.abs(mean) ** 2)).sum()) / max(
            power, 1e-12
        )


def cell_for(windows: Sequence[Columns], sensor: tuple[int, int]) -> int:
    """Sensor pixels along a side of a cell, by the median of how far the middle 70 % of each
    window's events reach."""
    reach = [
        max(np.ptp(np.quantile(axis, (0.15, 0.85))) for axis in (x, y))
        for _, x, y, _ in windows
        if len(x)
    ]
    wanted = round(float(np.median(reach)) / OBJECT_CELLS) if reach else 1
    least = -(-max(sensor) // MOST_CELLS)
    return int(np.clip(wanted, least, max(least, max(sensor) // FEWEST_CELLS)))


def find_images(model: MovingImage, spectra: np.ndarray, paths: np.ndarray) -> np.ndarray:
    """The images of N windows where they are at their window's start.

    Solved by ADMM (Boyd et al. 2011; for total variation: Goldstein and Osher 2009, the split
    Bregman method): with z = D L held fixed, L has a closed form for each frequency; with L held
    fixed, z is D L times 1 - (EDGE / |D L|)^2, or 0 (the garrote, Gao 1998), if the coupling of
    both is SPARSENESS / EDGE.

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
    forward_x, forward_y = np.exp(1j * qx) - 1.0, (np.exp(1j * qy) - 1.0)[:, None]
    white = model.white_motion(paths, qx, qy)
    b = (white.conj() * spectra).sum(-1)
    precision = (
        (np.abs(white) ** 2).sum(-1)
        + MEAN_PRECISION
        + coupling * (np.abs(forward_x) ** 2 + np.abs(forward_y) ** 2)
    )
    # z, and the dual variable of z = D L
    edges, dual = np.zeros((2, 2, len(spectra), *model.shape))
    for _ in range(STEPS):
        along_x, along_y = np.fft.rfft2(edges - dual, norm="ortho")
        spectrum = (
            b + coupling * (forward_x.conj() * along_x + forward_y.conj() * along_y)
        ) / precision
        images = np.fft.irfft2(spectrum, model.shape, norm="ortho")
        slopes = dual
        slopes[0] += np.roll(images, -1, axis=-1) - images
        slopes[1] += np.roll(images, -1, axis=-2) - images
        size = np.sqrt(slopes[0] ** 2 + slopes[1] ** 2)
        edges = slopes * np.maximum(0.0, 1.0 - (EDGE / np.maximum(size, 1e-12)) ** 2)
        dual = slopes - edges
    return images


def finer(image: np.ndarray, factor: int) -> np.ndarray:
    """The same image on a grid `factor` times finer, without frequencies that the coarse one
    lacks."""
    spectrum = np.fft.rfft2(image)
    rows, columns = image.shape
    padded = np.zeros((rows * factor, columns * factor // 2 + 1), np.complex128)
    half = rows // 2 + 1  # frequencies 0 and up; the others are at the end
    padded[:half, : spectrum.shape[1]] = spectrum[:half]
    padded[half - rows :, : spectrum.shape[1]] = spectrum[half:]
    return np.fft.irfft2(padded, (rows * factor, columns * factor)) * factor**2


def centre_of(image: np.ndarray) -> np.ndarray:
    """(x, y) of the middle of the image's edges, in cells: the mean direction on the torus,
    weighted by |D L|^2."""
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
