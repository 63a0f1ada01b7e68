"""One image that moves over the sensor: the evidence for its path, and what the sensor sees.

See `resynthesis.moving_image` for the model and its symbols. Numba takes arrays faster one by one
than in a tuple, so two kernels have nine parameters.
"""

import numpy as np
from numba import complex128, float64, int64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled
from async_tnt.kernels.volume.records import COLUMNS


@entry_point(*COLUMNS, int64, float64, float64, int64, float64[:, :, ::1])
def contrast_frames(t, x, y, p, end_us, step_on, step_off, cell, frames):
    """The change of log luminance since the window's start, as the events tell it.

    frames[k] is the change up to (k + 1) end_us / K.

    Parameters
    ----------
    t : int, (N,), in [0, end_us), in order. Microseconds since the window's start.
    x, y : int, (N,).
    p : int, (N,), 0 or 1.
    end_us : int. The window's length.
    step_on, step_off : float. The thresholds: the change that an event tells of.
    cell : int. The side of a cell in sensor pixels. A cell averages its pixels.
    frames : float64, (K, rows, columns). Overwritten.
    """
    n_frames = len(frames)
    frames[:] = 0.0
    for i in range(len(t)):
        step = step_on if p[i] > 0 else -step_off
        k = np.int64(t[i]) * n_frames // end_us
        frames[k, y[i] // cell, x[i] // cell] += step / (cell * cell)
    for k in range(1, n_frames):
        frames[k] += frames[k - 1]


@entry_point(
    complex128[:, :, ::1],
    float64[:, ::1],
    *(float64[::1],) * 4,
    *(float64[:, ::1],) * 2,
    complex128[:, ::1],
)
def evidence_terms(
    spectra, path, frequencies_x, frequencies_y, weights, prior, whitening, gradient, moving
):
    """The evidence of a path that N windows share, summed, and its gradient.

    With the phase e_k = exp(-i q r_k), a = e - 1, whitened by W, and each window's posterior mean
    X = b / (h + Q):

        E = 1/2 sum |b|^2 / (h + Q) - log(1 + h / Q)          h = |W a|^2,  b = (W a)^* W c
        dE/dr_k = sum Re[i q conj(e_k) (W^T (W c conj(X) - (|X|^2 + 1 / (h + Q)) W a))_k]

    Sums are over windows and over frequencies. Frequencies with a positive x count twice.

    Parameters
    ----------
    spectra : complex128, (N, F, K): W c of each window.
    path : float64, (K, 2): r.
    frequencies_x, frequencies_y : float64, (nx,) and (ny,), in radians per cell. F = ny nx, and x
        changes fastest.
    weights : float64, (nx,): 1 or 2.
    prior : float64, (F,): Q.
    whitening : float64, (K, K), lower triangular: W.
    gradient : float64, (K, 2). Overwritten.
    moving : complex128, (F, K): e_k times the root of the weighted sum of |X|^2. Overwritten.

    Returns
    -------
    float : E.
    """
    n_windows, _, n_frames = spectra.shape
    n_x = len(frequencies_x)
    phase = np.empty(n_frames, np.complex128)
    white = np.empty(n_frames, np.complex128)
    residual = np.empty(n_frames, np.complex128)
    evidence = 0.0
    gradient[:] = 0.0
    for f in range(len(prior)):
        qx = frequencies_x[f % n_x]
        qy = frequencies_y[f // n_x]
        weight = weights[f % n_x]

        # W a and h
        h = 0.0
        for k in range(n_frames):
            angle = -(qx * path[k, 0] + qy * path[k, 1])
            phase[k] = complex(np.cos(angle), np.sin(angle))
            total = 0j
            for m in range(k + 1):
                total += whitening[k, m] * (phase[m] - 1.0)
            white[k] = total
            h += total.real**2 + total.imag**2

        # E, and the sums over windows of |X|^2 and W c conj(X)
        precision = h + prior[f]
        evidence -= 0.5 * weight * n_windows * np.log1p(h / prior[f])
        power = 0.0
        residual[:] = 0j
        for n in range(n_windows):
            b = 0j
            for k in range(n_frames):
                b += np.conj(white[k]) * spectra[n, f, k]
            mean = b / precision
            evidence += 0.5 * weight * (b.real**2 + b.imag**2) / precision
            power += mean.real**2 + mean.imag**2
            for k in range(n_frames):
                residual[k] += spectra[n, f, k] * np.conj(mean)

        # dE/dr
        spread = power + n_windows / precision
        for k in range(n_frames):
            residual[k] -= spread * white[k]
        for k in range(n_frames):
            total = 0j
            for m in range(k, n_frames):
                total += whitening[m, k] * residual[m]
            slope = weight * (1j * np.conj(phase[k]) * total).real
            gradient[k, 0] += qx * slope
            gradient[k, 1] += qy * slope
            moving[f, k] = np.sqrt(weight * power) * phase[k]
    return evidence


@entry_point(float64[:, :, ::1], float64[:, ::1], float64[:, :, ::1], int64, float64, float64)
def move_periodic(frames, image, places, first_row, origin, step):
    """Pictures of a fine image that repeats itself, moved over the sensor.

        (u, v)          = places[k] @ (x, y, 1)
        frames[k, y, x] = image at column (u - origin) step and row (v - origin) step

    Between the places of the image, values are bilinear.

    Parameters
    ----------
    frames : float64, (K, H, W). Overwritten.
    image : float64, (h, w).
    places : float64, (K, 2, 3), finite. Which place of the image, in sensor pixels, a pixel sees.
    first_row : int. The row of the sensor that is the first one of `frames`.
    origin : float. Where the image's first place is, in sensor pixels.
    step : float. Places of the image in a sensor pixel.
    """
    n_rows, n_columns = image.shape
    for k in range(frames.shape[0]):
        along_x, along_y, aside = places[k, 0] * step
        down_x, down_y, down = places[k, 1] * step
        aside = (aside - origin * step) % n_columns
        down = (down - origin * step) % n_rows
        for y in range(frames.shape[1]):
            for x in range(frames.shape[2]):
                column = along_x * x + along_y * (first_row + y) + aside
                row = down_x * x + down_y * (first_row + y) + down
                left = np.floor(column)
                top = np.floor(row)
                x_frac = column - left
                y_frac = row - top
                i = _around(int(top), n_rows)
                j = _around(int(left), n_columns)
                below = i + 1 if i + 1 < n_rows else 0
                right = j + 1 if j + 1 < n_columns else 0
                upper = (1.0 - x_frac) * image[i, j] + x_frac * image[i, right]
                lower = (1.0 - x_frac) * image[below, j] + x_frac * image[below, right]
                frames[k, y, x] = (1.0 - y_frac) * upper + y_frac * lower


@compiled
def _around(i, n):
    """i % n without a division. It is quick where `i` is near [0, n)."""
    while i >= n:
        i -= n
    while i < 0:
        i += n
    return i
