"""Write a stream to DAT files from which every reader gets the times that were written."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from async_tnt.base.files import naming
from async_tnt.sources.files.prophesee import (
    DAT_EVENT_BYTES,
    DAT_PERIOD_US,
    dat_header,
    dat_records,
)
from async_tnt.volume.sensor import Sensor

LONGEST_STEP_US = DAT_PERIOD_US // 2 - 1
"""Longest step in microseconds from an event to the next event, forward or back. Readers would take
a longer step for a wrap of the clock."""


@dataclass
class DatFile:
    """A DAT file that was written."""

    path: Path
    first_us: int
    """The time of the stream at which the file's times begin."""
    events: int = 0
    """Number of events in the file."""
    on: int = 0
    """Number of events in the file that have polarity 1."""


class DatWriter(contextlib.AbstractContextManager["DatWriter"]):
    """A stream that is written to DAT files, one after the other.

    The end of a `with` block completes the last file.

    DAT's times have 32 bits. An event begins a new file if its time could not be read back. Such a
    time is before the first time of the file, or 71.6 minutes or more after the first time, or 35.8
    minutes or more before or after the previous event.

    When `write` returns, the events are in the file, whatever ends the process. No file that holds
    an event is deleted.

    Parameters
    ----------
    sensor : (width, height) in pixels, of at most `DAT_SIDE`.
    create : function that opens a new, unbuffered file; called for each file. The first file is
        made when the first event comes.
    completed : called with each file that holds events, once it is closed.

    Attributes
    ----------
    n_events : events written to all files.
    """

    def __init__(
        self,
        sensor: Sensor,
        create: Callable[[], io.FileIO],
        completed: Callable[[DatFile], None] = lambda file: None,
    ) -> None:
        self._header = dat_header(sensor)
        self._create = create
        self._completed = completed
        self._file: io.FileIO | None = None
        self._description = DatFile(Path(), 0)
        self._previous_us = 0
        self.n_events = 0

    def write(self, events: np.ndarray) -> None:
        """Write events of `EVENT_DTYPE`, with x and y on the sensor, in their order.

        Raises
        ------
        OSError : the disk is full, for example. The events that fit are kept.
        """
        while len(events):
            n_fitting = self._n_fitting(events["t"])
            if n_fitting == 0:
                self._begin(events["t"])
            else:
                self._append(events[:n_fitting])
                events = events[n_fitting:]

    def close(self) -> None:
        """Complete the file in progress; the next event begins another. May be called again."""
        if self._file is None:
            return
        file = self._file
        self._file = None
        # An error may have left a part of an event at the end.
        n_torn_bytes = (os.fstat(file.fileno()).st_size - len(self._header)) % DAT_EVENT_BYTES
        with contextlib.suppress(OSError), file:
            file.truncate(os.fstat(file.fileno()).st_size - n_torn_bytes)
        if self._description.events:
            self._completed(self._description)
        else:
            self._description.path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _n_fitting(self, t_us: np.ndarray) -> int:
        """The number of these times, from the first on, that the file in progress can hold."""
        if self._file is None:
            return 0
        since_first = t_us - self._description.first_us
        step = np.diff(t_us, prepend=self._previous_us)
        is_unfit = (
            (since_first < 0) | (since_first >= DAT_PERIOD_US) | (np.abs(step) > LONGEST_STEP_US)
        )
        return int(is_unfit.argmax()) if is_unfit.any() else len(t_us)

    def _begin(self, t_us: np.ndarray) -> None:
        """Begin a new file, which can hold the first of these times."""
        self.close()
        self._file = self._create()
        # A packet may be out of order: the file's times begin with the earliest time that lies near
        # the first one.
        near_us = t_us[np.abs(t_us - t_us[0]) <= LONGEST_STEP_US]
        self._description = DatFile(Path(self._file.name), int(near_us.min()))
        self._previous_us = int(t_us[0])
        self._write(self._header)

    def _append(self, events: np.ndarray) -> None:
        """Write events that fit, and count the events that are whole in the file.

        They are counted also after an error.
        """
        description = self._description
        try:
            self._write(dat_records(events, description.first_us))
        finally:
            assert self._file is not None  # for mypy: it was written to
            n_in_file = (self._file.tell() - len(self._header)) // DAT_EVENT_BYTES
            whole_events = events[: max(0, n_in_file - description.events)]
            if len(whole_events):
                description.events += len(whole_events)
                description.on += int(whole_events["p"].sum())
                self.n_events += len(whole_events)
                self._previous_us = int(whole_events["t"][-1])

    def _write(self, data: bytes) -> None:
        """Write all bytes; an unbuffered file may take a part of them."""
        assert self._file is not None  # for mypy
        remaining = memoryview(data)
        with naming(self._description.path):
            while remaining:
                remaining = remaining[self._file.write(remaining) :]
