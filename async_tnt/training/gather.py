"""The compiled part of `batches`: choose and move each window's events, and make its volume."""

# mypy: disable-error-code="no-untyped-def"

import numpy as np

from async_tnt.kernels import state as S
from async_tnt.kernels.jit import compiled
from async_tnt.kernels.read import copy_cells, empty_volume
from async_tnt.kernels.update import absorb


@compiled
def window_volumes(
    buffer, scratch_t, scratch_x, scratch_y, scratch_p,
    t, x, y, p, first, last, start_us, limit_us, matrix, keep, seed, about_mean, n_bins, out,
):  # fmt: skip
    """The volume of each window into `out`.

    Parameters
    ----------
    buffer : float64, the volume's `kernels.state`. Updated in place, as are the scratch columns.
    scratch_t, scratch_x, scratch_y, scratch_p : as long as the longest recording.
    t, x, y, p : the recordings' columns, see `windows.Recordings`.
    first, last : int64, (N,). Each window's recording: its events `first <= i < last`.
    start_us, limit_us : int64, (N,). Each window.
    matrix, keep, seed : see `augment.Draws`.
    about_mean : the landmark is the centroid of the window's events.
    n_bins : B.
    out : float32, (N, C, H, W). Updated in place.
    """
    ints = buffer.view(np.int64)
    for i in range(out.shape[0]):
        n = _take_events(
            scratch_t, scratch_x, scratch_y, scratch_p, t, x, y, p,
            first[i], last[i], start_us[i], limit_us[i], matrix[i], keep[i], seed[i],
            ints[S.SENSOR_W], ints[S.SENSOR_H],
        )  # fmt: skip
        empty_volume(buffer, out[i], start_us[i], limit_us[i])
        ints[S.LOST] = 1  # every volume goes to another array, whole
        ints[S.BIN_LO] = 0
        ints[S.BIN_HI] = n_bins - 1
        if about_mean and n > 0:
            sum_x = 0
            sum_y = 0
            for k in range(n):
                sum_x += np.int64(scratch_x[k])
                sum_y += np.int64(scratch_y[k])
            buffer[S.FIXED_X] = sum_x / n
            buffer[S.FIXED_Y] = sum_y / n
        absorb(buffer, scratch_t, scratch_x, scratch_y, scratch_p, 0, n)
        copy_cells(buffer, out[i], n_bins)


@compiled
def _take_events(
    scratch_t, scratch_x, scratch_y, scratch_p, t, x, y, p, first, last, start_us, limit_us,
    matrix, keep, seed, width, height,
):  # fmt: skip
    """One window's events, moved and thinned, into the scratch columns; returns how many."""
    i = first + np.searchsorted(t[first:last], start_us)
    n = 0
    while i < last and t[i] < limit_us:
        if keep >= 1.0 or _uniform(seed, i) < keep:
            x_moved = np.floor(matrix[0, 0] * x[i] + matrix[0, 1] * y[i] + matrix[0, 2] + 0.5)
            y_moved = np.floor(matrix[1, 0] * x[i] + matrix[1, 1] * y[i] + matrix[1, 2] + 0.5)
            if 0 <= x_moved < width and 0 <= y_moved < height:
                scratch_t[n] = t[i]
                scratch_x[n] = np.uint16(x_moved)
                scratch_y[n] = np.uint16(y_moved)
                scratch_p[n] = p[i]
                n += 1
        i += 1
    return n


@compiled
def _uniform(seed, i):
    """A number in [0, 1) that belongs to (seed, i): the i-th of the generator SplitMix64.

    Steele, Lea, Flood 2014, Fast Splittable Pseudorandom Number Generators, with their constants. However
    many events are asked about, and in whatever order, each gets the same number.
    """
    z = seed + np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * 2.0**-53
