"""The raw outputs of a network, brought up to date with a volume, and where they have changed."""

import numpy as np
from numba import int64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.changes import FIRST_ROW, LAST_ROW, WORDS
from async_tnt.kernels.network.empty_window import begin_window
from async_tnt.kernels.network.forward import forward
from async_tnt.kernels.network.sync_input import sync_input
from async_tnt.kernels.simd import trailing_zeros
from async_tnt.kernels.volume import state as S

# `boxes`, int64: a row for each output, the box of the places that have changed. x0 = x1 where
# nothing has.
X0 = 0
Y0 = 1
X1 = 2  # behind the last column
Y1 = 3  # behind the last row
BOX_SIZE = 4  # numbers in a row

# `sources`, int64: a row for each step that writes an output
OUTPUT = 0  # number of the output
RECORD = 1  # where in the program the record of the step's changes begins
SOURCE_SIZE = 2  # numbers in a row


@entry_point(
    S.STATE, *P.NETWORK, int64[:, ::1], int64[:, ::1], calls=(sync_input, forward), nogil=True
)
def refresh_outputs(buffer, program, weights, maps, places, sources, boxes):
    """Bring the outputs up to date. Only what has changed since the last call is computed.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Only read.
    program, weights, maps, places : the network's, see `program`. Updated in place.
    sources : int64, see above.
    boxes : int64, see above. Overwritten: where the outputs may differ from those of the last call.
    """
    boxes[:] = 0
    bits = places.view(np.uint64)
    epoch = buffer.view(np.int64)[S.EPOCH]
    if program[P.EPOCH] != epoch:
        begin_window(epoch, program, weights, maps, places)
        _add_changes(program, bits, sources, boxes)
    sync_input(buffer, program, maps, places)
    forward(program, weights, maps, places)
    _add_changes(program, bits, sources, boxes)


@compiled
def _add_changes(program, bits, sources, boxes):
    """Widen the boxes by the places that the last computation has changed."""
    for source in sources:
        record = source[RECORD]
        words = program[record + WORDS]
        for y in range(program[record + FIRST_ROW], program[record + LAST_ROW] + 1):
            for word in range(words):
                changed = bits[np.uint64(program[record] + y * words + word)]
                if changed != 0:
                    _widen(boxes[source[OUTPUT]], y, 64 * word, changed)


@compiled
def _widen(box, y, first_column, changed):
    """Widen a box by places of row y: column `first_column` + k for each bit k of `changed`."""
    x0 = first_column + trailing_zeros(changed)
    last = np.int64(63)
    while changed >> np.uint64(last) == 0:
        last -= 1
    x1 = first_column + last + 1
    if box[X0] == box[X1]:
        box[X0] = x0
        box[Y0] = y
        box[X1] = x1
        box[Y1] = y + 1
        return
    box[X0] = min(box[X0], x0)
    box[Y0] = min(box[Y0], y)
    box[X1] = max(box[X1], x1)
    box[Y1] = max(box[Y1], y + 1)
