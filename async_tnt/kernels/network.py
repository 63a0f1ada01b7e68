"""The classifier's layers at batch size one: convolution, pooling, dense, softmax.

Feature maps are stored with a frame of zeros and as one long row: then a 3x3 convolution is nine shifted reads
of that row, without borders, which runs in vector registers. What it computes at the frame's places is never
read. A network's output depends on the order of its sums: here input channel by input channel, tap by tap,
each with one rounding (`fma`).
"""

import numpy as np

from .fma import fma
from .jit import compiled, inlined
from .strip import PLACES, convolve_strip


@compiled
def frame(volume, framed):
    """Copy a volume (C, H, W) into framed maps, shape (C, at least (H + 2) * (W + 2)), whose frame stays zero."""
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
    framed : float32, shape (C, framed places). Framed input maps.
    weights : float32, shape (blocks, C, 9, 8): eight filters a block, the last filled up with zeros.
    bias : float32, shape (blocks, 8).
    width : int. W.
    out : float32, shape (8 * blocks, strips * 32 >= H * (W + 2)). Overwritten; places W and W + 1 of each row,
        and those beyond the last row, are garbage.
    """
    n_blocks, n_channels = weights.shape[:2]
    flat_weights = weights.reshape(weights.size)
    flat_bias = bias.reshape(bias.size)
    flat_framed = framed.reshape(framed.size)
    flat_out = out.reshape(out.size)
    for block in range(n_blocks):
        for start in range(0, out.shape[1], PLACES):
            convolve_strip(
                flat_framed, framed.shape[1], width + 2, n_channels, start, flat_weights, flat_bias, block, flat_out,
                out.shape[1],
            )  # fmt: skip


@compiled
def pool(maps, width, height, pooled, pooled_row, first):
    """ReLU, then 2x2 average pooling: pooled[f, y, x] = mean of relu(maps[f, 2y..2y+1, 2x..2x+1]).

    Parameters
    ----------
    maps : float32, shape (F', at least H * (W + 2)). What `convolve` wrote. Overwritten.
    pooled : float32, shape (F, ...), F <= F'. Overwritten at flat places first + y * pooled_row + x: framed
        maps for the next convolution, or plain ones for a dense layer.
    """
    zero = np.float32(0)
    one = np.uint64(1)
    for f in range(pooled.shape[0]):
        for y in range(height // 2):
            # unsigned, or Numba tests each index for being negative
            upper = np.uint64(2 * y * (width + 2))
            lower = upper + np.uint64(width + 2)
            target = np.uint64(first + y * pooled_row)
            for x in range(width):  # the two rows' sum in place of the upper one
                i = np.uint64(x)
                maps[f, upper + i] = max(maps[f, upper + i], zero) + max(maps[f, lower + i], zero)
            for x in range(width // 2):
                i = np.uint64(x)
                pooled[f, target + i] = (maps[f, upper + i + i] + maps[f, upper + i + i + one]) * np.float32(0.25)


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
    for j in range(out.size):  # `out[:] = bias` would compile seconds of code for its error message
        out[j] = bias[j]
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
    """probabilities[k] = exp(logits[k] - max) / sum, in float64.

    Returns
    -------
    int : the first class of the largest logit; -1, and nothing written, if a logit is not finite.
    """
    largest = 0
    for k in range(logits.size):
        if not np.isfinite(logits[k]):
            return -1
        if logits[k] > logits[largest]:
            largest = k
    total = 0.0
    for k in range(logits.size):
        probabilities[k] = np.exp(np.float64(logits[k]) - np.float64(logits[largest]))
        total += probabilities[k]
    for k in range(logits.size):
        probabilities[k] /= total
    return largest


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
