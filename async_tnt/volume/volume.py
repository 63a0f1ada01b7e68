"""TNTVolume: a volume that is updated with O(1) work per event."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from async_tnt.base.checks import checked_time
from async_tnt.base.running import Running, one_at_a_time
from async_tnt.kernels.entry_points import EntryPoint, prepare
from async_tnt.kernels.volume import state as S
from async_tnt.kernels.volume.absorb import LATE, REFUSED, absorb, absorb_one
from async_tnt.kernels.volume.readout import cells_to_float32, empty_volume
from async_tnt.kernels.volume.sliding import advance
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.counts import Counts
from async_tnt.volume.events import LARGER_CAMERA, Columns, EventDecoder, Late
from async_tnt.volume.regressor import Regressor, check_regressor
from async_tnt.volume.replay import ReplayBuffer
from async_tnt.volume.single_event import SingleEventReader
from async_tnt.volume.state import new_state, next_epoch

UNOPENED = -1
"""LIMIT_US while no window is open. The time of every event is at or after this number."""
COUNTED = (S.RECEIVED, S.KEPT, S.LATE, S.TAU_ZERO, S.DECIDED, S.LEFT_EARLY)
"""Slots of the buffer that count events since the volume was made or reset."""


class TNTVolume:
    """The event volume of one open window, up to date after every event.

    Windows lie end to end, from the start given to `open` or else from the first event. A window
    that slides, with `last_events` or `last_us`, has no end: old events leave it. An event at
    or after the window's end closes the window; the volume then holds the window of that event. (To
    see every closed window, use `Processor`.) A window of `window_events` is closed by the event
    after its last one, and the next window begins with that event.

    Parameters
    ----------
    config : TNTConfig.
    late : `accept`, `drop` or `raise`: what to do with an event older than the newest one seen.
        Events before the open window are always dropped and counted.
    regressor : for landmark `regressor` only: a callable from the window's raw volume to a finite
        landmark (x, y) in grid pixels. A raw volume is made without the transform: float32, shape
        (C, H, W), read-only, valid during the call. A model's own regressor is
        `CompiledRegressor(model)`. It is called when `array`, `landmark` or `counts` is read after
        new events, and when a window closes. Its errors pass through, and leave the window as it
        was.

    Raises
    ------
    ValueError, TypeError : a setting is invalid; a regressor is passed, but the landmark is not
        `regressor`; or the landmark is `regressor`, and none is passed. Also when the volume is
        read, if the regressor's answer is not a finite (x, y).

    Examples
    --------
    >>> volume = TNTVolume(TNTConfig(landmark="center", t_max=8.0))
    >>> volume.open(0)
    >>> volume.update_one(t=13_125, x=16, y=17, p=1)  # TNT time 1: one pixel is one pixel
    0
    >>> float(volume.array[1, 17, 16]), volume.landmark
    (1.0, (16.5, 16.5))
    """

    def __init__(
        self, config: TNTConfig, *, late: Late = "accept", regressor: Regressor | None = None
    ) -> None:
        check_regressor(config, regressor)
        prepare(*_kernels_of(config))
        self.config = config
        self._duration_us = S.NEVER_US if config.slides else config.window_us
        self._decoder = EventDecoder(config.sensor, late, LARGER_CAMERA)
        self._read_one = SingleEventReader()
        self._buffer = new_state(config)
        self._ints = self._buffer.view(np.int64)
        self._array = np.zeros(config.shape, np.float32)
        self._view = _read_only(self._array)
        self._running = Running("TNTVolume")
        self._replay = ReplayBuffer(config, regressor) if config.needs_replay else None
        # whether a single event may go straight to the kernel
        self._is_plain = late == "accept" and self._replay is None
        self.reset()

    def __getstate__(self) -> dict[str, Any]:
        if self._running.now:
            raise self._running.overlap()
        return {name: value for name, value in vars(self).items() if name not in ("_ints", "_view")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        prepare(*_kernels_of(self.config))  # perhaps in another process
        # The views are made again, as views of the copied memory.
        self._ints = self._buffer.view(np.int64)
        self._view = _read_only(self._array)
        # From now on this volume and its original differ, so they need different numbers.
        self._ints[S.EPOCH] = next_epoch()

    def __copy__(self) -> TNTVolume:
        return copy.deepcopy(self)

    def __repr__(self) -> str:
        return f"TNTVolume({self.config}, {self.n_events} events from {self.start_us} us on)"

    # -- events in ---------------------------------------------------------------------------------

    @one_at_a_time
    def open(self, start_us: int) -> None:
        """Open the empty window `[start_us, start_us + window_us)`; later windows follow it.

        start_us : start of the window, in microseconds.
        """
        start_us = checked_time("start_us", start_us)
        self._empty(start_us, start_us + self._duration_us)

    @one_at_a_time
    def close(self) -> None:
        """Close the open window. The volume is empty until an event, or `open`, opens the next."""
        self._empty(0, UNOPENED)

    def set_limit(self, limit_us: int) -> None:
        """Make `absorb` stop before events at or after `limit_us`.

        `absorb` also stops at the window's end, whatever the limit is.
        """
        self._ints[S.LIMIT_US] = min(limit_us, self.start_us + self._duration_us)

    def set_decided_from(self, start_us: int) -> None:
        """Count late events from `start_us` on as `dropped_decided` while this window is open."""
        self._ints[S.DECIDED_FROM_US] = start_us

    def _empty(self, start_us: int, limit_us: int) -> None:
        if self._replay is not None:
            self._replay.close(self._buffer, self._array)
        empty_volume.call(self._buffer, self._array, start_us, limit_us, next_epoch())

    def update(self, events: Any) -> int:
        """Add a packet of `events`, in any form that `async_tnt.volume.event_forms` lists.

        Returns
        -------
        int : how many windows with events the packet closed.

        Raises
        ------
        ValueError, TypeError : the packet is invalid. None of its events is added then.
        """
        # a packet is not looked at for a single event, which takes 200 ns
        is_four = type(events) is tuple and len(events) == 4
        kind = type(events[0]) if is_four else type(events)
        if kind is not np.ndarray:
            event = self._read_one(events)
            if event is not None:
                return self.update_one(*event)
        self._running.begin()
        try:
            return self._update(self._decoder.decode(events))
        finally:
            self._running.now = False

    def _update(self, columns: Columns) -> int:
        n = columns.n
        first = self.absorb(columns, 0, n)
        n_closed = 0
        while first < n:
            n_closed += self._open_next(int(columns.t[first]))
            first = self.absorb(columns, first, n)
        return n_closed

    def update_one(self, t: int, x: int, y: int, p: int) -> int:
        """`update` for one event.

        `t` is in microseconds, `x` and `y` are in pixels. The polarity `p` is 0 or 1, or -1 or +1.
        """
        # the lines of the method `absorb_one`, because a call of this method would cost 40 ns more
        try:
            is_plain = type(t) is type(x) is type(y) is type(p * 1) is int and self._is_plain
            if (
                is_plain
                and not self._running.now
                and absorb_one.call(self._buffer, t, x, y, p * 1) <= LATE
            ):
                return 0
        except (TypeError, OverflowError):
            pass
        self._running.begin()
        try:
            return self._update(self._decoder.decode_one(t, x, y, p))
        finally:
            self._running.now = False

    def absorb_one(self, t: int, x: int, y: int, p: int) -> int:
        """Add one event, for callers that manage windows themselves.

        Returns
        -------
        int : ABSORBED: the event was added. LATE: the event is before the window and was only
            counted. AT_LIMIT: the event is valid but at or past the limit. REFUSED: the decoder has
            to look at the event. It is invalid or not four Python integers, or this volume drops
            late events or stores events for a replay.
        """
        try:
            # The compiled call checks no types, so it gets Python integers only.
            if type(t) is type(x) is type(y) is type(p * 1) is int and self._is_plain:
                answer: int = absorb_one.call(self._buffer, t, x, y, p * 1)  # True becomes 1
                return answer
        except (TypeError, OverflowError):
            pass  # the decoder names the mistake
        return REFUSED

    def absorb(self, columns: Columns, first: int, last: int) -> int:
        """Add the events `first <= i < last` of checked `columns`, up to the limit.

        Returns the first event not added.
        """
        if self._replay is not None:
            return self._replay.store(self._buffer, columns, first, last)
        absorbed: int = absorb.call(
            self._buffer, columns.t, columns.x, columns.y, columns.p, first, last
        )
        return absorbed

    def _open_next(self, t_us: int) -> int:
        """Open the window that holds `t_us`, a time at or after the open window's end.

        Returns the number of windows with events that are closed by this: 0 or 1.
        """
        n_closed = int(self.n_events > 0)
        start_us = t_us
        if self.is_open and self.config.window_events is None:
            # back to the window's start: windows lie end to end from the open window's start on
            start_us -= (t_us - self.start_us) % self.config.window_us
        self._empty(start_us, start_us + self._duration_us)
        return n_closed

    @one_at_a_time
    def reset(self) -> None:
        """Return to the state after construction: no window open, all counts zero."""
        # The replay is reset first, because its reset is refused while another thread reads the
        # volume. Nothing has changed then.
        if self._replay is not None:
            self._replay.reset()
        self._decoder.reset()
        for slot in COUNTED:
            self._ints[slot] = 0
        self._empty(0, UNOPENED)

    # -- results -------------------------------------------------------------------------------

    @property
    def array(self) -> np.ndarray:
        """The open window's volume: float32, shape (C, H, W), indexed [bin, y, x].

        Each access brings the volume up to date, and returns a read-only view of the same memory. A
        new window may empty this memory: copy the array to keep it.
        """
        self._running.begin()
        try:
            buffer = self.state()
            if self._ints[S.N_LOG] > self._ints[S.N_READ]:
                cells_to_float32.call(buffer, self._array)
            return self._view
        finally:
            self._running.now = False

    def state(self) -> np.ndarray:
        """The volume's buffer, up to date. `kernels.volume.state` says where each number lies.

        Do not write to it.
        """
        if self._replay is not None:
            self._replay.run(self._buffer, self._array)
        return self._buffer

    def move_to(self, memory: np.ndarray) -> None:
        """Keep the buffer in this memory from now on: float64, as large as `buffer`."""
        memory[:] = self._buffer
        self._buffer = memory
        self._ints = memory.view(np.int64)

    @property
    def buffer(self) -> np.ndarray:
        """The same array as `state()`, but stored events are not replayed.

        It is for compiled code that adds events to the volume.
        """
        return self._buffer

    @property
    def landmark(self) -> tuple[float, float]:
        """The landmark (x, y) in grid pixels after the newest event.

        It is the grid's centre before the first event, and without the transform.
        """
        config = self.config
        n = self.n_events
        if n == 0 or config.landmark == "center" or config.transform == "none":
            width, height = config.grid
            return (width - 1) / 2, (height - 1) / 2
        if self._replay is not None and config.defers_landmark:
            return self._replay.landmark(self._buffer)

        x = int(self._ints[S.SUM_X]) / n
        y = int(self._ints[S.SUM_Y]) / n
        if config.landmark == "line":
            # SUM_T is read after `_slopes`, which may replay the window and so set the sums.
            slope_x, slope_y = self._slopes()
            mean_f = int(self._ints[S.SUM_T]) / n / float(self._buffer[S.WINDOW_US])
            x -= slope_x * mean_f
            y -= slope_y * mean_f
        return config.to_grid(x, y)

    @property
    def flow(self) -> tuple[float, float]:
        """The fitted flow (x, y) in grid pixels per window, for the landmark `line` only.

        The duration of a window of `window_events` is the time until its newest event.
        """
        if self.config.landmark != "line" or self.config.transform != "tnt":
            got = f"landmark={self.config.landmark!r}, transform={self.config.transform!r}"
            raise ValueError(f'`flow` needs landmark="line" and transform="tnt", got {got}')
        return self.config.to_grid(*self._slopes())

    def _slopes(self) -> tuple[float, float]:
        """The slopes (x, y) of the running line, in sensor pixels per window."""
        buffer = self.state()
        c_ff = float(buffer[S.C_FF]) + 1.0
        return float(buffer[S.C_XF]) / c_ff, float(buffer[S.C_YF]) / c_ff

    @property
    def counts(self) -> Counts:
        """What became of the events, see `Counts`."""
        ints = self.state().view(np.int64)
        received = int(ints[S.RECEIVED])
        kept = int(ints[S.KEPT])
        tau_zero = int(ints[S.TAU_ZERO])
        late = int(ints[S.LATE])
        decided = int(ints[S.DECIDED])
        # Late events that the decoder dropped are not counted by the kernels.
        n_dropped_by_decoder = self._decoder.n_dropped
        return Counts(
            received=received + n_dropped_by_decoder,
            kept=kept,
            dropped_outside=received - kept - tau_zero - late - decided,
            dropped_tau_zero=tau_zero,
            dropped_late=late + n_dropped_by_decoder,
            dropped_decided=decided,
        )

    def advance(self, now_us: int) -> None:
        """Let time pass, in a window of `last_us`: events that are too old by then leave it.

        Nothing happens in other windows, or at a time before the newest event.
        """
        if self.config.last_us is not None:
            advance.call(self._buffer, now_us)

    @property
    def n_events(self) -> int:
        """Events in the open window so far. If it slides, those that have left it do not count."""
        return int(self._ints[S.RING_N if self.config.slides else S.N])

    @property
    def n_arrived(self) -> int:
        """Events that have come into the window since it opened, including those that left it."""
        return int(self._ints[S.N])

    @property
    def n_left_early(self) -> int:
        """How many events have left a window of `last_us` early because it was full.

        They are counted since the volume was made or reset. See `volume.config.MAX_LAST_EVENTS`.
        """
        return int(self._ints[S.LEFT_EARLY])

    def moment(self) -> tuple[int, int, int]:
        """The open window's start, the time of its newest event, and the number of its events.

        The time is the start if the window has no events. A window that slides begins with its
        oldest event.
        """
        if self.config.slides:
            return self._sliding_moment()
        # One slice is read, because to read the three numbers one by one takes three times as long.
        slots = self._ints[S.START_US : S.NEWEST_US + 1].tolist()
        start_us = slots[0]
        n = slots[S.N - S.START_US]
        return start_us, slots[-1] if n else start_us, n

    def _sliding_moment(self) -> tuple[int, int, int]:
        """The value of `moment` for a window that slides."""
        ints = self._ints
        n = int(ints[S.RING_N])
        newest_us = int(ints[S.NEWEST_US])
        if n == 0:
            start_us = max(int(ints[S.START_US]), newest_us)
            return start_us, start_us, 0
        return int(ints[ints[S.RING] + 2 * ints[S.RING_FIRST]]), newest_us, n

    @property
    def n_received(self) -> int:
        """Events that came to the kernels, also late events."""
        return int(self._ints[S.RECEIVED])

    @property
    def is_open(self) -> bool:
        """Whether a window is open."""
        return int(self._ints[S.LIMIT_US]) != UNOPENED

    @property
    def n_late(self) -> int:
        """Events dropped because they were older than the open window."""
        return int(self._ints[S.LATE])

    @property
    def n_dropped_decided(self) -> int:
        """Events dropped because their windows had been closed early."""
        return int(self._ints[S.DECIDED])

    @property
    def start_us(self) -> int:
        """Start of the open window, in microseconds; 0 before the first window."""
        return int(self._ints[S.START_US])

    @property
    def newest_us(self) -> int:
        """Time of the newest event in the open window, in microseconds; -1 if it has none."""
        return int(self._ints[S.NEWEST_US])


def _kernels_of(config: TNTConfig) -> tuple[EntryPoint, ...]:
    """The kernels that a volume calls."""
    kernels = (empty_volume, absorb, absorb_one)
    return (*kernels, advance) if config.last_us is not None else kernels


def _read_only(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view
