"""The landmark of a heatmap that a landmark network computes.

l = sum_{y,x} exp(e[y, x]) (x, y) / sum_{y,x} exp(e[y, x])          in grid pixels, float64
"""

import numpy as np
from numba import float32, int64

from async_tnt.kernels.entry_points import entry_point


@entry_point(float32[::1], int64, int64, int64)
def centroid(exponent, pitch, width, height):
    """The expectation (x, y) under a softmax over the heatmap's places.

    A common factor of all cells does not move the centroid. So exponents are taken relative to the
    largest one, and exp cannot overflow. Distances are taken from the grid's middle, so that a
    uniform heatmap gives exactly the middle.

    Parameters
    ----------
    exponent : float32. Row after row; a row is the first `width` of `pitch` numbers.
    pitch, width, height : int.

    Returns
    -------
    x, y : float. nan if an exponent is inf or nan.
    """
    largest = exponent[0]
    for y in range(height):
        for x in range(width):
            largest = max(largest, exponent[y * pitch + x])
    middle_x = (width - 1) / 2
    middle_y = (height - 1) / 2
    total = 0.0
    total_x = 0.0
    total_y = 0.0
    for y in range(height):
        row = 0.0
        for x in range(width):
            h = np.exp(np.float64(exponent[y * pitch + x]) - np.float64(largest))
            row += h
            total_x += h * (x - middle_x)
        total += row
        total_y += row * (y - middle_y)
    return middle_x + total_x / total, middle_y + total_y / total
