"""Checked torch columns of the events of one window, made from columns of any kind."""

from __future__ import annotations

import math
import operator
from typing import Any, NamedTuple

import torch

Column = Any
"""A torch tensor, or anything torch.as_tensor takes: a numpy array, a list, ..."""

POLARITIES = ("signed", "unsigned", "split")


class WindowEvents(NamedTuple):
    """All N given events in their order, and which of them belong to the window."""

    dt: torch.Tensor
    """(N,) float64: microseconds since the window's start, from an exact difference."""
    pixels: torch.Tensor
    """(N, 2): sensor pixels (x, y), int64, or float64 if they came as floats."""
    inside: torch.Tensor
    """(N,) bool: start_us <= t <= start_us + window_us."""


def window_events(
    t: Column, x: Column, y: Column, *, start_us: int, window_us: int, sensor: tuple[int, int]
) -> WindowEvents:
    """The events of a window: the columns are checked, and the window's start is subtracted.

    Integer times are subtracted as int64 *before* any float appears: float32 loses microseconds
    after 16.8 s. The window is closed at its right end, so that the thesis' own form, with
    start_us = t_1 and window_us = t_N - t_1, keeps its last event. Float64 columns are used as they
    are, so that gradients pass.
    """
    start = whole_number("start_us", start_us)
    length = whole_number("window_us", window_us)
    if length <= 0:
        raise ValueError(
            f"`window_us` must be positive, got {length}; for events at a single instant, pass at "
            "least 1"
        )
    times = as_column("t", t)
    xs = as_column("x", x)
    ys = as_column("y", y)
    check_same_length(t=times, x=xs, y=ys)
    if times.is_floating_point() and times.dtype != torch.float64 and len(times):
        raise TypeError(
            f"`t` must hold integers or float64, got {times.dtype}, which loses microseconds: "
            "pass the integer microseconds"
        )
    check_range("t", times, low=-math.inf, high=math.inf)
    width, height = check_size("sensor", sensor)
    check_range("x", xs, low=0, high=width - 1)
    check_range("y", ys, low=0, high=height - 1)

    times = times.double() if times.is_floating_point() else times.long()
    dt = times - start  # (N,), exact for integers
    inside = (dt >= 0) & (dt <= length)  # (N,)
    if xs.is_floating_point() or ys.is_floating_point():
        xs = xs.double()
        ys = ys.double()
    return WindowEvents(dt.double(), torch.stack([xs, ys], dim=1), inside)


def whole_pixels(events: WindowEvents) -> torch.Tensor:
    """The events' pixels, (N, 2) int64, for functions that count events per pixel.

    Columns of floats are refused.
    """
    if len(events.dt) and events.pixels.is_floating_point():
        raise TypeError(
            "`x` and `y` must be whole pixels: events are counted per pixel, and not splatted"
        )
    return events.pixels.long()


def windows_of_events(t: Column, n: int, window_us: int | None = None) -> list[torch.Tensor]:
    """The windows of n events that a stream is divided into.

    Events are taken in order of arrival. A window begins with an event. It ends with its n-th
    event, or before an event that is `window_us` or more later than the window's first event. An
    event older than the first event of its window belongs to no window.

    Parameters
    ----------
    t : (N,) integer microseconds.
    n : number of events in a window, at least 1.
    window_us : the longest duration of a window; None: any duration.

    Returns
    -------
    list of int64 tensors: the indices of each window's events. Only the last window may be
    unfinished.

    Example
    -------
    >>> [events.tolist() for events in windows_of_events([5, 6, 4, 7, 30, 31], n=3, window_us=20)]
    [[0, 1, 3], [4, 5]]
    """
    if whole_number("n", n) < 1:
        raise ValueError(f"`n` must be at least 1, got {n}")
    times = as_column("t", t).tolist()
    windows: list[list[int]] = []
    for i, time in enumerate(times):
        if not windows or len(windows[-1]) == n:
            windows.append([i])
            continue
        first_time = times[windows[-1][0]]
        if window_us is not None and time >= first_time + window_us:
            windows.append([i])
        elif time >= first_time:
            windows[-1].append(i)
    return [torch.as_tensor(events) for events in windows]


def until_newest(t: Column, start_us: int) -> int:
    """The length of a window from `start_us` to its newest event: max(t) - start_us, at least 1.

    Example
    -------
    >>> until_newest([5, 9, 7], start_us=5), until_newest([5], start_us=5)
    (4, 1)
    """
    times = as_column("t", t)
    return max(1, int(times.max()) - start_us) if len(times) else 1


def signs(p: Column, n_events: int) -> torch.Tensor:
    """Polarity as float64 -1 or +1, shape (N,), from bool, 0/1 or -1/+1 of any type."""
    polarity = as_column("p", p)
    if len(polarity) != n_events:
        raise ValueError(f"`p` must be as long as `t`: got {len(polarity)} and {n_events}")
    values = polarity.double()  # before any arithmetic: uint8 times -1 would wrap
    is_wrong = (values != 0) & (values.abs() != 1)
    if is_wrong.any():
        i = int(is_wrong.nonzero()[0])
        raise ValueError(f"`p` must be bool, 0/1 or -1/+1, got {polarity[i].item()} at event {i}")
    return torch.where(values > 0, 1.0, -1.0).double()


def as_column(name: str, values: Column) -> torch.Tensor:
    """One column as a 1-D tensor: int64, or the floating-point type that the column has."""
    if isinstance(values, torch.Tensor):
        column = values
    elif hasattr(values, "__array__"):
        # A contiguous copy: torch warns about read-only arrays and refuses fields of structured
        # arrays.
        column = torch.as_tensor(values.copy())
    else:
        column = torch.as_tensor(values)
        # Python floats are doubles; torch would make float32 of them
        if column.is_floating_point():
            column = torch.as_tensor(values, dtype=torch.float64)
    if column.ndim != 1:
        raise ValueError(f"`{name}` must be one-dimensional, got shape {tuple(column.shape)}")
    if column.is_complex():
        raise TypeError(f"`{name}` must hold real numbers, got {column.dtype}")
    return column if column.is_floating_point() else column.long()


def check_same_length(**columns: torch.Tensor) -> None:
    """Raise a ValueError if the columns, by their names, differ in length."""
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"event columns must have one length, got {lengths}")


def check_range(name: str, column: torch.Tensor, low: float, high: float) -> None:
    """Raise a ValueError if a number is not finite and in [low, high]."""
    is_valid = (column >= low) & (column <= high) & column.isfinite()
    if not is_valid.all():
        i = int((~is_valid).nonzero()[0])
        rule = "finite" if high == math.inf else f"in [{low}, {high}], inside the sensor"
        raise ValueError(f"`{name}` must be {rule}, got {column[i].item()} at event {i}")


def check_size(name: str, size: tuple[int, int], smallest: int = 1) -> tuple[int, int]:
    """The size (width, height) as two ints, each at least `smallest`."""
    try:
        width, height = map(operator.index, size)
    except (TypeError, ValueError):
        raise TypeError(
            f"`{name}` must be (width, height), two whole numbers, got {size!r}"
        ) from None
    if min(width, height) < smallest:
        raise ValueError(
            f"`{name}` must have sides of at least {smallest} pixels, got {(width, height)}"
        )
    return width, height


def check_polarity(polarity: str) -> None:
    """Raise a ValueError if `polarity` is not one of `POLARITIES`."""
    if polarity not in POLARITIES:
        raise ValueError(f"`polarity` must be one of {', '.join(POLARITIES)}, got {polarity!r}")


def whole_number(name: str, value: int) -> int:
    """The value as an int. A value that is not a whole number raises a TypeError."""
    try:
        return operator.index(value)
    except TypeError:
        raise TypeError(f"`{name}` must be a whole number, got {value!r}") from None
