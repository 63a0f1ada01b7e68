"""Slices: the bins of a window of the last microseconds.

The window's length T is divided into B slices of T / B, counted from the stream's start t_0. With
s(t) = floor((t - t_0) B / T), an event at t is in bin

    b = s(t) - (s(now) - B + 1)

So the last bin holds the events of the slice that has begun, and the others those of complete
slices. When a slice begins, all events go to the bin before theirs, and those of the first bin
leave. No number is moved for that: a slice keeps its plane of cells until it leaves, and PHASE says
which plane is the first bin.
"""

import numpy as np

from async_tnt.kernels.jit import inlined
from async_tnt.kernels.volume import state as S


@inlined
def n_slices(ints):
    """How many slices the window has."""
    return ints[S.SPAN_US] // ints[S.SLICE_US]


@inlined
def begin_slices(ints):
    """Begin with the first slice, if the window has slices."""
    ints[S.SLICE] = 0
    ints[S.PHASE] = 0
    if ints[S.SLICE_US] != 0:
        ints[S.PHASE] = 1 % n_slices(ints)


@inlined
def slice_of(ints, t):
    """The number of the slice of a time that is not before the window's start."""
    return (t - ints[S.START_US]) // ints[S.SLICE_US]


@inlined
def plane_of(ints, number):
    """Where the plane of a slice begins, behind the first plane of its polarity."""
    return number % n_slices(ints) * ints[S.PLANE]


@inlined
def begin_slice_of(ints, t):
    """Begin the slice of a time, if the window has slices and this one is later than the newest.

    All bins are others then. The log grows by its own length, so that whoever follows it reads all
    cells.
    """
    if ints[S.SLICE_US] == 0 or t < ints[S.START_US]:
        return
    number = slice_of(ints, t)
    if number > ints[S.SLICE]:
        ints[S.SLICE] = number
        ints[S.PHASE] = (number + 1) % n_slices(ints)
        ints[S.N_LOG] += ints[S.LOG_SIZE]


@inlined
def newest_slice(ints):
    """What is known of the newest slice.

    Returns
    -------
    plane : int. Where its plane begins, behind the first plane of its polarity.
    begin_us : int. When it begins.
    left_us : int. Events up to this time have left the window.

    In a window without slices: 0, 0 and -1.
    """
    if ints[S.SLICE_US] == 0:
        return np.int64(0), np.int64(0), np.int64(-1)
    number = ints[S.SLICE]
    begin_us = ints[S.START_US] + number * ints[S.SLICE_US]
    left_us = begin_us - (n_slices(ints) - 1) * ints[S.SLICE_US] - 1
    return plane_of(ints, number), begin_us, left_us
