"""The compiled part of `batches`: choose and move each window's events, and make its volume, or the gradient of
a loss on its volume with respect to its landmark."""

# mypy: disable-error-code="no-untyped-def"

import numpy as np

from async_tnt.kernels import state as S
from async_tnt.kernels.absorb import absorb
from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.landmark import displace_fixed
from async_tnt.kernels.readout import cells_to_float32, empty_volume
from async_tnt.kernels.splat import grid_of, place_event

OWN, MEAN, GIVEN = 0, 1, 2
"""Landmark: the one of the volume's own mode; the centroid of the window's events; given for each window."""


@compiled
def window_volumes(
    buffer,
    scratch_t,
    scratch_x,
    scratch_y,
    scratch_p,
    t,
    x,
    y,
    p,
    first,
    last,
    start_us,
    limit_us,
    matrix,
    keep,
    seed,
    about,
    landmarks,
    n_bins,
    out,
):
    """The volume of each window into `out`.

    Parameters
    ----------
    buffer : float64, the volume's `kernels.state`. Updated in place, as are the scratch columns.
    scratch_t, scratch_x, scratch_y, scratch_p : as long as the longest recording.
    t, x, y, p : the recordings' columns, see `windows.Recordings`.
    first, last : int64, (N,). Each window's recording: its events `first <= i < last`.
    start_us, limit_us : int64, (N,). Each window.
    matrix, keep, seed : see `augment.Draws`.
    about : OWN, MEAN or GIVEN.
    landmarks : float64, (N, 2). Each window's landmark in sensor pixels, where they are given.
    n_bins : B.
    out : float32, (N, C, H, W). Updated in place.
    """
    ints = buffer.view(np.int64)
    for i in range(out.shape[0]):
        n = _take_events(
            scratch_t,
            scratch_x,
            scratch_y,
            scratch_p,
            t,
            x,
            y,
            p,
            first[i],
            last[i],
            start_us[i],
            limit_us[i],
            matrix[i],
            keep[i],
            seed[i],
            ints[S.SENSOR_W],
            ints[S.SENSOR_H],
        )
        empty_volume(buffer, out[i], start_us[i], limit_us[i], 0)  # nobody asks for its epoch
        ints[S.N_READ] = S.UNREAD  # every volume goes to another array, whole
        ints[S.BIN_LO] = 0
        ints[S.BIN_HI] = n_bins - 1
        if about == GIVEN:
            buffer[S.FIXED_X] = landmarks[i, 0]
            buffer[S.FIXED_Y] = landmarks[i, 1]
        elif about == MEAN and n > 0:
            sum_x = 0
            sum_y = 0
            for k in range(n):
                sum_x += np.int64(scratch_x[k])
                sum_y += np.int64(scratch_y[k])
            buffer[S.FIXED_X] = sum_x / n
            buffer[S.FIXED_Y] = sum_y / n
        absorb(buffer, scratch_t, scratch_x, scratch_y, scratch_p, 0, n)
        cells_to_float32(buffer, out[i], n_bins)


@compiled
def landmark_gradients(
    buffer,
    scratch_t,
    scratch_x,
    scratch_y,
    scratch_p,
    t,
    x,
    y,
    p,
    first,
    last,
    start_us,
    limit_us,
    matrix,
    keep,
    seed,
    landmarks,
    gradient,
    out,
):
    """dL/dl of each window into `out`, from dL/dV: the chain rule through

        V[b, y, x] = sum_i s_i k(b - b_i) k(y - v_i) k(x - u_i)        u_i = (x_i - l_x) / tau_i + c_x

        dL/dl_x = sum_i dL/du_i du_i/dl_x
                = sum_i -1/tau_i sum_b,y,x dL/dV[b, y, x] s_i k(b - b_i) k(y - v_i) k'(x - u_i)

    with k' = -1 at the left and +1 at the right neighbour. In one unit of length the landmark and u are grid
    pixels, so that 1/tau_i = window_us / (t_max dt).

    Parameters
    ----------
    landmarks : float64, (N, 2). Each window's landmark in sensor pixels.
    gradient : float32, (N, C, H, W). dL/dV.
    out : float64, (N, 2). dL/d(l_x, l_y), l in grid pixels. Overwritten.

    The others are those of `window_volumes`.
    """
    ints = buffer.view(np.int64)
    row = ints[S.ROW]
    plane = ints[S.PLANE]
    per_time = buffer[S.SCALE_X] * (ints[S.SENSOR_W] - 1) / buffer[S.MAX_U]  # window_us / t_max
    for i in range(out.shape[0]):
        n = _take_events(
            scratch_t,
            scratch_x,
            scratch_y,
            scratch_p,
            t,
            x,
            y,
            p,
            first[i],
            last[i],
            start_us[i],
            limit_us[i],
            matrix[i],
            keep[i],
            seed[i],
            ints[S.SENSOR_W],
            ints[S.SENSOR_H],
        )
        grid = grid_of(buffer, ints)
        total_x = 0.0
        total_y = 0.0
        for k in range(n):
            dt = np.float64(scratch_t[k] - start_us[i])
            num_x, num_y, den = displace_fixed(
                np.int64(scratch_x[k]), np.int64(scratch_y[k]), dt, landmarks[i, 0], landmarks[i, 1]
            )
            corner, y_frac, x_frac, early, later, kept = place_event(grid, dt, scratch_p[k] > 0, num_x, num_y, den)
            if not kept:
                continue
            place = np.int64(corner) - S.CELLS
            bin_ = place // plane
            y0 = (place - bin_ * plane) // row
            x0 = (place - bin_ * plane - y0 * row) // 2
            d_u = 0.0
            d_v = 0.0
            for later_bin in range(2):
                share = later if later_bin else early
                if share == 0.0:  # also at the last bin, which has no later one
                    continue
                g00 = _cell(gradient, i, bin_ + later_bin, y0, x0)
                g01 = _cell(gradient, i, bin_ + later_bin, y0, x0 + 1)
                g10 = _cell(gradient, i, bin_ + later_bin, y0 + 1, x0)
                g11 = _cell(gradient, i, bin_ + later_bin, y0 + 1, x0 + 1)
                d_u += share * ((1.0 - y_frac) * (g01 - g00) + y_frac * (g11 - g10))
                d_v += share * ((1.0 - x_frac) * (g10 - g00) + x_frac * (g11 - g01))
            total_x -= d_u * per_time / dt
            total_y -= d_v * per_time / dt
        out[i, 0] = total_x
        out[i, 1] = total_y


@inlined
def _cell(gradient, i, b, y, x):
    """dL/dV[b, y, x]; 0 one row or column beyond the grid, where nothing reads the volume."""
    inside = (y < gradient.shape[2]) & (x < gradient.shape[3])
    return np.float64(gradient[i, b, y, x]) if inside else 0.0


@compiled
def _take_events(
    scratch_t,
    scratch_x,
    scratch_y,
    scratch_p,
    t,
    x,
    y,
    p,
    first,
    last,
    start_us,
    limit_us,
    matrix,
    keep,
    seed,
    width,
    height,
):
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
