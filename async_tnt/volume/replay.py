"""Events that are stored until the volume is read, and replayed then.

Three settings need a replay, because they use something that is known only when the volume is read:

    landmark `window`      the centroid of all the window's events so far
    landmark `regressor`   a network's estimate from the raw volume of the same events
    `window_events`        the time of the window's newest event, by which times are scaled
"""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt.base.running import Running, one_at_a_time
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.volume import state as S
from async_tnt.kernels.volume.absorb import absorb, store_events
from async_tnt.kernels.volume.readout import cells_to_float32, empty_volume
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.events import Columns, empty_columns
from async_tnt.volume.regressor import Regressor, checked_landmark
from async_tnt.volume.state import MAX_EVENTS, new_state, next_epoch, set_duration

FIRST_CAPACITY = 4096
"""Number of events that are stored before the memory grows for the first time."""
MAX_STORED = 1 << 26
"""The most events that are stored for a window of a duration. They take 870 MB. Without this limit,
a clock that stands still would fill the memory."""
UNCHANGED_BY_REPLAY = (S.LIMIT_US, S.RECEIVED, S.DECIDED_FROM_US)
"""Slots of a volume's buffer that keep their numbers when its events are replayed."""
MORE_THAN_THE_LOG_HOLDS = MAX_EVENTS
"""A number of logged changes after which all cells are emptied, instead of those that the log
names."""


class ReplayBuffer:
    """The stored events of one window, and their replay.

    The events are replayed when the volume is read, with the landmark and the duration that are
    known at that moment. The memory grows with the window.

    Parameters
    ----------
    config : configuration of the volume that the events are replayed into.
    regressor : the callable of landmark `regressor`; None if the landmark is another one.
    """

    def __init__(self, config: TNTConfig, regressor: Regressor | None) -> None:
        self._n_most = config.window_events or MAX_EVENTS
        self._config = config
        self._regressor = regressor
        self._raw_config = config.replace(transform="none", landmark="center", remove_flow=False)
        self._raw = None if regressor is None else new_state(self._raw_config)
        self._columns = empty_columns(FIRST_CAPACITY)
        self._running = Running("Processor or TNTVolume")
        self._prepare()
        self.reset()

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._prepare()  # perhaps in another process

    def _prepare(self) -> None:
        """Compile the kernels, so that no event waits for that."""
        prepare(store_events, empty_volume, absorb)
        if self._regressor is not None:
            prepare(cells_to_float32)

    @one_at_a_time
    def reset(self) -> None:
        """Forget all stored events."""
        # The landmark after the newest event; None: it is not known yet.
        self._landmark: tuple[float, float] | None = None
        self._is_replayed = True

    @one_at_a_time
    def store(self, buffer: np.ndarray, columns: Columns, first: int, last: int) -> int:
        """Store the events `first <= i < last` up to the volume's limit.

        Returns the index of the first event that is not stored.
        """
        n_before = _n_events(buffer)
        if n_before + last - first > self._columns.t.size:
            limit_us = buffer.view(np.int64)[S.LIMIT_US]
            before_limit = columns.t[first:last] < limit_us
            self._grow(n_before, n_before + int(np.count_nonzero(before_limit)))

        # The landmark is forgotten first, even if no event will be stored, because an exception,
        # such as Ctrl-C, may come right after the kernel.
        self._landmark = None
        self._is_replayed = False
        # The memory is a limit, too, because another thread may have changed the events' times
        # since the events were counted.
        n_most = min(self._n_most, self._columns.t.size)
        return int(store_events.call(buffer, *columns[:4], first, last, *self._columns[:4], n_most))

    def landmark(self, buffer: np.ndarray) -> tuple[float, float]:
        """The landmark (x, y), in grid pixels, of a window with events.

        The landmark is kept until new events arrive. This may be called only if `defers_landmark`
        of the configuration is True.
        """
        if self._landmark is None:
            return self._find_landmark(buffer)
        return self._landmark

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
        raw = self._raw
        assert raw is not None
        config = self._raw_config
        ints = buffer.view(np.int64)
        array = np.zeros(config.shape, np.float32)

        if config.window_events is not None:
            set_duration(raw, config, _duration_us(buffer))
        empty_volume.call(raw, array, int(ints[S.START_US]), int(ints[S.LIMIT_US]), next_epoch())
        absorb.call(raw, *self._columns[:4], 0, _n_events(buffer))
        cells_to_float32.call(raw, array)
        array.flags.writeable = False
        return array

    def run(self, buffer: np.ndarray, array: np.ndarray) -> None:
        """Bring the volume's cells and counts up to date: replay the stored events, if needed.

        buffer, array : the volume's buffer and its array, see
            `kernels.volume.readout.empty_volume`.
        """
        # If all events that came were late, the window has no events to replay.
        if not self._is_replayed and _n_events(buffer):
            self._replay(buffer, array)

    @one_at_a_time
    def _replay(self, buffer: np.ndarray, array: np.ndarray) -> None:
        config = self._config
        ints = buffer.view(np.int64)
        if config.defers_landmark:
            self._fix_landmark(buffer)
        if config.window_events is not None:
            set_duration(buffer, config, _duration_us(buffer))

        n_events = _n_events(buffer)
        saved = ints[: S.NUM_X].copy()
        try:
            empty_volume.call(buffer, array, int(ints[S.START_US]), S.NEVER_US, next_epoch())
            # the replay counts again, from the counts that the window began with
            ints[S.CLOSED_KEPT] = saved[S.CLOSED_KEPT]
            ints[S.CLOSED_TAU_ZERO] = saved[S.CLOSED_TAU_ZERO]
            ints[S.KEPT] = saved[S.CLOSED_KEPT]
            ints[S.TAU_ZERO] = saved[S.CLOSED_TAU_ZERO]
            absorb.call(buffer, *self._columns[:4], 0, n_events)
            for slot in UNCHANGED_BY_REPLAY:
                ints[slot] = saved[slot]
        except BaseException:  # after Ctrl-C, for example, the next read replays again
            ints[: S.NUM_X] = saved
            ints[S.N_LOG] = MORE_THAN_THE_LOG_HOLDS
            raise
        self._is_replayed = True

    def _fix_landmark(self, buffer: np.ndarray) -> None:
        """Write the landmark of the newest event into the buffer, where the kernels read it."""
        if self._landmark is None:
            self._landmark = self._estimate(buffer)
        if self._regressor is None:
            # The centroid is taken again, because the landmark's grid pixels are rounded.
            x, y = _centroid(buffer)
        else:
            x, y = self._config.to_sensor(*self._landmark)
        buffer[S.FIXED_X] = x
        buffer[S.FIXED_Y] = y

    def close(self, buffer: np.ndarray, array: np.ndarray) -> None:
        """Bring the window's counts up to date before the window is emptied."""
        self.run(buffer, array)
        self._landmark = None

    def _grow(self, n_stored: int, n: int) -> None:
        """Make room for `n` events, and keep the `n_stored` events that are there."""
        n = min(n, self._n_most)
        if n > MAX_STORED and self._config.window_events is None:
            raise ValueError(
                f"a window must have at most {MAX_STORED} events where they are stored (landmark "
                f"`window` or `regressor`), got {n}: shorten `window_us`"
            )
        if n <= self._columns.t.size:
            return
        larger = empty_columns(max(n, 2 * self._columns.t.size))
        for old, new in zip(self._columns[:4], larger[:4], strict=True):
            new[:n_stored] = old[:n_stored]
        self._columns = larger


def _n_events(buffer: np.ndarray) -> int:
    return int(buffer.view(np.int64)[S.N])


def _centroid(buffer: np.ndarray) -> tuple[float, float]:
    """The mean of the window's events, in sensor pixels."""
    ints = buffer.view(np.int64)
    n = _n_events(buffer)
    return int(ints[S.SUM_X]) / n, int(ints[S.SUM_Y]) / n


def _duration_us(buffer: np.ndarray) -> int:
    """The time from the window's start to its newest event, at least 1."""
    ints = buffer.view(np.int64)
    return max(1, int(ints[S.NEWEST_US] - ints[S.START_US]))
