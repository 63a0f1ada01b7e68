"""A plain 3x3 convolution at batch size one, for the landmark network, which is computed whole at each read.

Feature maps are stored with a frame of zeros and as one long row: then a 3x3 convolution is nine shifted reads
of that row, without borders, which runs in vector registers. What it computes at the frame's places is never
read. A network's output depends on the order of its sums: here input channel by input channel, tap by tap,
each with one rounding (`fma`).
"""

from .conv_rows import PLACES, convolve_strip
from .jit import compiled


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
                flat_framed,
                framed.shape[1],
                width + 2,
                n_channels,
                start,
                flat_weights,
                flat_bias,
                block,
                flat_out,
                out.shape[1],
            )
