"""From transformed coordinates to cells: which eight, and how much each gets.

    V[b, y, x] += s k(b - b_i) k(y - v_i) k(x - u_i)        k(a) = max(0, 1 - |a|)

Zhu, Yuan, Chaney, Daniilidis 2019 (arXiv 1812.08156), the discretized event volume; many call it a voxel grid.
"""

from collections import namedtuple

import numpy as np

from . import state as S
from .jit import inlined

Grid = namedtuple(
    "Grid", "scale_x scale_y center_x center_y max_u max_v bin_scale sign_off sign_rise row plane off_shift"
)
Grid.__doc__ = """A volume's parameters in registers: read once a block, as no store can change them behind us."""

BORDER_TOLERANCE = 1e-9  # pixels; rounding must not decide over an event that mathematics puts on the border


@inlined
def on_grid(value, upper):
    """0 <= value <= upper, up to rounding; False for nan and inf."""
    return (value >= -BORDER_TOLERANCE) & (value <= upper + BORDER_TOLERANCE)


@inlined
def grid_of(floats, ints):
    """The `Grid` of a volume's state."""
    return Grid(
        floats[S.SCALE_X],
        floats[S.SCALE_Y],
        floats[S.CENTER_X],
        floats[S.CENTER_Y],
        floats[S.MAX_U],
        floats[S.MAX_V],
        floats[S.BIN_SCALE],
        floats[S.SIGN_OFF],
        floats[S.SIGN_ON] - floats[S.SIGN_OFF],
        np.float64(ints[S.ROW]),
        np.float64(ints[S.PLANE]),
        np.float64(ints[S.OFF_SHIFT]),
    )


@inlined
def place_event(grid, dt, on, num_x, num_y, den):
    """Where an event goes and what it weighs there.

    Parameters
    ----------
    grid : Grid.
    dt : float. Microseconds since the window's start, at least 0.
    on : float. 1 for an ON event, 0 for an OFF event.
    num_x, num_y, den : float. Displacement from the landmark, see `landmark`.

    Returns
    -------
    corner : int. Flat index of the cell at (floor b, floor v, floor u).
    y_frac, x_frac : float in [0, 1). Distance from the corner.
    early, later : float. What goes to bin floor b and to the next; they sum to the event's sign.
    b_floor, v_floor : int32. First bin and row.
    keep : bool. Whether the event is on the grid. If not, it weighs nothing at a legal place, so that
        adding it needs no branch.
    """
    # u = (x_g - l_g) / tau + c, see `landmark`; den = 0 gives inf or nan, which are not on the grid
    inverse = 1.0 / den
    u = num_x * inverse * grid.scale_x + grid.center_x
    v = num_y * inverse * grid.scale_y + grid.center_y
    b = dt * grid.bin_scale
    keep = on_grid(u, grid.max_u) & on_grid(v, grid.max_v)
    u = u if keep else 0.0
    v = v if keep else 0.0
    u_floor = np.trunc(u)  # the floor of what is not negative (-1e-9 counts as 0)
    v_floor = np.trunc(v)
    b_floor = np.trunc(b)
    sign = grid.sign_off + on * grid.sign_rise
    sign = sign if keep else 0.0
    later = sign * (b - b_floor)
    # one conversion: all are whole numbers below 2**31, exact in float64
    corner = np.int32(b_floor * grid.plane + v_floor * grid.row + u_floor * 2.0 + (1.0 - on) * grid.off_shift)
    return corner, v - v_floor, u - u_floor, sign - later, later, np.int32(b_floor), np.int32(v_floor), keep


@inlined
def add_event(cells, corner, row, y_frac, x_frac, early, later):
    """Add one placed event to the two times four numbers around its place.

    Parameters
    ----------
    cells : float64, flat, laid out as in `state`. Updated in place.
    corner : uint64. Unsigned, for then Numba leaves out its test for a negative index; not checked here.
    row : uint64. Distance to the next row.
    y_frac, x_frac, early, later : as `place_event` returns them.
    """
    one = np.uint64(1)
    two = np.uint64(2)
    three = np.uint64(3)
    w11 = y_frac * x_frac
    w10 = y_frac - w11  # y_frac (1 - x_frac)
    w01 = x_frac - w11  # (1 - y_frac) x_frac
    w00 = 1.0 - x_frac - w10  # (1 - y_frac) (1 - x_frac)
    cells[corner] += early * w00
    cells[corner + one] += later * w00
    cells[corner + two] += early * w01
    cells[corner + three] += later * w01
    corner += row
    cells[corner] += early * w10
    cells[corner + one] += later * w10
    cells[corner + two] += early * w11
    cells[corner + three] += later * w11
