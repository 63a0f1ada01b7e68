"""Where a volume's numbers lie in its one flat buffer.

A call from Python into compiled code costs about 45 ns for every array it hands over, more than the
arithmetic of one event. So everything an event reads or writes lives in one float64 buffer; whole numbers
live in the same memory seen as int64.

    buffer = [ floats and their scratch | integers, one event's columns and their scratch | cells ]

Cells, shape (intervals, H + 1, W + 1, 2): between bins b and b + 1 an event gives a share to either, and
the two shares lie side by side, cells[b, y, x] = (to bin b, to bin b + 1). Time passes one interval after the
other, so an interval's cells stay in the first-level cache while its events arrive. One row and one column
more than the grid spare every event a test at the border: its share out there is zero. They are float64,
because a volume is promised to 1e-6 of its largest cell even after thousands of opposite events cancelled in
it, which float32 sums would lose; `read.copy_cells` rounds to float32 once, when somebody looks.
"""

# floats: parameters of the volume
WINDOW_US = 0  # length of the window
BIN_SCALE = 1  # (B - 1) / window_us
SCALE_X = 2  # sensor pixels * microseconds -> grid pixels of the transform, see `landmark`
SCALE_Y = 3
CENTER_X = 4  # what the transform adds: the grid's centre (0 without the transform)
CENTER_Y = 5
MAX_U = 6  # W - 1
MAX_V = 7  # H - 1
SIGN_OFF = 8  # what an OFF and an ON event add to the volume
SIGN_ON = 9
# floats: the landmark
FIXED_X = 10  # a landmark given from outside, in sensor pixels
FIXED_Y = 11
C_XF = 12  # centred sums of the running line
C_YF = 13
C_FF = 14

# integers: parameters
MODE = 0  # one of the MODE_ numbers
SENSOR_W = 1
SENSOR_H = 2
ROW = 3  # numbers in a row of cells: 2 (W + 1)
PLANE = 4  # numbers in an interval: 2 (H + 1) (W + 1)
OFF_SHIFT = 5  # numbers between an ON cell and its OFF twin ("split"), else 0
# integers: the open window
START_US = 6
LIMIT_US = 7  # absorb no event at or after this time
N = 8  # events in the window so far
SUM_X = 9  # sensor pixels
SUM_Y = 10
SUM_T = 11  # microseconds since the window's start
NEWEST_US = 12  # newest event of the window
# integers: counted since the volume was made
RECEIVED = 13
KEPT = 14
LATE = 15
TAU_ZERO = 16
# integers: which cells changed since the last read
BIN_LO = 17
BIN_HI = 18  # last changed interval; below BIN_LO: nothing changed
ROW_LO = 19
ROW_HI = 20

# scratch: intermediate numbers of a block of events, in rows of BLOCK
BLOCK = 256  # so that all rows together fit the first-level cache
NUM_X = 16  # floats: displacement from the landmark
NUM_Y = NUM_X + BLOCK
DEN = NUM_Y + BLOCK
Y_FRAC = DEN + BLOCK  # place in the volume
X_FRAC = Y_FRAC + BLOCK
EARLY = X_FRAC + BLOCK
LATER = EARLY + BLOCK
N_FLOATS = LATER + BLOCK
ONE = 24  # integers: one event's t, x, y, p
PREFIX_X = 32  # S_x, S_y at each event
PREFIX_Y = PREFIX_X + BLOCK
CORNER = PREFIX_Y + BLOCK
N_INTS = CORNER + BLOCK
CELLS = N_FLOATS + N_INTS

# how an event's coordinates are made (MODE)
MODE_RAW = 0  # no transform
MODE_FIXED = 1  # a landmark given from outside: centre, window mean, regressor
MODE_RUNNING = 2
MODE_LINE = 3
MODE_LINE_FLOW_REMOVED = 4

FAR = 1 << 30  # beyond any bin or row: nothing changed yet
