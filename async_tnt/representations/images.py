"""Event images: how many events each pixel produced, and when it produced the last one.

An image discards most of the timing that an event volume keeps. It serves as the baseline for the volume, and it is
enough for many networks.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt.checks import checked_time
from async_tnt.config import TNTConfig
from async_tnt.events import EventDecoder
from async_tnt.kernels.pixels import add_counts, add_counts_and_times


def count_image(events: Any, *, sensor: tuple[int, int], out: np.ndarray | None = None) -> np.ndarray:
    """How many events each pixel produced, by polarity.

        I[c, y, x] = #{i : x_i = x, y_i = y, p_i = 1 - c}        c = 0: ON, c = 1: OFF

    Parameters
    ----------
    events : in any form that `async_tnt.event_forms` lists. Their times and their order do not matter.
    sensor : (width, height) in pixels.
    out : an earlier result, to which the events are added: an image of a stream, in O(1) per event.

    Returns
    -------
    int32, shape (2, H, W), indexed [polarity, y, x]; `out` itself if given. Its sum is the number of events.

    Raises
    ------
    ValueError, TypeError : invalid events, or `out` is not such an image. `out` is then unchanged.

    References
    ----------
    Maqueda, Loquercio, Gallego, Garcia, Scaramuzza 2018, arXiv:1804.01310: histograms of positive and of negative
    events, two channels.

    Examples
    --------
    >>> events = ([10, 20, 30], [0, 2, 2], [1, 0, 0], [1, 0, 0])  # t, x, y, p
    >>> image = count_image(events, sensor=(3, 2))
    >>> image.tolist()
    [[[0, 0, 0], [1, 0, 0]], [[0, 0, 2], [0, 0, 0]]]
    >>> count_image(([40], [1], [1], [1]), sensor=(3, 2), out=image)[0].tolist()
    [[0, 0, 0], [1, 1, 0]]
    """
    sensor = TNTConfig(sensor=sensor).sensor  # checked
    _, x, y, p, n = EventDecoder(sensor).decode(events)
    image = _room_for(2, sensor, np.int32, out)
    add_counts(x, y, p, n, image)
    return image


def count_timestamp_image(
    events: Any, *, start_us: int, window_us: int, sensor: tuple[int, int], out: np.ndarray | None = None
) -> np.ndarray:
    """How many events each pixel produced in a window, and when it produced the last one, by polarity: four channels.

        I[c, y, x]     = #{i : x_i = x, y_i = y, p_i = 1 - c}          c = 0: ON, c = 1: OFF
        I[2 + c, y, x] = max {f_i : x_i = x, y_i = y, p_i = 1 - c}     f_i = (t_i - start_us) / window_us

    Only events in [start_us, start_us + window_us) count. "Last" means newest, not last to arrive, so the order of
    events does not matter. A pixel without events has time 0, and so has one whose only events are at the very start
    of the window; the counts tell the two apart.

    Parameters
    ----------
    events : in any form that `async_tnt.event_forms` lists.
    start_us, window_us : the window, in microseconds. EV-FlowNet divides by the newest event's time, which makes
        it 1; here windows are half-open, so f < 1. The closest is `start_us=t[0], window_us=t[-1] - t[0] + 1`.
    sensor : (width, height) in pixels.
    out : an earlier result of the same window, to which the events are added, in O(1) per event. The result has the
        same bits however the stream is cut into packets.

    Returns
    -------
    float32, shape (4, H, W), indexed [channel, y, x]: count ON, count OFF, time ON, time OFF; `out` itself if given.
    Counts are exact up to 2**24. Times are divided in float64 and rounded once.

    Raises
    ------
    ValueError, TypeError : invalid events, or `out` is not such an image. `out` is then unchanged.

    References
    ----------
    Zhu, Yuan, Chaney, Daniilidis 2018, arXiv:1802.06898 (EV-FlowNet), the network's input.

    Examples
    --------
    >>> events = ([10, 20, 30], [0, 2, 2], [1, 0, 0], [1, 0, 0])  # t, x, y, p
    >>> image = count_timestamp_image(events, start_us=10, window_us=40, sensor=(3, 2))
    >>> image[:2].tolist()
    [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [[0.0, 0.0, 2.0], [0.0, 0.0, 0.0]]]
    >>> image[2:].tolist()  # ON at the window's start, OFF at half of it
    [[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], [[0.0, 0.0, 0.5], [0.0, 0.0, 0.0]]]
    """
    config = TNTConfig(sensor=sensor, window_us=window_us)  # checks both
    start_us = checked_time("start_us", start_us)
    t, x, y, p, n = EventDecoder(config.sensor).decode(events)
    image = _room_for(4, config.sensor, np.float32, out)
    add_counts_and_times(t, x, y, p, n, start_us, config.window_us, image)
    return image


def _room_for(n_channels: int, sensor: tuple[int, int], dtype: type, out: np.ndarray | None) -> np.ndarray:
    shape = n_channels, sensor[1], sensor[0]
    if out is None:
        return np.zeros(shape, dtype)
    if not isinstance(out, np.ndarray):
        raise TypeError(f"`out` must be an array that an earlier call returned, got {type(out).__name__}")
    if out.shape != shape or out.dtype != dtype:
        raise ValueError(f"`out` must be {np.dtype(dtype)} of shape {shape}, got {out.dtype} of shape {out.shape}")
    if not (out.flags.c_contiguous and out.flags.aligned and out.flags.writeable):
        raise ValueError("`out` must be contiguous, aligned and writeable; pass what an earlier call returned")
    return out
