"""The image of a window whose path is known: as sharp as its events tell, and flat where they tell nothing.

    L = argmin  1/2 sum_q h |L - b / h|^2  +  SPARSENESS sum_x |D L|  +  1/2 MEAN_PRECISION |L|^2

with h and b as in `moving_image`. The first term is the likelihood; the second, total variation, prefers few edges to
many small ones: it removes what noise would otherwise leave everywhere, each bit of which would give events under
another motion, and continues edges that run along the motion, of which there are no events.

Solved by ADMM (Boyd et al. 2011; for total variation: Goldstein and Osher 2009, the split Bregman method): with z = D L
held fixed, L has a closed form for each frequency; with L held fixed, z is D L moved towards 0 by a threshold.
"""

from __future__ import annotations

import numpy as np

from async_tnt.resynthesis.moving_image import MovingImage

SPARSENESS = 3.0
COUPLING = 3.0
STEPS = 40
MEAN_PRECISION = 1e-2
"""Keeps frequencies that nothing is known of, such as the mean, at 0."""


def find_images(model: MovingImage, spectra: np.ndarray, paths: np.ndarray) -> np.ndarray:
    """The images of N windows where they are at their window's start.

    Parameters
    ----------
    spectra : complex128, (N, ny, nx, K), of `MovingImage.spectra`.
    paths : float64, (N, K, 2), in cells.

    Returns
    -------
    float64, (N, *model.shape), in thresholds.
    """
    qx, qy = model.frequencies
    forward_x, forward_y = np.exp(1j * qx) - 1.0, (np.exp(1j * qy) - 1.0)[:, None]
    white = model.white_motion(paths, qx, qy)
    b = (white.conj() * spectra).sum(-1)
    precision = (
        (np.abs(white) ** 2).sum(-1) + MEAN_PRECISION + COUPLING * (np.abs(forward_x) ** 2 + np.abs(forward_y) ** 2)
    )
    edges, dual = np.zeros((2, 2, len(spectra), *model.shape))  # z, and the dual variable of z = D L
    for _ in range(STEPS):
        along_x, along_y = np.fft.rfft2(edges - dual, norm="ortho")
        spectrum = (b + COUPLING * (forward_x.conj() * along_x + forward_y.conj() * along_y)) / precision
        images = np.fft.irfft2(spectrum, model.shape, norm="ortho")
        slopes = dual
        slopes[0] += np.roll(images, -1, axis=-1) - images
        slopes[1] += np.roll(images, -1, axis=-2) - images
        size = np.sqrt(slopes[0] ** 2 + slopes[1] ** 2)
        edges = slopes * np.maximum(0.0, 1.0 - SPARSENESS / COUPLING / np.maximum(size, 1e-12))
        dual = slopes - edges
    return images


def finer(image: np.ndarray, factor: int) -> np.ndarray:
    """The same image on a grid `factor` times finer, without frequencies that the coarse one lacks."""
    spectrum = np.fft.rfft2(image)
    rows, columns = image.shape
    padded = np.zeros((rows * factor, columns * factor // 2 + 1), np.complex128)
    half = rows // 2 + 1  # frequencies 0 and up; the others are at the end
    padded[:half, : spectrum.shape[1]] = spectrum[:half]
    padded[half - rows :, : spectrum.shape[1]] = spectrum[half:]
    return np.fft.irfft2(padded, (rows * factor, columns * factor)) * factor**2


def centre_of(image: np.ndarray) -> np.ndarray:
    """(x, y) of the middle of the image's edges, in cells: the mean direction on the torus, weighted by |D L|^2."""
    power = (np.roll(image, -1, axis=1) - image) ** 2 + (np.roll(image, -1, axis=0) - image) ** 2
    centre = []
    for axis, n in ((0, image.shape[1]), (1, image.shape[0])):
        angle = np.angle((power.sum(axis) * np.exp(2j * np.pi * np.arange(n) / n)).sum())
        centre.append(angle % (2 * np.pi) / (2 * np.pi) * n)
    return np.array(centre)
