"""Store a window's events for a replay, for landmarks that are known only at the moment of reading."""

import numpy as np

from . import state as S
from .absorb import count_late
from .jit import compiled


@compiled
def store_events(buffer, t, x, y, p, first, last, stored_t, stored_x, stored_y, stored_p, n_stored):
    """What `absorb` does for a landmark known only at the read: count and sum, and store the events.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Updated in place, its cells excepted.
    t, x, y, p, first, last : as for `absorb`.
    stored_t, stored_x, stored_y, stored_p : columns. Updated in place from `n_stored` on; what exceeds them
        is counted in the sums and not stored.

    Returns
    -------
    first : int. The first event not taken (at or after LIMIT_US).
    n_stored : int. Events stored now.
    """
    ints = buffer.view(np.int64)
    while first < last and t[first] < ints[S.LIMIT_US]:
        ints[S.RECEIVED] += 1
        if t[first] < ints[S.START_US]:
            count_late(ints, t[first])
        else:
            ints[S.N] += 1
            ints[S.SUM_X] += x[first]
            ints[S.SUM_Y] += y[first]
            ints[S.NEWEST_US] = max(ints[S.NEWEST_US], t[first])
            if n_stored < stored_t.size:
                stored_t[n_stored] = t[first]
                stored_x[n_stored] = x[first]
                stored_y[n_stored] = y[first]
                stored_p[n_stored] = p[first]
                n_stored += 1
        first += 1
    return first, n_stored
