"""The volumes of many windows, and the gradients of their loss by the windows' landmarks.

Arguments that both kernels take:

    buffer   float64, the volume's `state`. Updated in place.
    scratch  columns t, x, y, p as long as the longest recording. Overwritten.
    columns  columns t, x, y, p of all recordings, end to end.
    windows  nine arrays, each with an entry for each of N windows:
             first, last : int64. The window's recording has the events `first <= i < last`.
             start_us, limit_us : int64. The window has the times `start_us <= t < limit_us`.
             matrix, keep, seed, content, place : how the window's events are moved and thinned, see
                 `augment.Draws`.
"""

import numpy as np
from numba import float32, float64, int32, int64, types, uint8, uint16, uint64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled, inlined
from async_tnt.kernels.volume import state as S
from async_tnt.kernels.volume.absorb import absorb
from async_tnt.kernels.volume.landmark import displace_fixed
from async_tnt.kernels.volume.readout import cell_at, cells_to_float32, empty_volume, mark_unread
from async_tnt.kernels.volume.records import COLUMNS
from async_tnt.kernels.volume.splat import grid_of, place_event

# The content of a window: its recording, or one of the kinds of nothing, see `_event_of_nothing`.
SHOWN = 0
SCATTERED = 1
ONE_POLARITY = 2
HOT_PIXELS = 3
PATCH = 4
EDGE = 5

# The landmark of a window: as the volume's state has it, the centroid of the window's events, or a
# given one.
OWN = 0
MEAN = 1
GIVEN = 2


BATCH = (
    types.Tuple(COLUMNS),
    types.Tuple((int32[::1], uint16[::1], uint16[::1], uint8[::1])),
    types.Tuple(
        (
            int64[::1],
            int64[::1],
            int64[::1],
            int64[::1],
            float64[:, :, ::1],
            float64[::1],
            uint64[::1],
            int64[::1],
            float64[:, ::1],
        )
    ),
)
"""Numba's types of `scratch`, `columns` and `windows`."""


@entry_point(
    S.STATE,
    *BATCH,
    int64,
    float64[:, ::1],
    float32[:, :, :, ::1],
    calls=(absorb, empty_volume, cells_to_float32),
)
def window_volumes(buffer, scratch, columns, windows, landmark_kind, landmarks, out):
    """Write the volume of each window into `out`.

    Parameters
    ----------
    buffer, scratch, columns, windows : see above.
    landmark_kind : OWN, MEAN or GIVEN.
    landmarks : float64, (N, 2). Each window's landmark in sensor pixels. Only read with GIVEN.
    out : float32, (N, C, H, W). Updated in place.
    """
    ints = buffer.view(np.int64)
    scratch_t, scratch_x, scratch_y, scratch_p = scratch
    start_us = windows[2]
    limit_us = windows[3]
    for i in range(out.shape[0]):
        n = _select_events(ints, scratch, columns, windows, i)
        # Every volume is written into another array, so no cell of it is known. The epoch, 0, is
        # not read.
        mark_unread(ints)
        empty_volume(buffer, out[i], start_us[i], limit_us[i], 0)

        if landmark_kind == GIVEN:
            buffer[S.FIXED_X] = landmarks[i, 0]
            buffer[S.FIXED_Y] = landmarks[i, 1]
        elif landmark_kind == MEAN and n > 0:
            sum_x = 0
            sum_y = 0
            for k in range(n):
                sum_x += np.int64(scratch_x[k])
                sum_y += np.int64(scratch_y[k])
            buffer[S.FIXED_X] = sum_x / n
            buffer[S.FIXED_Y] = sum_y / n

        absorb(buffer, scratch_t, scratch_x, scratch_y, scratch_p, 0, n)
        cells_to_float32(buffer, out[i])


@entry_point(
    S.STATE,
    *BATCH,
    float64[:, ::1],
    float32[:, :, :, ::1],
    float64[:, ::1],
)
def landmark_gradients(buffer, scratch, columns, windows, landmarks, gradient, out):
    """Write dL/dl of each window into `out`, from dL/dV: the chain rule through the volume.

        V[b, y, x] = sum_i s_i k(b - b_i) k(y - v_i) k(x - u_i)
        u_i = (x_i - l_x) / tau_i + c_x

        dL/dl_x = sum_i dL/du_i du_i/dl_x
                = sum_i -1/tau_i sum_b,y,x dL/dV[b, y, x] s_i k(b - b_i) k(y - v_i) k'(x - u_i)

    with k' = -1 at the left and +1 at the right neighbour. l and u are both in grid pixels, so
    1/tau_i = window_us / (t_max dt_i), where dt_i is the time of event i since the window's start.

    Parameters
    ----------
    buffer, scratch, columns, windows : see above.
    landmarks : float64, (N, 2). Each window's landmark in sensor pixels.
    gradient : float32, (N, C, H, W). dL/dV.
    out : float64, (N, 2). dL/d(l_x, l_y), l in grid pixels. Overwritten.
    """
    ints = buffer.view(np.int64)
    scratch_t, scratch_x, scratch_y, scratch_p = scratch
    start_us = windows[2]
    per_time = buffer[S.SCALE_X] * (ints[S.SENSOR_W] - 1) / buffer[S.MAX_U]  # window_us / t_max
    for i in range(out.shape[0]):
        n = _select_events(ints, scratch, columns, windows, i)
        grid = grid_of(buffer, ints)
        total_x = 0.0
        total_y = 0.0
        for k in range(n):
            dt = np.float64(scratch_t[k] - start_us[i])
            num_x, num_y, den = displace_fixed(
                np.int64(scratch_x[k]), np.int64(scratch_y[k]), dt, landmarks[i, 0], landmarks[i, 1]
            )
            corner, y_frac, x_frac, lower, upper, kept = place_event(
                grid, dt, scratch_p[k] > 0, num_x, num_y, den
            )
            if not kept:
                continue

            b, y, x = cell_at(ints, np.int64(corner), False)
            d_u = 0.0
            d_v = 0.0
            for is_upper in range(2):
                weight = upper if is_upper else lower
                if weight == 0.0:  # for example in the last bin, which has no bin above it
                    continue
                g00 = _cell(gradient, i, b + is_upper, y, x)
                g01 = _cell(gradient, i, b + is_upper, y, x + 1)
                g10 = _cell(gradient, i, b + is_upper, y + 1, x)
                g11 = _cell(gradient, i, b + is_upper, y + 1, x + 1)
                d_u += weight * ((1.0 - y_frac) * (g01 - g00) + y_frac * (g11 - g10))
                d_v += weight * ((1.0 - x_frac) * (g10 - g00) + x_frac * (g11 - g01))
            total_x -= d_u * per_time / dt
            total_y -= d_v * per_time / dt
        out[i, 0] = total_x
        out[i, 1] = total_y


@inlined
def _cell(gradient, i, b, y, x):
    """dL/dV[b, y, x] of window i; 0 in the row and the column after the last of the grid."""
    is_inside = (y < gradient.shape[2]) & (x < gradient.shape[3])
    return np.float64(gradient[i, b, y, x]) if is_inside else 0.0


@compiled
def _select_events(ints, scratch, columns, windows, window):
    """Write one window's events, moved and thinned, into the scratch columns.

    Returns the number of events written.
    """
    scratch_t, scratch_x, scratch_y, scratch_p = scratch
    t, x, y, p = columns
    firsts, lasts, starts_us, limits_us, matrices, keeps, seeds, contents, places = windows
    last = lasts[window]
    limit_us = limits_us[window]
    matrix = matrices[window]
    keep = keeps[window]
    seed = seeds[window]
    content = contents[window]

    first = firsts[window] + np.searchsorted(t[firsts[window] : last], starts_us[window])
    n = 0
    i = first
    while i < last and t[i] < limit_us:
        if keep >= 1.0 or _uniform(seed, i - first) < keep:
            x_moved = np.floor(matrix[0, 0] * x[i] + matrix[0, 1] * y[i] + matrix[0, 2] + 0.5)
            y_moved = np.floor(matrix[1, 0] * x[i] + matrix[1, 1] * y[i] + matrix[1, 2] + 0.5)
            polarity = p[i]
            if content != SHOWN:
                share = (t[i] - starts_us[window]) / (limit_us - starts_us[window])
                x_moved, y_moved, is_on = _event_of_nothing(
                    content, places[window], seed, i - first, share
                )
                # scattered events keep their polarity
                polarity = np.uint8(is_on) if content != SCATTERED else polarity
            if 0 <= x_moved < ints[S.SENSOR_W] and 0 <= y_moved < ints[S.SENSOR_H]:
                scratch_t[n] = t[i]
                scratch_x[n] = np.uint16(x_moved)
                scratch_y[n] = np.uint16(y_moved)
                scratch_p[n] = polarity
                n += 1
        i += 1
    return n


@compiled
def _event_of_nothing(content, place, seed, i, share):
    """The place (x, y) of event i of a window that shows nothing, and whether the event is ON.

    Parameters
    ----------
    content : int. The kind of nothing that the window shows.
    place : float64, (8,), in sensor pixels. Its last number is the share of ON events. The meaning
        of the first seven numbers depends on the kind of nothing:
        SCATTERED, ONE_POLARITY, PATCH : left, top, width and height of the events' rectangle.
        HOT_PIXELS : x and y of three pixels.
        EDGE : x and y of a point of the edge, the edge's normal (cosine, sine), the distance that
            the edge moves along its normal in the window, its thickness and its length.
    seed : uint64.
    i : int. The event's number.
    share : float. The share of the window that has passed, from 0 to 1.
    """
    # `seed` itself decides which events are kept. Other seeds give independent numbers.
    u = _uniform(~seed, 2 * i)
    v = _uniform(~seed, 2 * i + 1)
    is_on = _uniform(seed ^ np.uint64(0x5555555555555555), i) < place[7]
    if content == HOT_PIXELS:
        k = 2 * np.int64(3 * u)  # of the pixel 0, 1 or 2
        return place[k], place[k + 1], is_on
    if content == EDGE:
        across = place[4] * (share - 0.5) + place[5] * (u - 0.5)
        along = place[6] * (v - 0.5)
        x = place[0] + place[2] * across - place[3] * along
        y = place[1] + place[3] * across + place[2] * along
        return np.floor(x), np.floor(y), is_on
    return np.floor(place[0] + u * place[2]), np.floor(place[1] + v * place[3]), is_on


@compiled
def _uniform(seed, i):
    """The i-th number in [0, 1) of the generator SplitMix64 with this seed.

    The number depends on the seed and on i alone, not on other numbers that are drawn. The
    constants are those of the reference.

    References
    ----------
    Steele, Lea, Flood 2014, Fast Splittable Pseudorandom Number Generators.
    """
    z = seed + np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * 2.0**-53
