"""Where the numbers of a spiking network lie.

    program   int64: what is computed, see below
    weights   float32: of convolutions and dense layers
    params    float64: of neurons
    state     float64: what a window has, see below. Whole numbers lie in it as int64.

A network is a row of stages. Stage 0 is the event. Each other stage sums what arrives from earlier
stages through its links, and then decides what goes on: spikes of neurons, or the sums themselves.

    program = [ header | stages | links ]

A stage's numbers lie by place, and at each place by channel, in whole blocks: WIDTH numbers, of
which the first CHANNELS count. Its sums are zero between events, so an event touches only what its
spikes reach: the box of each stage.

    state = [ for each stage: sums | list of what goes on | of neurons: membranes, currents, times
            | of the output: counts, first times ]
"""

from numba import float32, float64, int64

NETWORK = (int64[::1], float32[::1], float64[::1], float64[::1])
"""Numba's types of program, weights, params and state."""

# program: the header
N_STAGES = 0  # with stage 0
CHANNEL_OF_OFF = 1
CHANNEL_OF_ON = 2
FIRST_STAGE = 4

# program: a stage
STAGE_SIZE = 24
LINKS = 0  # where its links begin in the program
N_LINKS = 1
CHANNELS = 2
ROWS = 3
COLUMNS = 4
NEURONS = 5  # one of the kinds below
RESET = 6  # one of the ways below
SUMS = 7  # in the state
LIST = 8  # in the state: the indices of what goes on, in increasing order
VALUES = 9  # in the state: their values
MEMBRANES = 10  # in the state
CURRENTS = 11  # in the state: synaptic currents
TIMES = 12  # in the state: of each place, the time up to which its neurons are computed
COUNTS = 13  # in the state: spikes of each neuron in the window; -1: they are not counted
FIRST_US = 14  # in the state: time of each neuron's first spike in the window, or -1
PARAMS = 15  # where its neurons' parameters begin
PARAMS_SIZE = 16  # numbers of one parameter: WIDTH, or as many for each place
# in the state: numbers of the last event
N_ACTIVE = 17  # length of the list
BOX = 18  # four numbers: first row, row behind the last one, the same of columns
N_SPIKES = 19  # in the state: spikes of the window
N_ADDED = 20  # in the state: additions of weights in the window
WIDTH = 21  # numbers of a place: CHANNELS, filled up to whole blocks

# program: a link
LINK_SIZE = 16
FROM = 0  # number of the stage that it comes from
KIND = 1
KERNEL_Y = 2
KERNEL_X = 3
STRIDE_Y = 4
STRIDE_X = 5
PADDING_Y = 6
PADDING_X = 7
DILATION_Y = 8
DILATION_X = 9
GROUPS = 10
WEIGHTS = 11  # where its weights begin; of a pooling: in the params

# kinds of links
CONVOLUTION = 0  # weights [channel][ky][kx][WIDTH, or the filters of the channel's group]
DENSE = 1  # weights [input][WIDTH]
POOLING = 2  # the sum of each window times one weight
SCALED = 3  # each number times a weight of its own
COPIED = 4  # each number as it is

# kinds of neurons
NONE = 0  # the sums go on as they are
INTEGRATE = 1
LEAKY = 2

# ways of reset
SUBTRACT = 0
TO_VALUE = 1

# the parameters of neurons, in rows of PARAMS_SIZE
GAIN = 0
THRESHOLD = 1
RESET_TO = 2
LEAK = 3  # the membrane at rest
RATE = 4  # 1 / time constant, in 1 / microseconds
N_PARAMS = 5

MOST_SPIKES = float(1 << 31)
"""From this many spikes of a neuron at once, its membrane is 0 afterwards."""
