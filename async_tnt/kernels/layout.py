"""Where the classifier's numbers lie: four flat arrays, since each array that Python passes to a kernel costs 45 ns.

    layout   int64, the slots below: sizes, and where each part of the other three begins
    weights  float32, never changed
    maps     float32, what the network has computed of its current input
    dirty    uint8, the dirty mask: which cells of the maps are out of date

The maps, with C channels, F and G filters of the two convolutions, U hidden units, K classes:

    input     (H + 2, C, W + 2)                   framed with zeros; rows of channels, see `conv_pool_1`
    pooled 1  (H // 2 + 2, W // 2 + 2, F)         framed with zeros
    pooled 2  (H // 4, W // 4, G)
    partial   (H // 4, W // 4, U)                 what each place adds to the hidden units
    rows      (H // 4, U)                         sums of a row's partials
    hidden    (U)
    logits    (K)

Filters, units and classes are padded with zeros to whole registers. A sum kept in parts (partial, row, total) is
updated by its parts, and has the same bits whichever of them changed.
"""

CHANNELS = 0
HEIGHT = 1
WIDTH = 2
F = 3  # filters of the first convolution, padded; F_USED: without padding
F_USED = 4
G = 5
G_USED = 6
U = 7
U_USED = 8
K = 9
ROWS_1 = 10  # H // 2
COLUMNS_1 = 11
ROWS_2 = 12  # H // 4
COLUMNS_2 = 13
# places in `maps`
INPUT = 16
POOLED_1 = 17
POOLED_2 = 18
PARTIAL = 19
ROW_SUMS = 20
HIDDEN = 21
LOGITS = 22
TILE = 23  # scratch: one tile's outputs, or which pixels of a row changed
# places in `weights`
CONV_1 = 24
BIAS_1 = 25
CONV_2 = 26
BIAS_2 = 27
DENSE_1 = 28
BIAS_3 = 29
DENSE_2 = 30
BIAS_4 = 31
# places in `dirty`: one flag for each row of a map, then one for each cell
DIRTY_1 = 32  # cells of pooled 1
DIRTY_2 = 33  # cells of pooled 2
DIRTY_3 = 34  # partials
# what the input shows
EPOCH = 36  # the window, see `state`; 0: none
N_SEEN = 37  # how many corners of the window's log are in the input
ACTIVE = 38  # from here on: scratch, the channels that a tile sums
"""Slots up to here; C + 1 more are scratch."""
