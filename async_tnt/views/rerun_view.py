"""RerunView: logs a stream to the Rerun viewer, or to a .rrd file, while it is classified."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, Unpack

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.decision import Decision
from async_tnt.events import Late, as_events
from async_tnt.networks.model import Model
from async_tnt.processor import Processor
from async_tnt.streams import Settings, as_processor
from async_tnt.views import rerun_layout as layout
from async_tnt.views.rerun_log import StreamLog
from async_tnt.views.rerun_sinks import import_rerun, sink_of
from async_tnt.volume import TNTVolume

CHECK_S = 1.0  # between checks of the sink, which also bound what waits for a slow viewer
LAST_US = (1 << 63) // 1000  # Rerun counts nanoseconds in 64 bits


class RerunView:
    """Classifies a stream and shows it.

    Parameters
    ----------
    model : a Model, its name or path, a TNTConfig (with `classifier=`), or a Processor that has seen no event yet and
        whose windows do not overlap.
    out : a .rrd file to write; `rerun FILE.rrd` opens it.
    connect : URL of a running viewer, rerun+http://HOST:9876/proxy. Without `out` and `connect`, a viewer is
        started.
    picture_us : recorded microseconds between pictures. Another one is taken at the end of each window.
    most_pictures_per_s : in real time; further ones are skipped, and drawing takes half of the time at most. For
        live streams, whose plots then show the last seconds.
    name : of this recording in the viewer's list; by default a number.
    settings : keyword arguments of `Processor`, all but `hop_us`.

    Raises
    ------
    ImportError : rerun-sdk is not installed.
    ValueError, TypeError : a setting breaks its rule.
    OSError : the file cannot be written, no viewer responds, or there is no display to start one on.
    """

    def __init__(
        self,
        model: Model | TNTConfig | Processor | str | Path,
        *,
        out: str | Path | None = None,
        connect: str | None = None,
        picture_us: int = 20_000,
        most_pictures_per_s: float | None = None,
        name: str | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        rr = import_rerun()
        if settings.get("hop_us") is not None:
            raise ValueError("`hop_us` makes windows overlap; a view shows windows laid end to end")
        if picture_us < 1:
            raise ValueError(f"`picture_us` must be at least 1, got {picture_us}")
        if most_pictures_per_s is not None and not most_pictures_per_s > 0:
            raise ValueError(f"`most_pictures_per_s` must be above 0, got {most_pictures_per_s}")
        self.processor = as_processor(model, **settings)
        config = self.processor.config
        if config.window_events is not None:
            raise ValueError(f"windows of a duration can be viewed, but not of {config.window_events} events")
        self._picture_us = int(picture_us)
        self._pause_s = 0.0 if most_pictures_per_s is None else 1 / most_pictures_per_s
        self._untransformed = UntransformedVolume(config, self.processor.late)
        self._sink = sink_of(None if out is None else Path(out), connect)
        self._stream = stream = rr.RecordingStream(layout.APPLICATION)
        self._sink.open(stream)
        try:
            if name is not None:
                stream.send_recording_name(name)
            self._log = StreamLog(rr, stream, config, live=most_pictures_per_s is not None)
        except BaseException:
            self._sink.close(stream, keep=False)
            raise
        self.n_events = 0
        """Events shown so far."""
        self._closed = False
        self._next_check_s = time.perf_counter() + CHECK_S
        self._end_us: int | None = None  # on the timeline: of the sources before
        self._forget()

    def _forget(self) -> None:
        """Reset what is known of the source."""
        self._origin_us: int | None = None
        self._due_us = self._newest_us = 0
        self._unseen: list[np.ndarray] = []  # since the last moment of a picture
        self._recent: list[np.ndarray] = []  # before it, but still shown
        self._shown_us = 0
        self._next_picture_s = 0.0

    # -- events in ---------------------------------------------------------------------------------------

    def start(self, name: str) -> None:
        """Start another source: windows and counts are reset, and its times follow those of the previous source.

        name : of the source, for the log of decisions.
        """
        self.finish()
        self.processor.reset()
        self._untransformed.reset()
        self._forget()
        self._log.name = name

    def push(self, events: Any) -> list[Decision]:
        """Classify a packet as `Processor.push` does, and log the pictures that are due.

        Raises
        ------
        ValueError, TypeError : the packet is invalid; none of it was used. Also if the view cannot follow the
            processor, see `UntransformedVolume`.
        """
        packet = as_events(events, self.processor.config.sensor)
        if len(packet) == 0:
            return []
        newest = np.maximum.accumulate(packet["t"])  # an event out of order comes with the newest before it
        np.maximum(newest, self._newest_us, out=newest)
        if self._origin_us is None:
            self._begin(int(newest[0]))
        if int(newest[-1]) + self._log.offset_us > LAST_US:
            raise ValueError(f"`t` must be below {LAST_US} us to be shown by Rerun, got {int(newest[-1])}")
        decisions: list[Decision] = []
        first = 0
        while first < len(packet):
            if newest[first] >= self._due_us:
                self._draw_due(int(newest[first]))
            last = int(np.searchsorted(newest, self._due_us))
            self._process(packet[first:last], decisions)
            self._newest_us = int(newest[last - 1])
            first = last
        return decisions

    def finish(self) -> list[Decision]:
        """End the source: a last picture, and the decision of `Processor.finish` on the open window."""
        if self._origin_us is None:
            return []
        if self._unseen:
            self._picture(self._newest_us + 1, last=True)
        started = time.perf_counter_ns()
        decisions = self.processor.finish()
        self._log.add(decisions, (time.perf_counter_ns() - started) / 1e3, 0)
        self._log.write_decisions()
        self._end_us = self._newest_us + self._log.offset_us
        self._origin_us = None
        return decisions

    def _begin(self, first_us: int) -> None:
        """The first event of a source determines the start of its windows, and thus its pictures."""
        origin_us = self.processor.start_us
        if origin_us is None:  # a window may be open already; if none is, it starts at 0
            origin_us = self.processor.fire().window_start_us or first_us
        self._origin_us = origin_us
        self._log.offset_us = 0 if self._end_us is None else self._end_us + self._picture_us - first_us
        self._log.begin(first_us)
        self._shown_us = first_us
        self._due_us = self._after(first_us)

    def _process(self, packet: np.ndarray, decisions: list[Decision]) -> None:
        started = time.perf_counter_ns()
        new = self.processor.push(packet)
        self._log.add(new, (time.perf_counter_ns() - started) / 1e3, len(packet))
        decisions += new
        self.n_events += len(packet)
        self._unseen.append(packet)

    # -- pictures ----------------------------------------------------------------------------------------

    def _after(self, t_us: int) -> int:
        assert self._origin_us is not None
        return next_moment(t_us, self._origin_us, self.processor.config.window_us, self._picture_us)

    def _draw_due(self, t_us: int) -> None:
        """Draw the pictures that are due before the next event at `t_us`; of a long silence, only its beginning."""
        self._picture(self._due_us)
        silent_us = self._after(self._due_us)
        if silent_us <= t_us:
            self._log.no_events(silent_us)
        self._due_us = self._after(t_us)

    def _picture(self, at_us: int, last: bool = False) -> None:
        """The state just before `at_us`."""
        assert self._origin_us is not None
        now = self.processor.fire()
        raw = self._untransformed.follow(self._unseen, now)
        oldest_us = at_us - self._picture_us
        recent = [packet[packet["t"] >= oldest_us] for packet in (*self._recent, *self._unseen)]
        self._recent, self._unseen = [packet for packet in recent if len(packet)], []
        clock_s = time.perf_counter()
        if clock_s >= self._next_picture_s or last:
            whole = last or (at_us - self._origin_us) % self.processor.config.window_us == 0
            self._log.write(at_us, at_us - self._shown_us, now, self._recent, raw, self.processor, whole)
            self._shown_us = at_us
            if self._pause_s:
                took_s = time.perf_counter() - clock_s
                self._next_picture_s = clock_s + max(self._pause_s, 2 * took_s)
        if clock_s >= self._next_check_s:
            self._sink.check(self._stream)
            self._next_check_s = clock_s + CHECK_S

    @property
    def n_pictures(self) -> int:
        """Pictures taken so far."""
        return self._log.n_pictures

    # -- the end -----------------------------------------------------------------------------------------

    def close(self) -> None:
        """Finish, and complete the file; a viewer stays open. May be called twice.

        A file without events is not written: an existing one stays.
        """
        if self._closed:
            return
        self._closed = True
        try:
            self.finish()
        finally:
            self._sink.close(self._stream, keep=self._log.has_begun)

    def __enter__(self) -> RerunView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is not None:  # the file keeps what came before the error; the state after it may be inconsistent
            with contextlib.suppress(Exception):
                self.finish()
            self._origin_us = None
        self.close()


class UntransformedVolume:
    """A volume without the transform that follows the open window of a processor.

    Parameters
    ----------
    config : the processor's.
    late : the processor's setting.
    """

    def __init__(self, config: TNTConfig, late: Late = "accept") -> None:
        raw = config.replace(transform="none", landmark="center", remove_flow=False)
        self._volume = TNTVolume(raw, late=late)

    def reset(self) -> None:
        """Start a new stream."""
        self._volume.reset()

    def follow(self, packets: Iterable[np.ndarray], now: Decision) -> np.ndarray:
        """Add the events that the processor received since the last call.

        Parameters
        ----------
        packets : structured arrays of events, all of them, in order.
        now : the result of the processor's `fire` after the last packet, which names the open window. If a decision
            closed a window early, this is a later one than the events alone imply.

        Returns
        -------
        float32, shape (C, H, W), read-only, valid until the next call.

        Raises
        ------
        ValueError : the processor's window holds other events.
        """
        volume = self._volume
        if volume.n_events == 0 or volume.start_us != now.window_start_us:
            volume.open(now.window_start_us)  # earlier events are late from now on
        for packet in packets:
            volume.update(packet)
        if now.events == 0:
            volume.open(now.window_start_us)
        if volume.n_events != now.events or volume.start_us != now.window_start_us:
            raise ValueError(
                f"the raw volume has {volume.n_events} events from {volume.start_us} us on, the processor's window "
                f"{now.events} from {now.window_start_us} us on: a view can only follow windows without overlap (no "
                "`hop_us`) whose events all went through its `push`"
            )
        return volume.array


def next_moment(t_us: int, origin_us: int, window_us: int, step_us: int) -> int:
    """The first moment after `t_us` at which a picture is due.

    Windows follow each other from `origin_us`. Pictures are due every `step_us` from a window's start and at its end,
    so that the last picture of a window shows all of it. Where a window is shorter than a step: at the end of as many
    whole windows as a step needs.

    Parameters
    ----------
    t_us, origin_us : int microseconds; `t_us` may be before `origin_us`.
    window_us, step_us : int microseconds, at least 1.

    Examples
    --------
    >>> [next_moment(t, 1000, 105, 40) for t in (1000, 1040, 1080, 1105)]
    [1040, 1080, 1105, 1145]
    >>> [next_moment(t, 1000, 30, 40) for t in (1000, 1060)]
    [1060, 1120]
    """
    if window_us < step_us:
        window_us = step_us = window_us * -(-step_us // window_us)
    start_us = t_us - (t_us - origin_us) % window_us
    return min(start_us + ((t_us - start_us) // step_us + 1) * step_us, start_us + window_us)
