"""An image that moves over the sensor: the evidence for its path, and the pictures on the sensor.

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

    frames[k] is the change up to the time (k + 1) end_us / K.

    Parameters
    ----------
    t : int, (N,), in [0, end_us), in order. Microseconds since the window's start.
    x, y : int, (N,).
    p : int, (N,), 0 or 1.
    end_us : int. The window's length.
    step_on, step_off : float. The thresholds: the change of log luminance at an event.
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
    spectra,
    path,
    frequencies_x,
    frequencies_y,
    weights,
    prior,
    whitening,
    gradient,
    weighted_phases,
):
    """The evidence of a path for N windows, summed over the windows, and its gradient.

    e_k = exp(-i q r_k) is a phase, a = e - 1, and W whitens. X = b / (h + Q) is the posterior mean
    of a window's image:

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
    weighted_phases : complex128, (F, K): sqrt(w P) e_k, with the weight w of the frequency in
        `weights`, and P the sum over windows of |X|^2. Overwritten.

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
            weighted_phases[f, k] = np.sqrt(weight * power) * phase[k]
    return evidence


@entry_point(float64[:, :, ::1], float64[:, ::1], float64[:, :, ::1], int64, float64, float64)
def move_periodic(frames, image, places, first_row, origin, step):
    """The pictures that the sensor sees of a moving image, which repeats itself.

        (u, v)          = places[k] @ (x, y, 1)
        frames[k, y, x] = image at column (u - origin) step and row (v - origin) step

    Between the places of the image, values are bilinear.

    Parameters
    ----------
    frames : float64, (K, H, W). Overwritten.
    image : float64, (h, w).
    places : float64, (K, 2, 3), finite. Maps a sensor pixel (x, y) to the place (u, v) of the image
        that it sees, in sensor pixels.
    first_row : int. The row of the sensor that is the first one of `frames`.
    origin : float. u and v of the image's first place, in sensor pixels.
    step : float. Number of places of the image along a side of a sensor pixel.
    """
    n_rows, n_columns = image.shape
    for k in range(frames.shape[0]):
        column_per_x, column_per_y, column_0 = places[k, 0] * step
        row_per_x, row_per_y, row_0 = places[k, 1] * step
        column_0 = (column_0 - origin * step) % n_columns
        row_0 = (row_0 - origin * step) % n_rows
        for y in range(frames.shape[1]):
            for x in range(frames.shape[2]):
                column = column_per_x * x + column_per_y * (first_row + y) + column_0
                row = row_per_x * x + row_per_y * (first_row + y) + row_0
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
    """i % n without a division. It is quick if `i` is near the range [0, n)."""
    while i >= n:
        i -= n
    while i < 0:
        i += n
    return i
