"""A network as numbers: four flat arrays, since each array that Python passes to a kernel costs 45
ns.

    program  int64    the header below, one record for each step, then tables of distances
    weights  float32  never changed
    maps     float32  what the network has computed of its current input, and behind it of an empty
                      one
    places   uint32   as uint64: which places of each map have changed, see `changes`; a list of
                      places

A map is stored as (row, column, channel), within a frame that stands for the padding of the
convolutions that read it. A place is one number, row << 16 | column. A step computes one map, of
one of these:

    MIX      out[f] = bias[f] + sum over runs r, numbers k of w[r, k, f] in[runs[r] + k]         convolution
    SUM      out[c] = bias[c] + sum over taps r of w[r, c] in[taps[r] + c]                       each channel by itself
    MAXIMUM  out[c] = max over taps r of in[taps[r] + c]                                         likewise
    FUNCTION out[c] = f(in[taps[0] + c]), f of `functions`                                       likewise
    SPREAD   a block of places, out[c] = in[taps[0] + c block^2 + (row, column in the block)]     each as it is

and then of its activation, clip(out < 0 ? slope out : out, low, high). A convolution's runs are the
rows of its kernel, or its taps; its groups are computed one after another. SUM is average pooling,
addition, normalization, a depthwise convolution, and the second half of a dense layer, whose first
half is a MIX with weights of its own at each place: a sum over many places is kept in parts, by
place and by row, so that an update costs little and gives the bits of a sum from scratch.

Weights of a MIX, for each group (for each place, where they differ), are blocks of at most two
registers of filters, each padded with zeros to whole registers: (K, n) weights, (n,) biases, (n,)
slopes, low, high, and zeros up to a register. Those of the others: (taps, C) weights, of a SUM only
(for each place, where they differ), (C,) biases, (C,) slopes, low and high likewise, with C padded
to whole registers.
"""

# header
N_STEPS = 0
CHANNELS = 1  # of the volume
HEIGHT = 2
WIDTH = 3
PLANES = 4  # where in `maps` the volume lies as (C, H, W)
INPUT = 5  # and where as a map: its first pixel
INPUT_DY = 6  # numbers from one row to the next
OUTPUT = 7  # where in `maps` the last step's numbers lie
OUTPUT_DY = 8
LIST = 9  # where in `places` the list of dirty places lies
SCRATCH = 10  # where in `places`, as uint64, a row of bits lies, in a frame of zeros
SCRATCH_WORDS = 11  # how long it may be
EPOCH = 12  # the window that the input shows, see `state`; 0: none
N_SEEN = 13  # how many corners of the window's log are in the input
STALE = 14  # 1: nothing has been computed yet
EMPTY = 15  # numbers from a step's map to what it is for an empty window, see `empty_window`
EMPTY_IS_KNOWN = 16  # 1: it has been computed
INPUT_CHANGED = 17  # the record of its changes, see `changes`
INPUT_TOUCHED = 21  # likewise, of those since the window was empty

FIRST_STEP = 25
# a step's record
KIND = 0  # MIX, SUM, MAXIMUM, FUNCTION or SPREAD
N_SOURCES = 1  # whose changes it depends on
SOURCES = 2  # where in the program they lie: of each, where the record of its changes begins
KERNEL_Y = 3  # what a place sees of them
KERNEL_X = 4
STRIDE_Y = 5
STRIDE_X = 6
PAD_Y = 7
PAD_X = 8
DILATION_Y = 9
DILATION_X = 10
ROWS = 11  # of the map that it computes
COLUMNS = 12
N_COMPUTED = 13  # places in the last call
CHANGED = 14  # the record of its changes
TOUCHED = 18  # likewise, of those since the window was empty
IN = 22  # where in `maps` the first run or tap of place (0, 0) is counted from
IN_DY = 23
IN_DX = 24
OUT = 25
OUT_DY = 26
OUT_DX = 27
OUT_CHANNELS = 28  # of each group
RUNS = 29  # where in the program the distances of its runs or taps lie
N_RUNS = 30
RUN_LENGTH = 31  # of a MIX
GROUPS = 32  # of a MIX
GROUP_CHANNELS = 33  # input channels from one group to the next
WEIGHTS = 34
PLACE_WEIGHTS = 35  # numbers from one place's weights to the next one's; 0: they share them
APPLIED = 36  # of a FUNCTION: which one
BLOCK = 37  # of a SPREAD: the side of what one place becomes
STEP_SIZE = 38

MIX, SUM, MAXIMUM, FUNCTION, SPREAD = range(5)
