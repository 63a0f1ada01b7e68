"""Where the transform puts each event: u, v, whether it is kept, and the landmark it was centred on.

The volume itself never stores them. The streaming kernels leave the displacement of every event of a block in
their scratch memory (`kernels.state`: NUM_X, NUM_Y, DEN), and here it is read from there:

    u = num_x / den * scale_x + c_x         as in `kernels.splat.place_event`
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.events import EventDecoder
from async_tnt.kernels import state as S
from async_tnt.kernels.absorb import absorb
from async_tnt.kernels.readout import empty_volume
from async_tnt.kernels.splat import BORDER_TOLERANCE
from async_tnt.volume_state import new_state, next_epoch


class Coordinates(NamedTuple):
    """Of N events of a window, in order of arrival."""

    u: np.ndarray
    """float64, shape (N,): column in the transformed grid; inf or nan at the window's very start, where tau is 0."""
    v: np.ndarray
    """float64, shape (N,): row."""
    kept: np.ndarray
    """bool, shape (N,): on the grid, and so in the volume."""
    landmark: np.ndarray
    """float64, shape (N, 2): the point (x, y) each event was centred on, in grid pixels. With `remove_flow`, the
    place of the fitted line at the event's time."""


def transformed(
    events: np.ndarray, config: TNTConfig, start_us: int, landmark: tuple[float, float] | None = None
) -> Coordinates:
    """The transform of one window's events.

    Parameters
    ----------
    events : structured array of `EVENT_DTYPE`, all in `[start_us, start_us + window_us)`.
    config : TNTConfig. With transform "none", (u, v) is the pixel in the grid.
    start_us : the window's start.
    landmark : (x, y) in grid pixels to centre all events on, instead of `config.landmark`. Landmarks that are known
        only when the volume is read (`window`, `regressor`) must be given: `TNTVolume.landmark` has them.

    Raises
    ------
    ValueError : an event outside the window or off the sensor; a landmark that must be given is missing.

    Examples
    --------
    >>> events = np.array([(13_125, 18, 17, 1)], [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")])
    >>> u, v, kept, landmark = transformed(events, TNTConfig(landmark="center", t_max=4.0), 0)
    >>> u, v, kept, landmark  # TNT time 1/2: distances from the centre are doubled
    (array([19.5]), array([17.5]), array([ True]), array([[16.5, 16.5]]))
    """
    # the fewest cells: the events' places do not depend on them
    config = config.replace(representation="volume", bins=1, transform=config.transform, polarity=config.polarity)
    if landmark is None and config.defers_landmark:
        raise ValueError(f"`landmark` must be given for {config.landmark!r}: it is known when the volume is read")
    if landmark is not None:
        config = config.replace(transform="tnt", landmark="center", remove_flow=False)
    t = events["t"]
    if events.size and not (start_us <= t.min() and t.max() < start_us + config.window_us):
        raise ValueError(
            f"`events` must lie in the window [{start_us}, {start_us + config.window_us}) us, "
            f"got {t.min()} to {t.max()}"
        )
    columns = EventDecoder(config.sensor).decode(events)
    buffer = new_state(config)
    empty_volume(buffer, np.zeros(config.shape, np.float32), start_us, start_us + config.window_us, next_epoch())
    if landmark is not None:
        buffer[S.FIXED_X], buffer[S.FIXED_Y] = config.to_sensor(*landmark)

    n = columns.n
    numerator, denominator = np.empty((2, n)), np.empty(n)
    for first in range(0, n, S.BLOCK):  # a block in the window is worked through as a whole: see `kernels.absorb`
        m = min(S.BLOCK, n - first)
        absorb(buffer, *columns[:4], first, first + m)
        for row, scratch in ((numerator[0], S.NUM_X), (numerator[1], S.NUM_Y), (denominator, S.DEN)):
            row[first : first + m] = buffer[scratch : scratch + m]

    with np.errstate(divide="ignore", invalid="ignore"):
        u = numerator[0] * (1.0 / denominator) * buffer[S.SCALE_X] + buffer[S.CENTER_X]
        v = numerator[1] * (1.0 / denominator) * buffer[S.SCALE_Y] + buffer[S.CENTER_Y]
    kept = _on_grid(u, config.grid[0] - 1) & _on_grid(v, config.grid[1] - 1)

    # the running centroid's numerators are n times the displacement, see `kernels.landmark`
    count = np.arange(1, n + 1) if buffer.view(np.int64)[S.MODE] == S.MODE_RUNNING else 1
    centred_on = np.empty((n, 2))
    if config.transform == "none":
        centred_on[:] = np.subtract(config.grid, 1) / 2
    else:
        pixels = np.stack([columns.x[:n], columns.y[:n]]).astype(np.float64)  # (2, N)
        centred_on[:, 0], centred_on[:, 1] = config.to_grid(*(pixels - numerator / count))
    return Coordinates(u, v, kept, centred_on)


def _on_grid(values: np.ndarray, upper: int) -> np.ndarray:
    """As `kernels.splat.on_grid`: False for nan and inf."""
    return (values >= -BORDER_TOLERANCE) & (values <= upper + BORDER_TOLERANCE)
