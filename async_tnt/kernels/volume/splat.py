"""From transformed coordinates to the volume: which eight of its numbers an event adds to, and how
much.

    V[b, y, x] += s k(b - b_i) k(y - v_i) k(x - u_i)        k(a) = max(0, 1 - |a|)

Images of times have the same cells and another rule for them, `combine_time`.

Zhu, Yuan, Chaney, Daniilidis 2019 (arXiv 1812.08156): the discretized event volume, or voxel grid.
"""

from collections import namedtuple

import numpy as np

from async_tnt.kernels.jit import inlined
from async_tnt.kernels.simd import add_f64x2
from async_tnt.kernels.volume import state as S

Grid = namedtuple(
    "Grid",
    "scale_x scale_y center_x center_y max_u max_v bin_scale sign_off sign_on row plane off_shift",
)
Grid.__doc__ = """A volume's parameters as values, read once a block: the compiler then knows that no store changes them."""

WEIGHT_TOLERANCE = 1e-9
SURFACE_DECAY = 2.0  # time constants per window
BORDER_TOLERANCE = 1e-9  # pixels; rounding must not drop an event that lies exactly on the border


@inlined
def on_grid(value, upper):
    """0 <= value <= upper, up to rounding; False for nan and inf."""
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
def place_event(grid, dt, on, num_x, num_y, den):
    """Which cells an event goes to, and with what weights.

    Parameters
    ----------
    grid : Grid.
    dt : float. Microseconds since the window's start, at least 0.
    on : bool. Polarity.
    num_x, num_y, den : float. Displacement from the landmark, see `landmark`.

    Returns
    -------
    corner : int. Index of the cell at (floor b, floor v, floor u) in the volume's buffer.
    y_frac, x_frac : float in [0, 1), but for the tolerance. Distance from the corner.
    lower, upper : float. Weights of bin floor b and of the next one; they sum to the event's sign.
    keep : bool. Whether the event is on the grid. If not, its weights are 0 at a valid place, so
        that adding it needs no branch.
    """
    # u = (x_g - l_g) / tau + c, see `landmark`; den = 0 gives inf or nan, which are not on the grid
    inverse = 1.0 / den
    u = num_x * inverse * grid.scale_x + grid.center_x
    v = num_y * inverse * grid.scale_y + grid.center_y
    b = dt * grid.bin_scale
    keep = on_grid(u, grid.max_u) & on_grid(v, grid.max_v)
    u = u if keep else 0.0
    v = v if keep else 0.0
    u_floor = np.trunc(u)  # equals floor, as u >= 0 (-1e-9 counts as 0)
    v_floor = np.trunc(v)
    b_floor = np.trunc(b)
    sign = grid.sign_on if on else grid.sign_off
    sign = sign if keep else 0.0
    shift = 0.0 if on else grid.off_shift
    upper = sign * (b - b_floor)
    # one conversion: all are whole numbers below 2**31, exact in float64
    corner = S.CELLS + np.int32(b_floor * grid.plane + v_floor * grid.row + u_floor + shift)
    return corner, v - v_floor, u - u_floor, sign - upper, upper, keep


@inlined
def add_event(buffer, corner, row, second, y_frac, x_frac, lower, upper):
    """Add one placed event to eight cells, 2 x 2 neighbours in each of two bins; see `state`.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place.
    corner : uint64, which spares Numba's test for a negative index; not checked here.
    row, second : uint64. Distances to the next row and to the event's second bin.
    y_frac, x_frac, lower, upper : as `place_event` returns them.
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
    """`add_event` for images of times, f in [0, 1] of the window. With the weight w of each of the
    four cells:

        newest   count += w,  time = max(time, f)
        mean     count += w,  mean += (f - mean) w / count
        surface  count += w,  surface = max(surface, exp(SURFACE_DECAY (f - 1)))

    The surface is that at the window's end. At an earlier time it is the same but for one factor
    for all cells, which depends on nothing but the time; so no cell changes but where events come.
    Lagorce, Orchard, Galluppi, Shi, Benosman 2017, doi:10.1109/TPAMI.2016.2574707, equation 3.

    A weight below WEIGHT_TOLERANCE is skipped: it is the rounding error of a place that lies on the
    next cell.
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
