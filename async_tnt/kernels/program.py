"""A network as numbers: four flat arrays, since each array that Python passes to a kernel costs 45 ns.

    program  int64    the header below, one record for each step, then tables of distances
    weights  float32  never changed
    maps     float32  what the network has computed of its current input
    places   uint32   which places of each map have changed; scratch

A map is stored as (row, column, channel), within a frame that stands for the padding of the convolutions that read it.
A place is one number, row << 16 | column. A step computes one map, of one of these:

    MIX      out[f] = bias[f] + sum over runs r, numbers k of w[r, k, f] in[runs[r] + k]         convolution
    SUM      out[c] = bias[c] + sum over taps r of w[r, c] in[taps[r] + c]                       each channel by itself
    MAXIMUM  out[c] = max over taps r of in[taps[r] + c]                                         likewise

and then of its activation, clip(out < 0 ? slope out : out, low, high). A convolution's runs are the rows of its kernel,
or its taps; its groups are computed one after another. SUM is average pooling, addition, normalization, a depthwise
convolution, and the second half of a dense layer, whose first half is a MIX with weights of its own at each place: a
sum over many places is kept in parts, by place and by row, so that an update costs little and gives the bits of a sum
from scratch.

Weights of a MIX, for each group (for each place, where they differ), are blocks of at most two registers of filters,
each padded with zeros to whole registers: (K, n) weights, (n,) biases, (n,) slopes, low, high, and zeros up to a
register. Those of a SUM or MAXIMUM: (taps, C) weights, of a SUM only, (C,) biases, (C,) slopes, low and high likewise,
with C padded to whole registers.
"""

# header
N_STEPS = 0
CHANNELS = 1  # of the volume
HEIGHT = 2
WIDTH = 3
PLANES = 4  # where in `maps` the volume lies as (C, H, W)
INPUT = 5  # and where as a map: its first pixel
INPUT_DY = 6  # numbers from one row to the next
SCRATCH = 7  # where in `maps` a row of flags lies
OUTPUT = 8  # where in `maps` the last step's numbers lie
OUTPUT_DY = 9
LIST = 10  # where in `places` the list of dirty places lies; marks, see `marks`, lie at its beginning
EPOCH = 11  # the window that the input shows, see `state`; 0: none
N_SEEN = 12  # how many corners of the window's log are in the input
STALE = 13  # 1: nothing has been computed yet
INPUT_CHANGED = 14  # where in `places` the list of changed places begins, and in the next slot its length

FIRST_STEP = 16
# a step's record
KIND = 0  # MIX, SUM or MAXIMUM
N_SOURCES = 1  # whose changes it depends on
SOURCES = 2  # where in the program they lie: of each, where its CHANGED is
SOURCE_PLACES = 3  # in each of these maps
KERNEL_Y = 4  # what a place sees of them
KERNEL_X = 5
STRIDE_Y = 6
STRIDE_X = 7
PAD_Y = 8
PAD_X = 9
DILATION_Y = 10
DILATION_X = 11
ROWS = 12  # of the map that it computes
COLUMNS = 13
N_COMPUTED = 14  # places in the last call
CHANGED = 15  # as INPUT_CHANGED
IN = 17  # where in `maps` the first run or tap of place (0, 0) is counted from
IN_DY = 18
IN_DX = 19
OUT = 20
OUT_DY = 21
OUT_DX = 22
OUT_CHANNELS = 23  # of each group
RUNS = 24  # where in the program the distances of its runs or taps lie
N_RUNS = 25
RUN_LENGTH = 26  # of a MIX
GROUPS = 27  # of a MIX
GROUP_CHANNELS = 28  # input channels from one group to the next
WEIGHTS = 29
PLACE_WEIGHTS = 30  # numbers from one place's weights to the next one's; 0: they share them
STEP_SIZE = 31

MIX, SUM, MAXIMUM = range(3)
