"""Classes that are taught in front of a camera, while its stream goes on."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np

from async_tnt.cli.lessons import LIVE_S, lesson_lines
from async_tnt.cli.output import EXPECTED_ERRORS, complain, message_of
from async_tnt.networks.models.model import Model
from async_tnt.streaming.processor import Processor
from async_tnt.volume.events import as_events


class LiveLessons:
    """Teaches what a live source shows after a name was typed.

    The events of the next seconds are kept. Then a thread makes the model with the new class, and
    the Processor takes it at the next packet. The file is written after each lesson.

    Parameters
    ----------
    model : the model that decides, with statistics.
    out : the file of the taught model.
    names : the names that were typed.
    seconds : how long a lesson is.
    """

    def __init__(
        self, model: Model, out: Path, names: SimpleQueue[str], seconds: float = LIVE_S
    ) -> None:
        self._model = model
        self._out = out
        self._names = names
        self._length_us = int(1e6 * seconds)
        self._seconds = seconds
        self._name: str | None = None
        self._events: list[np.ndarray] = []
        self._begin_us = 0
        self._taught: Future[Model] | None = None
        self._thread = ThreadPoolExecutor(1, "async-tnt teach")

    def watch(self, packets: Iterable[Any], processor: Processor[Any]) -> Iterator[Any]:
        """Yield the packets. In between, names are read, and the Processor takes taught models."""
        try:
            for packet in packets:
                self._take_model(processor)
                self._begin()
                self._keep(packet)
                yield packet
        finally:
            # what was shown is not lost if the stream ends during the computation
            self._thread.shutdown()
            self._take_model(processor)
            if self._name is not None and self._taught is None:
                complain(f"the stream ended before {self._name} was shown for {self._seconds:g} s")

    def _begin(self) -> None:
        """Begin the lesson of the next name that was typed, unless another one goes on."""
        if self._name is not None:
            return
        try:
            name = self._names.get_nowait()
        except Empty:
            return
        if name in self._model.classes:
            complain(f"{name} is a class already; async-tnt teach --forget leaves one out")
            return
        self._name = name
        self._events = []
        complain(f"{name}: show it for {self._seconds:g} s")

    def _keep(self, packet: Any) -> None:
        """Keep a packet of the lesson. If it is complete, make the model in the thread."""
        if self._name is None or self._taught is not None:
            return
        events = as_events(packet, self._model.config.sensor)
        if not len(events):
            return
        if not self._events:
            self._begin_us = int(events["t"][0])
        self._events.append(events)
        if int(events["t"][-1]) - self._begin_us >= self._length_us:
            lesson = np.concatenate(self._events)
            self._taught = self._thread.submit(self._model.with_class, self._name, [lesson])

    def _take_model(self, processor: Processor[Any]) -> None:
        """Use the taught model from now on, and write its file, if it is ready."""
        if self._taught is None or not self._taught.done() or self._name is None:
            return
        name = self._name
        taught = self._taught
        self._name = None
        self._taught = None
        try:
            model = taught.result()
            processor.exchange(model)
            self._model = model
            model.save(self._out)
        except EXPECTED_ERRORS as error:
            complain(f"{name}: {message_of(error)}")
            return
        for line in lesson_lines(name, model.record["taught"][name]):
            complain(line)
        complain(f"wrote {self._out}: {len(model.classes)} classes")


def typed_names() -> SimpleQueue[str]:
    """The names that are typed on the terminal from now on, a line each.

    Raises
    ------
    ValueError : stdin is no terminal.
    """
    if not sys.stdin.isatty():
        raise ValueError(
            "--teach reads names from a terminal, and stdin is none; record the class and use "
            "async-tnt teach"
        )
    names: SimpleQueue[str] = SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            if line.strip():
                names.put(line.strip())

    threading.Thread(target=read, name="async-tnt names", daemon=True).start()
    return names
