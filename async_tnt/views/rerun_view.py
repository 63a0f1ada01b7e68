"""RerunView: logs a stream to the Rerun viewer, or to a .rrd file, while it is processed."""

from __future__ import annotations

import contextlib
import copy
import os
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Generic, Unpack
from urllib.parse import urlsplit

import numpy as np

from async_tnt.base.checks import ParameterValueError, positive_int
from async_tnt.base.extras import needs_extra
from async_tnt.base.files import Replacement, check_writable, user_path
from async_tnt.networks.models.compiled_network import CompiledNetwork
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.spiking_network import SpikingNetwork
from async_tnt.streaming.output import AnswerT
from async_tnt.streaming.processor import Processor
from async_tnt.streaming.streams import Settings, as_processor
from async_tnt.views.rerun_decisions import DecisionLog
from async_tnt.views.rerun_log import AnswerLog, StreamLog
from async_tnt.views.rerun_outputs import OutputLog
from async_tnt.views.rerun_spikes import SpikesLog
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.events import EVENT_DTYPE, as_events
from async_tnt.volume.volume import TNTVolume

SUFFIXES = (".rrd",)
DEFAULT_PORT = 9876
"""The port where a Rerun viewer listens."""
PATIENCE_S = 5.0
"""Seconds that a viewer has to respond."""
LIVE_S = 1 / 60
"""Seconds between pictures of a live stream, at least."""
CHECK_S = 1.0
"""Seconds between flushes, which report a full disk and bound what waits for a slow viewer."""
LAST_US = (1 << 63) // 1000
"""Events must be before this time, in microseconds, because Rerun counts nanoseconds in 64 bits."""


def import_rerun() -> Any:
    """The module `rerun`. Raises ImportError if it is not installed."""
    with needs_extra("view", "views need rerun-sdk"):
        import rerun
        import rerun.blueprint
    return rerun


class RerunView(contextlib.AbstractContextManager["RerunView[AnswerT]"], Generic[AnswerT]):
    """Classifies a stream, and shows it in the Rerun viewer.

    With a model of raw outputs, the view has a panel for each output. The answers are then `Output`
    values, which are valid until the next call, as those of a Processor are.

    Parameters
    ----------
    model : a Model, its name or path, a TNTConfig (with `classifier=`), or a Processor that has
        seen no event yet.
    out : a .rrd file to write; `rerun FILE.rrd` opens it.
    connect : URL of a running viewer, rerun+http://HOST:9876/proxy. Without `out` and `connect`, a
        viewer is started.
    picture_us : recorded microseconds between pictures. Another picture is taken at the end of each
        window.
    live : whether the stream has no end. If so, there are at most 60 pictures a second of real
        time, drawing takes at most half of the time, and the plots show only the last seconds.
    name : name of this recording in the viewer's list; by default a number.
    settings : keyword arguments of `Processor`. If windows overlap, the view shows the window that
        `Processor.fire` decides.

    Attributes
    ----------
    processor : the Processor that classifies.

    Raises
    ------
    ImportError : rerun-sdk is not installed.
    ValueError, TypeError : a setting is not allowed.
    OSError : the file cannot be written, no viewer responds, or there is no display on which to
        start one.
    """

    def __init__(
        self,
        model: Model | TNTConfig | Processor[AnswerT] | str | Path,
        *,
        out: str | Path | None = None,
        connect: str | None = None,
        picture_us: int = 20_000,
        live: bool = False,
        name: str | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        rr = import_rerun()
        self._picture_us = positive_int("picture_us", picture_us)
        if out is not None and connect is not None:
            rule = "writes a file and {connect} goes to a viewer: give one of them"
            raise ParameterValueError("out", rule)
        self.processor: Processor[AnswerT] = as_processor(model, **settings)
        config = self.processor.config
        if config.window_events is not None:
            raise ValueError(
                f"windows of a duration can be viewed, but not of {config.window_events} events"
            )
        self._live = live
        raw_config = config.replace(transform="none", landmark="center", remove_flow=False)
        self._raw = TNTVolume(raw_config, late=self.processor.late)
        self._stream = rr.RecordingStream("async_tnt")
        self._file: Replacement | None = None
        if out is not None:
            self._file = _save(self._stream, user_path(out))
        elif connect is not None:
            _connect(self._stream, connect)
        else:
            _start_viewer(self._stream)
        self._error_text = "the Rerun viewer was closed or does not respond"
        if out is not None:
            self._error_text = str(out)
        elif connect is not None:
            self._error_text = f"{connect}: {self._error_text}"
        if name is not None:
            self._stream.send_recording_name(name)
        answers = _answer_log(rr, self._stream, self.processor)
        self.log = StreamLog(rr, self._stream, config, answers, live=live)
        """Writes the pictures; `log.n_pictures` counts them."""
        self._closed = False
        self._next_check_s = time.perf_counter() + CHECK_S
        # start of the first window; None before the first event
        self._origin_us: int | None = None
        self._due_us = 0  # moment of the next picture
        self._newest_us = 0  # time of the newest event
        # packets that hold the events of the open window and those of the event image
        self._recent = [np.empty(0, EVENT_DTYPE)]
        self._next_picture_s = 0.0  # a live stream has no picture before this time of the clock

    def push(self, events: Any) -> list[AnswerT]:
        """Process a packet as `Processor.push` does, and log the pictures that are due.

        Raises
        ------
        ValueError, TypeError : the packet is invalid. None of its events was used.
        """
        packet = as_events(events, self.processor.config.sensor)
        if len(packet) == 0:
            return []
        # The stream's time at each event: the time of the newest event so far.
        newest = np.maximum.accumulate(packet["t"])
        np.maximum(newest, self._newest_us, out=newest)
        # `finish` takes the last picture a microsecond after the newest event
        if int(newest[-1]) >= LAST_US:
            raise ValueError(
                f"`t` must be below {LAST_US} us to be shown by Rerun, got {int(newest[-1])}"
            )
        if self.processor.late == "raise" and (newest > packet["t"]).any():
            # the processor refuses the whole packet with an error
            return self.processor.push(packet)
        # pictures begin with the first window: at `start_us`, or else with the first event
        if self._origin_us is None:
            start_us = self.processor.start_us
            self._origin_us = int(newest[0]) if start_us is None else start_us
            self._due_us = self._next_due_us(int(newest[0]))

        answers: list[AnswerT] = []
        # cut the packet where pictures are due
        first = 0
        while first < len(packet):
            if newest[first] >= self._due_us:
                self._picture(self._due_us)
                self._due_us = self._next_due_us(int(newest[first]))
            stop = int(np.searchsorted(newest, self._due_us))
            part = packet[first:stop]
            new_answers = self.processor.push(part)
            self.log.add(new_answers)
            # the next picture and the next part change the arrays of the last answer
            if new_answers and stop < len(packet) and self.processor.answers_are_views:
                new_answers[-1] = copy.copy(new_answers[-1])
            answers += new_answers
            self._recent.append(part)
            self._newest_us = int(newest[stop - 1])
            first = stop
        return answers

    def finish(self) -> list[AnswerT]:
        """End the stream: log a last picture, and the answers of `Processor.finish`."""
        if self._origin_us is None:
            return []
        self._picture(self._newest_us + 1, last=True)
        answers = self.processor.finish()
        self.log.add(answers)
        self.log.write_pending()
        self._origin_us = None
        return answers

    def _next_due_us(self, t_us: int) -> int:
        """The moment of the first picture after `t_us`."""
        assert self._origin_us is not None
        return next_moment(t_us, self._origin_us, self.processor.config.window_us, self._picture_us)

    def _picture(self, at_us: int, last: bool = False) -> None:
        """Take a picture of the state just before `at_us`.

        A live stream leaves out a picture that comes too soon after the previous one, except for
        the last picture.
        """
        now_s = time.perf_counter()
        answer = self.processor.fire()
        events = np.concatenate(self._recent)
        image_start_us = at_us - self._picture_us
        needed_from_us = min(image_start_us, answer.window_start_us)
        self._recent = [events[events["t"] >= needed_from_us]]
        if now_s >= self._next_picture_s or last:
            raw = self._raw_volume(events, answer)
            in_image = events[events["t"] >= image_start_us]
            self.log.write(at_us, answer, in_image, raw, self.processor)
            if self._live:
                took_s = time.perf_counter() - now_s
                self._next_picture_s = now_s + max(LIVE_S, 2 * took_s)
        if now_s >= self._next_check_s:
            self._flush()
            self._next_check_s = now_s + CHECK_S

    def _raw_volume(self, events: np.ndarray, answer: AnswerT) -> np.ndarray:
        """The open window's volume without the transform: float32, shape (C, H, W).

        The array is valid until the next call.
        """
        if self.processor.config.slides:
            return self.processor.volume()
        self._raw.reset()
        self._raw.open(answer.window_start_us)
        if answer.events:
            self._raw.update(events[events["t"] >= answer.window_start_us])
        return self._raw.array

    def close(self) -> None:
        """Finish the stream, and complete the file. A viewer stays open. May be called twice.

        Without events, no file is written, and an existing file stays as it is.
        """
        if self._closed:
            return
        self._closed = True
        try:
            self.finish()
        finally:
            self._complete_file()

    def _complete_file(self) -> None:
        """Wait until everything is written, and give the file its name.

        Without events the new file is deleted, and an old file of that name stays.
        """
        try:
            self._flush()
            self._stream.disconnect()
        except OSError as error:
            if self._file is None:
                raise
            raise OSError(f"{error}; what was written before is in {self._file.part}") from None
        if self._file is not None:
            if self.processor.counts.received:
                self._file.complete()
            else:
                self._file.discard()

    def _flush(self) -> None:
        """Wait until everything that was logged is written.

        Raises
        ------
        OSError : it cannot be written.
        """
        with _as_os_error(self._error_text):
            self._stream.flush(timeout_sec=PATIENCE_S)

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Close the view, also after an error."""
        # After an error the state may be inconsistent, so a second error is ignored. The file keeps
        # what was logged before.
        if kind is not None:
            with contextlib.suppress(Exception):
                self.finish()
            self._origin_us = None
        self.close()


def _answer_log(rr: Any, stream: Any, processor: Processor[Any]) -> AnswerLog:
    """What logs the answers of a processor."""
    network: Any = processor.classifier
    if isinstance(network, CompiledNetwork):
        shapes = dict(zip(network.names, network.output_shapes, strict=True))
        return OutputLog(rr, stream, shapes)
    if not isinstance(network, SpikingNetwork):
        return DecisionLog(rr, stream, processor)
    answers: AnswerLog = DecisionLog(rr, stream, processor)
    if network.outputs:
        answers = OutputLog(rr, stream, network.outputs)
    return SpikesLog(rr, stream, processor, answers)


def _save(stream: Any, path: Path) -> Replacement:
    """Send a stream to the file NAME.rrd.part, which becomes NAME.rrd when it is complete."""
    check_writable(path, SUFFIXES)
    file = Replacement(path)
    try:
        with _as_os_error(path):
            stream.save(file.part)
    except OSError:
        file.discard()
        raise
    return file


def _start_viewer(stream: Any) -> None:
    """Start a viewer, and send a stream to it. The viewer stays open after the program ends."""
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not has_display:
        raise OSError(
            "no display to open the Rerun viewer on: write a file, or connect to a viewer elsewhere"
        )
    with _as_os_error("the Rerun viewer cannot be started"):
        stream.spawn(memory_limit="25%")
        stream.flush(timeout_sec=PATIENCE_S)


def _connect(stream: Any, url: str) -> None:
    """Send a stream to the viewer at a URL."""
    parts = urlsplit(url)
    if not parts.hostname or parts.path != "/proxy":
        raise ValueError(f"a viewer's URL is rerun+http://HOST:{DEFAULT_PORT}/proxy, got {url}")
    address = (parts.hostname, parts.port or DEFAULT_PORT)
    # A connection is tried first, because without a viewer the SDK would wait for seconds, and
    # print lines of its own.
    try:
        socket.create_connection(address, timeout=PATIENCE_S).close()
    except OSError:
        raise OSError(f"{url}: no Rerun viewer listens there; `rerun` starts one") from None
    with _as_os_error(url):
        stream.connect_grpc(url)


@contextlib.contextmanager
def _as_os_error(subject: object) -> Iterator[None]:
    """Turn an error of the SDK into an OSError of one line.

    Such an error is a full disk, or a viewer that was closed.
    """
    try:
        yield
    except RuntimeError as error:
        raise OSError(f"{subject}: {' '.join(str(error).split())}") from None


def next_moment(t_us: int, origin_us: int, window_us: int, step_us: int) -> int:
    """The first moment after `t_us` at which a picture is due.

    Windows follow each other from `origin_us`. Pictures are due every `step_us` from a window's
    start, and at its end, so that the last picture of a window shows all of it. If a window is
    shorter than a step, a picture is due only at the end of every n-th window. Here n is the
    smallest number of windows that last as long as a step.

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
        n_windows = -(-step_us // window_us)  # rounded up
        window_us = n_windows * window_us
        step_us = window_us
    start_us = t_us - (t_us - origin_us) % window_us
    n_steps = (t_us - start_us) // step_us + 1
    return min(start_us + n_steps * step_us, start_us + window_us)
