"""A network as numbers: four flat arrays.

Each array that Python passes to a kernel costs 45 ns, so there are only four:

    program  int64    the header below, one record for each step, then tables of distances
    weights  float32  never changed
    maps     float32  the maps of the current input; behind them, the maps of an empty window
    places   uint32   seen as uint64: which places of each map have changed, see `changes`;
                      seen as uint32: a list of places

A map is stored as (row, column, channel), within a frame that stands for the padding of the
convolutions that read it. A place is one number, row << 16 | column. A step computes one map. At
each place it computes one of these:

    MIX       out[f] = bias[f] + sum over inputs i of w[i, f] in[distances[i]]
    SUM       out[c] = bias[c] + sum over taps r of w[r, c] in[taps[r] + c]
    MAXIMUM   out[c] = max over taps r of in[taps[r] + c]
    FUNCTION  out[c] = f(in[taps[0] + c]), with f of `functions`
    PICK      out[c] = in[taps[0] + channels[i C + c]],  i = block (row % block) + column % block
    PRODUCT   out[c] = first[c] second[c]
    TOTAL     out[c] = first[c] + second[c]

and then the activation, clip(out < 0 ? slope out : out, low, high). A PICK, a PRODUCT and a TOTAL
have none.

A MIX is a convolution, and its groups are computed one after another. Its inputs lie side by side
in runs, which are the rows of its kernel, or its taps. An input i is one number of the program,
distances[i] | i << 32. Inputs that are 0 may be left out, and the sum is never -0, see `tiles`. The
other steps treat each channel by itself. A SUM is average pooling, addition, normalization, a
depthwise convolution, or the second half of a dense layer. The first half of a dense layer is a MIX
with other weights at each place: a sum over many places is kept in parts, by place and by row, so
that an update costs little and gives the bits of a sum from scratch. A PICK copies some channels in
any order; with a block above 1 it makes a block of places of each place of its source. In a PICK,
PRODUCT or TOTAL an input of one place counts for all places; in a PRODUCT or TOTAL one of one
channel counts for all channels.

The weights of a MIX are blocks of filters, group after group; and so for each place, if places have
weights of their own. A block holds at most REGISTERS registers of filters, padded with zeros to n,
a multiple of LANES:

    (K, n) weights    (n,) biases    (n,) slopes    low, high    zeros up to a register

The weights of SUM, MAXIMUM and FUNCTION, with C channels padded to a multiple of LANES:

    (taps, C) weights, of a SUM only    (C,) biases    (C,) slopes    low, high

A SUM may also have other weights at each place.
"""

from numba import float32, int64, types, uint32

NETWORK = (
    int64[::1],
    types.Array(float32, 1, "C", readonly=True),
    float32[::1],
    uint32[::1],
)
"""Numba's types of the four arrays."""

# header
N_STEPS = 0
CHANNELS = 1  # channels of the volume
HEIGHT = 2
WIDTH = 3
PLANES = 4  # where in `maps` the volume lies as (C, H, W)
INPUT = 5  # where in `maps` the volume lies as a map: its first pixel
INPUT_DY = 6  # stride of that map's rows, in numbers
OUTPUT = 7  # where in `maps` the last step's numbers lie
OUTPUT_DY = 8
LIST = 9  # where in `places` the list of dirty places lies
SCRATCH = 10  # where in `places`, as uint64, a row of bits lies, in a frame of zeros
SCRATCH_WORDS = 11  # how long it may be
EPOCH = 12  # the window that the input shows, see `state`; 0: none
N_SEEN = 13  # how many corners of the window's log are in the input
STALE = 14  # 1: nothing has been computed yet
EMPTY = 15  # numbers from a step's map to its map of an empty window, see `empty_window`
EMPTY_IS_KNOWN = 16  # 1: the maps of an empty window have been computed
INPUT_CHANGED = 17  # the record of the input's changes, see `changes`
INPUT_TOUCHED = 21  # the record of its changes since the window was empty
LISTED = 25  # where in the program the inputs of a tile are listed that are not all 0

FIRST_STEP = 26  # where the record of the first step begins
# a step's record
KIND = 0  # MIX, SUM, MAXIMUM, FUNCTION, PICK, PRODUCT or TOTAL
N_SOURCES = 1  # how many maps it reads
# Where in the program a list of these maps lies. For each map it has the place where the record of
# the map's changes begins.
SOURCES = 2
KERNEL_Y = 3  # rows of a source that a place sees, `DILATION_Y` apart
KERNEL_X = 4
STRIDE_Y = 5
STRIDE_X = 6
PAD_Y = 7
PAD_X = 8
DILATION_Y = 9
DILATION_X = 10
ROWS = 11  # rows of the map that it computes
COLUMNS = 12
N_COMPUTED = 13  # places that the last call computed
CHANGED = 14  # the record of the map's changes
TOUCHED = 18  # the record of its changes since the window was empty
IN = 22  # where in `maps` the first run or tap of place (0, 0) is counted from
IN_DY = 23
IN_DX = 24
OUT = 25
OUT_DY = 26
OUT_DX = 27
OUT_CHANNELS = 28  # output channels of each group
# Where in the program the distances of its taps lie; of a MIX: its inputs, run by run; of a PICK:
# its tap, then `channels`; of a PRODUCT or TOTAL: for each input its tap and the strides of its
# rows, columns and channels.
RUNS = 29
N_RUNS = 30
RUN_LENGTH = 31  # MIX only: numbers of a run
GROUPS = 32  # MIX only; others have one
GROUP_CHANNELS = 33  # input channels from one group to the next
WEIGHTS = 34  # where in `weights` its weights begin
PLACE_WEIGHTS = 35  # stride of the places' weights, in numbers; 0: all places share them
APPLIED = 36  # FUNCTION only: the function's number
BLOCK = 37  # PICK only: the side of the block that one place becomes
TILES_UNLISTED = 38  # MIX only: how many more tiles are computed from all inputs, see `tiles`
PAUSE = 39  # MIX only: how many tiles that was when it was last decided
# PICK, PRODUCT and TOTAL only: how many maps in the list SOURCES, from the first on, have one place
# that counts for all places
N_WHOLE = 40
STEP_SIZE = 41  # numbers in a record

ALWAYS = 1 << 62
"""TILES_UNLISTED of a step that leaves no input out."""

# KIND
MIX = 0
SUM = 1
MAXIMUM = 2
FUNCTION = 3
PICK = 4
PRODUCT = 5
TOTAL = 6

# the table of a PRODUCT or TOTAL, for each input: where its place (0, 0) lies, then its strides
DY = 1
DX = 2
DK = 3  # 0: its one channel counts for all
OF_TWO_SIZE = 4
