"""What tests of Processor share: classifiers, streams at given times, decisions as values."""

import numpy as np
from oracles import as_values

from async_tnt import Output, TNTConfig

CONFIG = TNTConfig(window_us=1000, landmark="running", t_max=2.0)


def total_and_size(volume):
    """A classifier that shows what it saw."""
    return [float(volume.sum()), float(np.abs(volume).sum())]


def uneven(volume):
    """A classifier whose probabilities go up and down with what it sees."""
    total = float(volume.sum())
    size = float(np.abs(volume).sum())
    return np.array([total, 0.5 * size - 1.5, np.sin(size)], np.float32)


def key(answer):
    """All that a Decision or an Output says, as values that can be compared.

    Of an Output the boxes are left out, as they depend on what was read before.
    """
    if isinstance(answer, Output):
        where = (answer.window_start_us, answer.time_us, answer.events, answer.complete)
        arrays = [array.tobytes() for array in answer.arrays]
        return (*where, answer.trigger, answer.names, *arrays)
    return (*as_values(answer), answer.label, answer.probabilities.tobytes())


def at(times):
    """Events at these times, anywhere."""
    n = len(times)
    return (
        times,
        [3 + k % 5 for k in range(n)],
        [4 + k % 3 for k in range(n)],
        [k % 2 for k in range(n)],
    )


def summary(decisions):
    """Why, about which window, when, and with how many events each decision was made."""
    return [(d.trigger, d.window_start_us, d.time_us, d.events) for d in decisions]
