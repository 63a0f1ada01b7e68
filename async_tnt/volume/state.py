"""What a volume keeps: its flat buffer, which the kernels work on, and events that are replayed
when it is read.

Events are stored and replayed if one of these is known only when the volume is read:

landmark `window`      the centroid of all the window's events so far
landmark `regressor`   a network's estimate from the raw volume of the same events
`window_events`        the time of the window's newest event, by which times are scaled
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from async_tnt.base.checks import Running, one_at_a_time, short
from async_tnt.kernels.volume import state as S
from async_tnt.kernels.volume.absorb import absorb, store_events
from async_tnt.kernels.volume.readout import cells_to_float32, empty_volume
from async_tnt.volume.config import TNTConfig, second_bin
from async_tnt.volume.events import Columns, empty_columns

MAX_EVENTS = 1 << 53  # 28 years at 10 million events a second; sums stay far from the end of int64
Regressor = Callable[[np.ndarray], Any]
FIRST_CAPACITY = 4096
# events of a window without `window_events`: 870 MB; a clock that stands still would store on
MAX_STORED = 1 << 26
UNCHANGED_BY_REPLAY = S.LIMIT_US, S.RECEIVED, S.DECIDED_FROM_US
_epochs = itertools.count(1)


def next_epoch() -> int:
    """A number for a window's EPOCH, unique in this process."""
    return next(_epochs)


def new_state(config: TNTConfig) -> np.ndarray:
    """The buffer of a volume, its parameters set, no window open (see `kernels.state`)."""
    (sensor_w, sensor_h), (width, height) = config.sensor, config.grid
    plane = (width + 1) * (height + 1)
    n_cells = (config.channels + second_bin(config)) * plane
    log_size = 1 << (max(S.BLOCK, n_cells // S.CELLS_PER_LOGGED) - 1).bit_length()
    buffer = np.zeros(S.CELLS + n_cells + log_size)
    ints = buffer.view(np.int64)
    raw = config.transform == "none"
    set_duration(buffer, config, config.window_us)
    buffer[S.CENTER_X] = 0.0 if raw else (width - 1) / 2
    buffer[S.CENTER_Y] = 0.0 if raw else (height - 1) / 2
    buffer[S.MAX_U] = width - 1
    buffer[S.MAX_V] = height - 1
    buffer[S.SIGN_ON] = 1.0
    buffer[S.SIGN_OFF] = -1.0 if config.polarity == "signed" else 1.0
    buffer[S.FIXED_X] = (sensor_w - 1) / 2  # the grid's centre
    buffer[S.FIXED_Y] = (sensor_h - 1) / 2
    modes = {"running": S.MODE_RUNNING, "line": S.MODE_LINE}
    mode = (
        S.MODE_LINE_FLOW_REMOVED if config.remove_flow else modes.get(config.landmark, S.MODE_FIXED)
    )
    ints[S.MODE] = S.MODE_RAW if raw else mode
    combine = {
        "count_time": S.COMBINE_NEWEST,
        "mean_time": S.COMBINE_MEAN,
        "time_surface": S.COMBINE_SURFACE,
    }
    ints[S.COMBINE] = combine.get(config.representation, S.COMBINE_SUM)
    ints[S.SENSOR_W], ints[S.SENSOR_H] = sensor_w, sensor_h
    ints[S.ROW] = width + 1
    ints[S.SECOND] = plane * second_bin(config)
    ints[S.PLANE] = plane
    ints[S.OFF_SHIFT] = plane * config.bins if config.polarity == "split" else 0
    ints[S.LOG] = S.CELLS + n_cells
    ints[S.INTERVAL_LO], ints[S.INTERVAL_HI] = S.NO_INTERVAL, -1
    ints[S.LOG_SIZE] = log_size
    return buffer


def set_duration(buffer: np.ndarray, config: TNTConfig, window_us: int) -> None:
    """Set what the window's duration determines: the scales of time."""
    gain_x, gain_y = config.to_grid(1.0, 1.0)
    per_tau_us = 1.0 if config.transform == "none" else window_us / config.t_max
    buffer[S.WINDOW_US] = window_us
    scale = (config.bins - 1) / window_us if config.representation == "volume" else 0.0
    # rounded up: an event at the end would be beyond the last bin
    if window_us * scale > config.bins - 1:
        scale = math.nextafter(scale, 0.0)
    buffer[S.BIN_SCALE] = scale
    buffer[S.SCALE_X] = gain_x * per_tau_us
    buffer[S.SCALE_Y] = gain_y * per_tau_us


# -- events that are stored until the read ---------------------------------------------------------


class ReplayBuffer:
    """The events of one window, and their replay, about the landmark and with the duration that are
    known by then.

    Memory grows with the window.

    Parameters
    ----------
    config : of the volume that they are replayed into.
    regressor : the callable of landmark `regressor`; None: another landmark.
    """

    def __init__(self, config: TNTConfig, regressor: Regressor | None) -> None:
        self._n_most = config.window_events or MAX_EVENTS
        self._config = config
        self._regressor = regressor
        self._raw_config = config.replace(transform="none", landmark="center", remove_flow=False)
        self._raw = None if regressor is None else new_state(self._raw_config)
        self._columns = empty_columns(FIRST_CAPACITY)
        self._running = Running("Processor or TNTVolume")
        self.reset()

    @one_at_a_time
    def reset(self) -> None:
        """No events stored."""
        # as of the newest event, once it is known
        self._landmark: tuple[float, float] | None = None
        self._is_replayed = True

    @one_at_a_time
    def store(self, buffer: np.ndarray, columns: Columns, first: int, last: int) -> int:
        """Absorb events up to the volume's limit; returns the first one not absorbed."""
        n_before = _n_events(buffer)
        if n_before + last - first > self._columns.t.size:
            before_limit = columns.t[first:last] < buffer.view(np.int64)[S.LIMIT_US]
            self._grow(n_before, n_before + int(np.count_nonzero(before_limit)))
        # first, also if no event will be stored: an exception, such as Ctrl-C, may come right after
        # the kernel
        self._landmark = None
        self._is_replayed = False
        room = min(
            self._n_most, self._columns.t.size
        )  # another thread may have changed the times since they were counted
        return int(store_events(buffer, *columns[:4], first, last, *self._columns[:4], room))

    def landmark(self, buffer: np.ndarray) -> tuple[float, float]:
        """The landmark (x, y) in grid pixels of a window with events, where it is deferred;
        computed once, until new events arrive."""
        return self._landmark or self._find_landmark(buffer)

    @one_at_a_time
    def _find_landmark(self, buffer: np.ndarray) -> tuple[float, float]:
        self._landmark = self._estimate(buffer)
        return self._landmark

    def _estimate(self, buffer: np.ndarray) -> tuple[float, float]:
        if self._regressor is not None:
            return checked_landmark(self._regressor(self._raw_volume(buffer)))
        return self._config.to_grid(*_centroid(buffer))

    def _raw_volume(self, buffer: np.ndarray) -> np.ndarray:
        """The volume of the stored events without the transform, read-only."""
        raw, config, ints = self._raw, self._raw_config, buffer.view(np.int64)
        assert raw is not None
        array = np.zeros(config.shape, np.float32)
        if config.window_events is not None:
            set_duration(raw, config, _duration_us(buffer))
        empty_volume(raw, array, int(ints[S.START_US]), int(ints[S.LIMIT_US]), next_epoch())
        absorb(raw, *self._columns[:4], 0, _n_events(buffer))
        cells_to_float32(raw, array)
        array.flags.writeable = False
        return array

    def run(self, buffer: np.ndarray, array: np.ndarray) -> None:
        """Replay the stored events, if needed: the volume's cells and counts are then up to date.

        buffer, array : the volume's, see `kernels.readout.empty_volume`.
        """
        if not self._is_replayed and _n_events(buffer):  # a window may have had late events alone
            self._replay(buffer, array)

    @one_at_a_time
    def _replay(self, buffer: np.ndarray, array: np.ndarray) -> None:
        config, ints = self._config, buffer.view(np.int64)
        if config.defers_landmark:
            self._landmark = self._landmark or self._estimate(buffer)
            in_sensor = config.to_sensor(*self._landmark) if self._regressor else _centroid(buffer)
            buffer[S.FIXED_X], buffer[S.FIXED_Y] = in_sensor
        if config.window_events is not None:
            set_duration(buffer, config, _duration_us(buffer))
        n_events = _n_events(buffer)
        saved = ints[: S.NUM_X].copy()
        try:
            empty_volume(buffer, array, int(ints[S.START_US]), S.NEVER_US, next_epoch())
            for slot in (S.CLOSED_KEPT, S.CLOSED_TAU_ZERO):
                ints[slot] = saved[slot]
            ints[S.KEPT] = saved[S.CLOSED_KEPT]
            ints[S.TAU_ZERO] = saved[S.CLOSED_TAU_ZERO]
            absorb(buffer, *self._columns[:4], 0, n_events)
            for slot in UNCHANGED_BY_REPLAY:
                ints[slot] = saved[slot]
        except BaseException:  # such as Ctrl-C: the next read replays again
            ints[: S.NUM_X] = saved
            ints[S.N_LOG] = MAX_EVENTS  # more than the log holds: all cells are emptied then
            raise
        self._is_replayed = True

    def close(self, buffer: np.ndarray, array: np.ndarray) -> None:
        """Bring the window's counts up to date, before it is emptied."""
        self.run(buffer, array)
        self._landmark = None

    def _grow(self, n_stored: int, n: int) -> None:
        n = min(n, self._n_most)
        if n > MAX_STORED and self._config.window_events is None:
            raise ValueError(
                f"a window must have at most {MAX_STORED} events where they are stored (landmark "
                "`window` or "
                f"`regressor`), got {n}: shorten `window_us`"
            )
        if n > self._columns.t.size:
            larger = empty_columns(max(n, 2 * self._columns.t.size))
            for old, new in zip(self._columns[:4], larger[:4], strict=True):
                new[:n_stored] = old[:n_stored]
            self._columns = larger


def checked_landmark(answer: Any) -> tuple[float, float]:
    """A regressor's answer as two floats; a ValueError if it is something else, or not finite."""
    try:
        x, y = (float(value) for value in answer)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(
            f"`regressor` must return two numbers (x, y) in grid pixels, got {short(answer)}"
        ) from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"`regressor` must return a finite landmark, got {(x, y)}")
    return x, y


def check_regressor(config: TNTConfig, regressor: Any) -> None:
    """Raise unless there is a regressor if and only if the configuration needs one."""
    if not isinstance(config, TNTConfig):
        has_one = isinstance(getattr(config, "config", None), TNTConfig)
        hint = "pass its `config`" if has_one else "load_model(name).config is that of a model"
        raise TypeError(f"`config` must be a TNTConfig, got {short(config)}; {hint}")
    here = f"landmark={config.landmark!r}, transform={config.transform!r}"
    if regressor is None:
        if config.needs_regressor:
            raise ValueError(
                f"`regressor` is missing: {here} needs a callable from a raw volume to (x, y); "
                "a Model brings its own, CompiledRegressor(model)"
            )
    elif not callable(regressor):
        raise TypeError(f"`regressor` must be callable, got {type(regressor).__name__}")
    elif not config.needs_regressor:
        raise ValueError(f'`regressor` needs landmark="regressor" and transform="tnt", got {here}')


def _n_events(buffer: np.ndarray) -> int:
    return int(buffer.view(np.int64)[S.N])


def _centroid(buffer: np.ndarray) -> tuple[float, float]:
    """Of the window's events, in sensor pixels."""
    ints, n = buffer.view(np.int64), _n_events(buffer)
    return int(ints[S.SUM_X]) / n, int(ints[S.SUM_Y]) / n


def _duration_us(buffer: np.ndarray) -> int:
    """From the window's start to its newest event."""
    ints = buffer.view(np.int64)
    return max(1, int(ints[S.NEWEST_US] - ints[S.START_US]))
