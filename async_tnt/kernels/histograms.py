"""HATS: histograms of averaged time surfaces, one for each cell of the grid.

    T_i(z)  = #{j < i : x_j = x_i + z, p_j = p_i, j and i in the same cell}       z in {-3..3}^2
    h(z, p) = 1 / |C| sum_{i in C, p_i = p} T_i(z)                                |C| events in the cell, of both p

Sironi, Brambilla, Bourdis, Lagorce, Benosman 2018, arXiv:1803.07913, equations 5 to 8, without the factor
exp(-(t_i - t_j) / tau): there tau is ten thousand windows. j < i is the order of arrival.

Memory behind the log: events of each pixel and polarity, |C| of each cell, and the sums over i of each bin and cell.
"""

import numpy as np

from . import state as S
from .jit import compiled, inlined

RADIUS = 3
SIDE = 2 * RADIUS + 1
BINS = SIDE * SIDE


@inlined
def _pixels_of(cell, n_cells, n_pixels):
    """The pixels `first <= x < end` of a row that lie in this column of cells: x n_cells // n_pixels == cell."""
    return -(-cell * n_pixels // n_cells), -(-(cell + 1) * n_pixels // n_cells)


@compiled
def add_to_histograms(buffer, ints, x, y, p):
    """Add one event, in O(BINS): the bins of its cell become the sums divided by |C|."""
    width, height = ints[S.SENSOR_W], ints[S.SENSOR_H]
    n_columns, n_rows = np.int64(buffer[S.MAX_U]) + 1, np.int64(buffer[S.MAX_V]) + 1
    column, row = x * n_columns // width, y * n_rows // height
    n_polarities = 2 if ints[S.OFF_SHIFT] else 1
    of_polarity = 0 if (p > 0) | (n_polarities == 1) else 1
    pixels = ints[S.MEMORY] + of_polarity * width * height
    events = ints[S.MEMORY] + n_polarities * width * height
    place = row * n_columns + column
    sums = events + n_rows * n_columns + place * n_polarities * BINS
    top, bottom = _pixels_of(row, n_rows, height)
    left, right = _pixels_of(column, n_columns, width)
    left, right = max(left, x - RADIUS), min(right, x + RADIUS + 1)
    for other_y in range(max(top, y - RADIUS), min(bottom, y + RADIUS + 1)):
        z = of_polarity * BINS + (other_y - y + RADIUS) * SIDE + left - x + RADIUS
        source = pixels + other_y * width + left
        for k in range(right - left):
            buffer[np.uint64(sums + z + k)] += buffer[np.uint64(source + k)]
    buffer[pixels + y * width + x] += 1.0
    buffer[events + place] += 1.0
    corner, plane, size = S.CELLS + row * ints[S.ROW] + 2 * column, ints[S.PLANE], buffer[events + place]
    for z in range(n_polarities * BINS):
        buffer[np.uint64(corner + z * plane)] = buffer[np.uint64(sums + z)] / size
    log, n_log, last = ints[S.LOG], ints[S.N_LOG], ints[S.LOG_SIZE] - 1
    for z in range(0, n_polarities * BINS, 2):  # a corner stands for two bins
        ints[np.uint64(log + (n_log & last))] = corner + z * plane
        n_log += 1
    ints[S.N_LOG] = n_log
    ints[S.KEPT] += 1
    ints[S.BIN_LO] = 0
    ints[S.BIN_HI] = BINS - 1
