"""Event Stream bytes to columns of events; the format is described in `sources.files.es`."""

import numpy as np
from numba import types

from .jit import compiled
from .records import COLUMN_TYPES, RAW_TYPE

DVS, ATIS = 1, 2
ES_TYPES = (RAW_TYPE, types.int64, types.int64, types.int64, types.int64, *COLUMN_TYPES)


@compiled
def decode_es(data, time, kind, width, height, t, x, y, p):
    """Columns of whole events from the bytes of an Event Stream file.

    Parameters
    ----------
    data : uint8. A part of the file that begins with an event.
    time : int. Microseconds, of the event before.
    kind : DVS or ATIS.
    width, height : the sensor.
    t, x, y, p : columns. Written from place 0 on.

    Returns
    -------
    (events written, bytes read, time after them, whether the next event is off the sensor)
    """
    n = 0
    i = 0
    while i < data.size and n < t.size:
        byte = np.int64(data[i])
        if kind == DVS and byte >= 254:
            if byte == 255:
                time += 127
            i += 1
            continue
        if kind == ATIS and byte >= 252:
            time += 63 * (byte & 3)
            i += 1
            continue
        if i + 5 > data.size:
            break
        column = np.int64(data[i + 1]) | np.int64(data[i + 2]) << 8
        row = np.int64(data[i + 3]) | np.int64(data[i + 4]) << 8
        if column >= width or row >= height:
            return n, i, time, True
        time += byte >> 1 if kind == DVS else byte >> 2
        if kind == DVS or byte & 1 == 0:
            t[n], x[n], y[n] = time, column, height - 1 - row
            p[n] = byte & 1 if kind == DVS else byte >> 1 & 1
            n += 1
        i += 5
    return n, i, time, False
