"""Where a volume's numbers lie in its one flat buffer.

Each array argument adds about 45 ns to a call from Python into compiled code, more than the
arithmetic of one event takes. So all numbers that an event reads or writes share one float64
buffer, which kernels access in two ways: as `buffer`, and as `ints`, a view of the same memory as
int64. Each slot below belongs to one of them.

    buffer = [ parameters, sums, counts | scratch of a block | cells | log | ring of events ]

Cells lie as the volume does, [bin, y, x], with `split` polarity the OFF bins behind the ON bins. An
event between the bins b and b + 1, in interval b, adds to 2 x 2 cells of each. Time passes one
interval after the other, so an interval's cells stay in the first-level cache while its events
arrive. One row, one column and one bin more than the volume has spare every event a test at the
border: the weight of the event there is zero. An ON event at the end of the last bin also has the
weight zero in the first OFF bin. For an image of times, the second numbers of all pixels may lie
behind the bins that are read: see COMBINE. Cells are float64, because a volume is promised to 1e-6
of its largest number, even after thousands of opposite events cancelled in it. Float32 sums would
lose this accuracy.
`readout.cells_to_float32` rounds to float32 once, when the volume is read.

The log is a ring that holds the corners of the newest LOG_SIZE events of the window, so that
reading and emptying a large volume cost what changed in it and not its size. Beyond that length,
following the log would cost more than reading all cells. A reader of the cells keeps the number of
corners it has seen, and the EPOCH of the window it counted in. An EPOCH is unique within the
process.
"""

from numba import float64

STATE = float64[::1]
"""Numba's type of the buffer."""

# buffer: parameters of the volume
# the length of the window; with `window_events`, the time from its start to its newest event
WINDOW_US = 0
BIN_SCALE = 1  # (B - 1) / window_us; of an image: 0
SCALE_X = 2  # sensor pixels * microseconds -> grid pixels of the transform, see `landmark`
SCALE_Y = 3
CENTER_X = 4  # added by the transform: the grid's centre (0 without the transform)
CENTER_Y = 5
MAX_U = 6  # W - 1
MAX_V = 7  # H - 1
SIGN_OFF = 8  # what an OFF event adds to the volume
SIGN_ON = 9  # what an ON event adds to the volume
# buffer: the landmark
FIXED_X = 10  # a given landmark, in sensor pixels
FIXED_Y = 11
C_XF = 12  # centred sums of the running line
C_YF = 13
C_FF = 14
# ints: parameters
MODE = 16  # one of the MODE_ numbers
SENSOR_W = 17
SENSOR_H = 18
ROW = 19  # cells in a row: W + 1
PLANE = 20  # cells of a bin: (H + 1) (W + 1)
OFF_SHIFT = 21  # distance from an ON cell to its OFF cell ("split"), else 0
LOG = 22  # where the log begins
LOG_SIZE = 23  # a power of two, at least BLOCK
# ints: the open window
START_US = 24
LIMIT_US = 25  # absorb no event at or after this time
N = 26  # events in the window so far
SUM_X = 27  # sensor pixels
SUM_Y = 28
SUM_T = 29  # microseconds since the window's start
NEWEST_US = 30  # newest event of the window
# ints: numbers of events since the volume was made
RECEIVED = 31  # events that came
KEPT = 32  # events added to the volume
LATE = 33  # events before the open window, without those of DECIDED
TAU_ZERO = 34  # events at the start of their window, where tau is 0
# ints: what changed
EPOCH = 35  # the number of the open window
N_LOG = 36  # corners logged since the window opened
N_READ = 37  # how many of these corners the array that users see already shows
# the intervals that changed since the array was read; none if INTERVAL_HI < INTERVAL_LO
INTERVAL_LO = 38
INTERVAL_HI = 39
# ints: windows that were closed before their end
# all windows from this time up to the open window were closed early; NEVER_US: there is none
DECIDED_FROM_US = 40
DECIDED = 41  # late events at or after that time, dropped since the volume was made
# ints: more parameters
COMBINE = 42  # one of the COMBINE_ numbers
SECOND = 43  # distance from the first of an event's two bins to the second one
WITHOUT_GIL = 44  # not 0 while a kernel that has released Python's lock calls others, see `lock`

# ints: counted up to the open window's start; a replay of the window counts on from here
CLOSED_KEPT = 45
CLOSED_TAU_ZERO = 46

# ints: windows that slide, see `sliding`
RING = 47  # where the ring of events begins: time and 2 * cell + polarity of each; 0: no ring
RING_SIZE = 48  # the most events of the ring
RING_FIRST = 49  # place of the oldest event
RING_N = 50  # events in the ring
SPAN_US = 51  # the length of a window of a time; 0: a window of a number of events
LEFT_EARLY = 52  # events that left because the ring was full, since the volume was made or reset
SLICE_US = 53  # the length of a slice; 0: the window has no slices
SLICE = 54  # number of the newest slice, from the window's start on
PHASE = 55  # the plane that holds the first bin: planes take turns, so that nothing is moved

# scratch: intermediate numbers of a block of events, in rows of BLOCK
# the events of a block: all rows together (24 kB) and an interval's cells fit in the first-level
# cache
BLOCK = 336
NUM_X = 56  # buffer: displacement from the landmark
NUM_Y = NUM_X + BLOCK
DEN = NUM_Y + BLOCK
Y_FRAC = DEN + BLOCK  # buffer: place in the volume
X_FRAC = Y_FRAC + BLOCK
LOWER = X_FRAC + BLOCK
DT = LOWER  # buffer: time since the window's start, until LOWER takes its place
UPPER = LOWER + BLOCK
PREFIX = UPPER + BLOCK  # ints: sums over the block up to each event
CORNER = PREFIX + BLOCK
CELLS = CORNER + BLOCK

# how an event's coordinates are made (MODE)
MODE_RAW = 0  # no transform
MODE_FIXED = 1  # a given landmark: the centre, the window's mean, a regressor's answer
MODE_RUNNING = 2  # the centroid of the events so far
MODE_LINE = 3  # the line fitted to the events so far, at the window's start
MODE_LINE_FLOW_REMOVED = 4  # the same line, at the time of the event

# what an event does to the cells of its two bins (COMBINE). An image has two numbers of each pixel:
# the first is its bin 0; the second is bin 1 of `count_time`, and of other images lies behind all
# bins that are read.
COMBINE_SUM = 0  # the volume, or an image of counts: add its two weights
COMBINE_NEWEST = 1  # (count, time of the newest event)
COMBINE_MEAN = 2  # (mean time, count)
COMBINE_SURFACE = 3  # (surface of the newest event, count)

NO_INTERVAL = 1 << 30  # beyond every interval
NEVER_US = 1 << 62  # beyond every time, in microseconds
UNREAD = -(1 << 40)  # N_READ of an array that must be read whole
# the cells of one logged event, scattered in memory, cost as much as this many cells in order
CELLS_PER_LOGGED = 100
