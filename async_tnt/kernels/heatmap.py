"""The landmark regressor's layers at batch size one: ReLU between convolutions, heatmap, centroid.

    e = sum_f w[f] ReLU(conv3(...))[f]          the heatmap's exponent, (H, W), float32 as in torch
    l = sum_{y,x} exp(e[y, x]) (x, y) / sum_{y,x} exp(e[y, x])          in grid pixels, float64

Its convolutions are those of `conv`: maps in one long row with a frame of zeros.
"""

import numpy as np

from .conv import convolve, frame
from .jit import compiled
from .simd import fma


@compiled
def rectify(maps, width, height, framed):
    """ReLU: the framed maps of the next convolution from what `convolve` wrote.

    Parameters
    ----------
    maps : float32, shape (F', at least H * (W + 2)), F <= F'. Its places W and W + 1 of each row are garbage.
    framed : float32, shape (F, at least (H + 2) * (W + 2)). Overwritten but for its frame.
    """
    zero = np.float32(0)
    for f in range(framed.shape[0]):
        for y in range(height):
            # unsigned, or Numba tests each index for being negative
            source = np.uint64(y * (width + 2))
            target = np.uint64((y + 1) * (width + 2) + 1)
            for x in range(width):
                framed[f, target + np.uint64(x)] = max(maps[f, source + np.uint64(x)], zero)


@compiled
def draw_heatmap(maps, weights, exponent):
    """exponent[i] = sum_f weights[f] ReLU(maps[f, i]), in the order of f, each term with one rounding.

    Parameters
    ----------
    maps : float32, shape (F', n), F <= F'. What `convolve` wrote.
    weights : float32, shape (F,): the 1x1 convolution.
    exponent : float32, shape (n,). Overwritten; garbage where the maps are.
    """
    zero = np.float32(0)
    for i in range(exponent.size):
        exponent[i] = zero
    for f in range(weights.size):
        weight = weights[f]
        for i in range(exponent.size):
            u = np.uint64(i)
            exponent[u] = fma(weight, max(maps[f, u], zero), exponent[u])


@compiled
def centroid(exponent, width, height):
    """The expectation (x, y) under a softmax over the heatmap's places; nan if an exponent is inf or nan.

    A common factor does not move the centroid: cells are relative to the largest, so exp cannot overflow.
    Distances are taken from the middle: a uniform heatmap gives it exactly.
    """
    largest = exponent[0]
    for y in range(height):
        for x in range(width):
            largest = max(largest, exponent[y * (width + 2) + x])
    middle_x = (width - 1) / 2
    middle_y = (height - 1) / 2
    total = 0.0
    total_x = 0.0
    total_y = 0.0
    for y in range(height):
        row = 0.0
        for x in range(width):
            h = np.exp(np.float64(exponent[y * (width + 2) + x]) - np.float64(largest))
            row += h
            total_x += h * (x - middle_x)
        total += row
        total_y += row * (y - middle_y)
    return middle_x + total_x / total, middle_y + total_y / total


@compiled
def find_landmark(volume, layers, maps):
    """The whole network: raw volume (C, H, W) -> landmark (x, y) in grid pixels.

    Parameters
    ----------
    layers : (weights, bias) of conv1, conv2, conv3 as `convolve` takes them, flattened; the 1x1 weights.
    maps : (framed1, framed2, framed3, out, exponent), scratch; frames are zero, `out` has room for the
        convolution with the most filters.
    """
    conv1_w, conv1_b, conv2_w, conv2_b, conv3_w, conv3_b, heatmap_w = layers
    framed1, framed2, framed3, out, exponent = maps
    _, height, width = volume.shape
    frame(volume, framed1)
    convolve(framed1, conv1_w, conv1_b, width, out)
    rectify(out, width, height, framed2)
    convolve(framed2, conv2_w, conv2_b, width, out)
    rectify(out, width, height, framed3)
    convolve(framed3, conv3_w, conv3_b, width, out)
    draw_heatmap(out, heatmap_w, exponent)
    return centroid(exponent, width, height)
