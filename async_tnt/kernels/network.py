"""The classifier's layers at batch size one: convolution, pooling, dense, softmax.

Feature maps are stored with a frame of zeros, shape (C, (H + 2) * (W + 2) + 2) per flat row: then a 3x3
convolution is nine shifted reads of one long row, without borders, which runs in vector registers. What it
computes at the frame's places is never read. A network's output depends on the order of its sums: here input
channel by input channel, tap by tap, each with one rounding (`fma`).
"""

import numpy as np

from .fma import fma
from .jit import compiled, inlined


@compiled
def frame(volume, framed):
    """Copy a volume (C, H, W) into framed maps (C, (H + 2) * (W + 2) + 2), whose frame stays zero."""
    channels, height, width = volume.shape
    for c in range(channels):
        for y in range(height):
            source = volume[c, y]
            target = framed[c, (y + 1) * (width + 2) + 1 :]
            for x in range(width):
                target[x] = source[x]


@compiled
def convolve(framed, weights, bias, width, out):
    """3x3 convolution with zero padding.

        out[f, y, x] = bias[f] + sum_c,i,j w[f, c, i, j] in[c, y + i - 1, x + j - 1]

    Parameters
    ----------
    framed : float32, shape (C, (H + 2) * (W + 2) + 2). Framed input maps.
    weights : float32, shape (F, C, 9), F a multiple of 4 (fill with zeros).
    bias : float32, shape (F,).
    width : int. W.
    out : float32, shape (F, H * (W + 2)). Overwritten; places W and W + 1 of each row are garbage.
    """
    n_filters, n_channels, _ = weights.shape
    for f in range(n_filters):
        for i in range(out.shape[1]):
            out[f, i] = bias[f]
    for f in range(0, n_filters, 4):
        for c in range(n_channels):
            _add_channel(framed, weights, width + 2, f, c, out)


@compiled
def _add_channel(framed, weights, row, f, c, out):
    """Add input channel c to four filters from f on, which share the nine reads of an input place."""
    # Unsigned indices, or Numba tests each for being negative; no slices, or it counts references to them.
    one, f0, c = np.uint64(1), np.uint64(f), np.uint64(c)
    f1, f2, f3 = f0 + one, f0 + one + one, f0 + one + one + one
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = _taps(weights, f0, c)
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = _taps(weights, f1, c)
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = _taps(weights, f2, c)
    d0, d1, d2, d3, d4, d5, d6, d7, d8 = _taps(weights, f3, c)
    for j in range(out.shape[1]):
        i = np.uint64(j)
        here = i + np.uint64(row)
        below = here + np.uint64(row)
        x0, x1, x2 = framed[c, i], framed[c, i + one], framed[c, i + one + one]
        x3, x4, x5 = framed[c, here], framed[c, here + one], framed[c, here + one + one]
        x6, x7, x8 = framed[c, below], framed[c, below + one], framed[c, below + one + one]
        out[f0, i] = _nine(out[f0, i], x0, x1, x2, x3, x4, x5, x6, x7, x8, a0, a1, a2, a3, a4, a5, a6, a7, a8)
        out[f1, i] = _nine(out[f1, i], x0, x1, x2, x3, x4, x5, x6, x7, x8, b0, b1, b2, b3, b4, b5, b6, b7, b8)
        out[f2, i] = _nine(out[f2, i], x0, x1, x2, x3, x4, x5, x6, x7, x8, c0, c1, c2, c3, c4, c5, c6, c7, c8)
        out[f3, i] = _nine(out[f3, i], x0, x1, x2, x3, x4, x5, x6, x7, x8, d0, d1, d2, d3, d4, d5, d6, d7, d8)


@inlined
def _taps(w, f, c):
    above = w[f, c, 0], w[f, c, 1], w[f, c, 2]
    here = w[f, c, 3], w[f, c, 4], w[f, c, 5]
    below = w[f, c, 6], w[f, c, 7], w[f, c, 8]
    return above + here + below


@inlined
def _nine(total, x0, x1, x2, x3, x4, x5, x6, x7, x8, w0, w1, w2, w3, w4, w5, w6, w7, w8):
    """total + sum_k w_k x_k, in this order."""
    total = fma(w0, x0, total)
    total = fma(w1, x1, total)
    total = fma(w2, x2, total)
    total = fma(w3, x3, total)
    total = fma(w4, x4, total)
    total = fma(w5, x5, total)
    total = fma(w6, x6, total)
    total = fma(w7, x7, total)
    return fma(w8, x8, total)


@compiled
def pool(maps, width, height, pooled, pooled_row, first):
    """ReLU, then 2x2 average pooling: pooled[f, y, x] = mean of relu(maps[f, 2y..2y+1, 2x..2x+1]).

    Parameters
    ----------
    maps : float32, shape (F', H * (W + 2)). What `convolve` wrote.
    pooled : float32, shape (F, ...), F <= F'. Overwritten at flat places first + y * pooled_row + x: framed
        maps for the next convolution, or plain ones for a dense layer.
    """
    for f in range(pooled.shape[0]):
        for y in range(height // 2):
            upper = maps[f, 2 * y * (width + 2) :]
            lower = maps[f, (2 * y + 1) * (width + 2) :]
            target = pooled[f, first + y * pooled_row :]
            for x in range(width // 2):
                total = max(upper[2 * x], np.float32(0)) + max(upper[2 * x + 1], np.float32(0))
                total += max(lower[2 * x], np.float32(0))
                total += max(lower[2 * x + 1], np.float32(0))
                target[x] = total * np.float32(0.25)


@compiled
def dense(values, weights, bias, relu, used, out):
    """out[j] = bias[j] + sum_i values[i] weights[i, j], in the order of i, then ReLU if asked.

    Parameters
    ----------
    values : float32, shape (n,). Zeros (after ReLU: many) are left out, which changes nothing.
    weights : float32, shape (n, m): a layer's weights transposed, so that a row is read in one go.
    bias, out : float32, shape (m,). `out` is overwritten.
    used : int64, shape (at least n,). Scratch: which values are not zero.
    """
    n_used = 0
    for i in range(values.size):
        used[n_used] = i
        n_used += values[i] != 0
    out[:] = bias
    n_blocked = n_used - n_used % 4
    for k in range(0, n_blocked, 4):  # four rows for one read and write of `out`
        _add_four_rows(values, weights, used[k], used[k + 1], used[k + 2], used[k + 3], out)
    for k in range(n_blocked, n_used):
        value = values[used[k]]
        for j in range(out.size):
            out[j] = fma(value, weights[used[k], j], out[j])
    if relu:
        for j in range(out.size):
            out[j] = max(out[j], np.float32(0))


@inlined
def _add_four_rows(values, weights, i0, i1, i2, i3, out):
    # Unsigned indices, or Numba tests each for being negative; no slices, or it counts references to them.
    u0, u1, u2, u3 = np.uint64(i0), np.uint64(i1), np.uint64(i2), np.uint64(i3)
    v0, v1, v2, v3 = values[u0], values[u1], values[u2], values[u3]
    for j in range(out.size):
        u = np.uint64(j)
        total = fma(v0, weights[u0, u], out[u])
        total = fma(v1, weights[u1, u], total)
        total = fma(v2, weights[u2, u], total)
        out[u] = fma(v3, weights[u3, u], total)


@compiled
def softmax(logits, probabilities):
    """probabilities[k] = exp(logits[k] - max) / sum, in float64."""
    largest = logits[0]
    for k in range(logits.size):
        largest = max(largest, logits[k])
    total = 0.0
    for k in range(logits.size):
        probabilities[k] = np.exp(np.float64(logits[k]) - np.float64(largest))
        total += probabilities[k]
    for k in range(logits.size):
        probabilities[k] /= total


@compiled
def forward(volume, layers, maps, logits):
    """The whole network: volume (C, H, W) -> logits (n_classes,).

    Parameters
    ----------
    layers : (weights, bias) of conv1, conv2, fc1, fc2 as `convolve` and `dense` want them, flattened.
    maps : (framed1, out1, framed2, out2, flat, hidden, used), scratch of the right shapes; frames are zero.
    """
    conv1_w, conv1_b, conv2_w, conv2_b, fc1_w, fc1_b, fc2_w, fc2_b = layers
    framed1, out1, framed2, out2, flat, hidden, used = maps
    _, height, width = volume.shape
    frame(volume, framed1)
    convolve(framed1, conv1_w, conv1_b, width, out1)
    pool(out1, width, height, framed2, width // 2 + 2, width // 2 + 3)
    convolve(framed2, conv2_w, conv2_b, width // 2, out2)
    pool(out2, width // 2, height // 2, flat, width // 2 // 2, 0)
    dense(flat.reshape(flat.size), fc1_w, fc1_b, True, used, hidden)
    dense(hidden, fc2_w, fc2_b, False, used, logits)
