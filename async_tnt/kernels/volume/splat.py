"""Splat: the eight numbers of a volume that an event adds to, and what it adds.

    V[b, y, x] += s k(b - b_i) k(y - v_i) k(x - u_i)        k(a) = max(0, 1 - |a|)

Images of times have the same cells and another rule for them, `combine_time`.

Zhu, Yuan, Chaney, Daniilidis 2019 (arXiv 1812.08156): the discretized event volume, or voxel grid.
"""

from typing import NamedTuple

import numpy as np

from async_tnt.kernels.jit import inlined
from async_tnt.kernels.simd import add_f64x2
from async_tnt.kernels.volume import state as S

WEIGHT_TOLERANCE = 1e-9
"""Smaller weights are the rounding error of a place that lies on the next cell."""
SURFACE_DECAY = 2.0
"""Time constants of a time surface per window."""
BORDER_TOLERANCE = 1e-9
"""Pixels beyond the border that count as on it: rounding must not drop an event that lies there."""


class Grid(NamedTuple):
    """A volume's parameters as float64 values, named as in `state`.

    They are read once for each block: the compiler then knows that no store changes them.
    """

    scale_x: float
    scale_y: float
    center_x: float
    center_y: float
    max_u: float
    max_v: float
    bin_scale: float
    sign_off: float
    sign_on: float
    row: float
    plane: float
    off_shift: float


@inlined
def on_grid(value, upper):
    """Whether 0 <= value <= upper, up to rounding. False for nan and inf."""
    return (value >= -BORDER_TOLERANCE) & (value <= upper + BORDER_TOLERANCE)


@inlined
def grid_of(buffer, ints):
    """The `Grid` of a volume's state."""
    return Grid(
        buffer[S.SCALE_X],
        buffer[S.SCALE_Y],
        buffer[S.CENTER_X],
        buffer[S.CENTER_Y],
        buffer[S.MAX_U],
        buffer[S.MAX_V],
        buffer[S.BIN_SCALE],
        buffer[S.SIGN_OFF],
        buffer[S.SIGN_ON],
        np.float64(ints[S.ROW]),
        np.float64(ints[S.PLANE]),
        np.float64(ints[S.OFF_SHIFT]),
    )


@inlined
def place_event(grid, dt, is_on, num_x, num_y, den):
    """The cells that an event goes to, and its weights there.

    Parameters
    ----------
    grid : Grid.
    dt : float. Microseconds since the window's start, at least 0.
    is_on : bool. Polarity.
    num_x, num_y, den : float. Displacement from the landmark, see `landmark`.

    Returns
    -------
    corner : int. Index of the cell at (floor b, floor v, floor u) in the volume's buffer.
    y_frac, x_frac : float in [0, 1), up to the tolerance. Distance from the corner.
    lower, upper : float. Weights of bin floor b and of the next one. They sum to the event's sign.
    is_kept : bool. Whether the event is on the grid. If not, its weights are 0 at a valid place, so
        that adding it needs no branch.
    """
    # u = (x_g - l_g) / tau + c, see `landmark`. den = 0 gives inf or nan: not on the grid.
    inverse = 1.0 / den
    u = num_x * inverse * grid.scale_x + grid.center_x
    v = num_y * inverse * grid.scale_y + grid.center_y
    b = dt * grid.bin_scale

    is_kept = on_grid(u, grid.max_u) & on_grid(v, grid.max_v)
    u = u if is_kept else 0.0
    v = v if is_kept else 0.0
    u_floor = np.trunc(u)  # equals floor, as u >= 0 (-1e-9 counts as 0)
    v_floor = np.trunc(v)
    b_floor = np.trunc(b)

    sign = grid.sign_on if is_on else grid.sign_off
    sign = sign if is_kept else 0.0
    shift = 0.0 if is_on else grid.off_shift
    upper = sign * (b - b_floor)
    # One conversion is enough: all are whole numbers below 2**31, exact in float64.
    corner = S.CELLS + np.int32(b_floor * grid.plane + v_floor * grid.row + u_floor + shift)
    return corner, v - v_floor, u - u_floor, sign - upper, upper, is_kept


@inlined
def add_event(buffer, corner, row, second, y_frac, x_frac, lower, upper):
    """Add one placed event to eight cells, 2 x 2 neighbours in each of two bins; see `state`.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place.
    corner : uint64, which spares Numba's test for a negative index. Not checked here.
    row, second : uint64. Distances to the next row and to the event's second bin.
    y_frac, x_frac, lower, upper : what `place_event` returns.
    """
    w11 = y_frac * x_frac
    w10 = y_frac - w11  # y_frac (1 - x_frac)
    w01 = x_frac - w11  # (1 - y_frac) x_frac
    w00 = 1.0 - x_frac - w10  # (1 - y_frac) (1 - x_frac)
    add_f64x2(buffer, corner, w00, w01, lower)
    add_f64x2(buffer, corner + row, w10, w11, lower)
    corner += second
    add_f64x2(buffer, corner, w00, w01, upper)
    add_f64x2(buffer, corner + row, w10, w11, upper)


@inlined
def combine_time(buffer, corner, row, second, y_frac, x_frac, f, combine):
    """Combine one placed event with four cells of an image of times.

    With the event's time f in [0, 1] of the window, and its weight w in each of the four cells:

        newest   count += w,  time = max(time, f)
        mean     count += w,  mean += (f - mean) w / count
        surface  count += w,  surface = max(surface, exp(SURFACE_DECAY (f - 1)))

    The surface is the one at the window's end. At an earlier time, the surface is the same but for
    one factor of all cells, which depends only on the time. So cells change only where events come.
    Weights below WEIGHT_TOLERANCE are skipped.

    Parameters
    ----------
    buffer, corner, row, second, y_frac, x_frac : see `add_event`.
    f : float. The event's time.
    combine : int. One of the COMBINE_ numbers of `state`.

    References
    ----------
    Lagorce, Orchard, Galluppi, Shi, Benosman 2017, doi:10.1109/TPAMI.2016.2574707, equation 3.
    """
    w11 = y_frac * x_frac
    w10 = y_frac - w11
    w01 = x_frac - w11
    w00 = 1.0 - x_frac - w10
    one = np.uint64(1)
    for cell, w in (
        (corner, w00),
        (corner + one, w01),
        (corner + row, w10),
        (corner + row + one, w11),
    ):
        if w < WEIGHT_TOLERANCE:
            continue
        if combine == S.COMBINE_NEWEST:
            buffer[cell] += w
            buffer[cell + second] = max(buffer[cell + second], f)
            continue
        buffer[cell + second] += w
        if combine == S.COMBINE_SURFACE:
            buffer[cell] = max(buffer[cell], np.exp(SURFACE_DECAY * (f - 1.0)))
        else:
            buffer[cell] += (f - buffer[cell]) * w / buffer[cell + second]
