"""Labelled recordings as four long columns with offsets, in memory or mapped from files.

The operating system reads mapped columns page by page, when a window needs them, and keeps as many
pages as fit. So a data set may be larger than the memory.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.files import naming
from async_tnt.volume.events import ANY_SENSOR, as_events

COLUMNS = {"t": np.int32, "x": np.uint16, "y": np.uint16, "p": np.uint8}
"""Name of a column -> its type."""

BLOCK = 1 << 22
"""Number of events that are copied at a time."""


BOX_DTYPE = np.dtype(
    [("recording", np.int64), ("label", np.int64), ("middle", "2f8"), ("size", "2f8")]
)
"""A box: the recording that shows it, the class of its object, (x, y) of its middle, and its width
and height, in sensor pixels."""


@dataclass(frozen=True)
class Recordings:
    """R recordings, one after the other.

    Parameters
    ----------
    t : int32, shape (E,), microseconds since the recording's start, never decreasing within a
        recording.
    x, y : uint16, shape (E,).
    p : uint8, shape (E,), 0 or 1.
    offsets : int64, shape (R + 1,). Recording r has the events `offsets[r] <= i < offsets[r + 1]`.
    labels : int64, shape (R,).
    names : R names, such as file paths relative to their folder.
    outlines : float32, (R, M, P, 2): P points (x, y) on the outline of each recording's object, at
        M moments from 0 to `outlined_us`, evenly spread. nan: the outline of this recording is not
        known. None: no outline is known.
    outlined_us : int64, (R,), microseconds; None without outlines.
    boxes : structured array of `BOX_DTYPE`, ordered by recording: what each recording shows at its
        end, if recordings are windows whose objects are known. The label of a recording is then
        that of one of its boxes. None: each recording shows one object of its class.
    """

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    p: np.ndarray
    offsets: np.ndarray
    labels: np.ndarray
    names: tuple[str, ...]
    outlines: np.ndarray | None = None
    outlined_us: np.ndarray | None = None
    boxes: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.labels)

    def boxes_of(self, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The boxes of N recordings with the numbers `which`, which may repeat.

        Returns, for each box, the place of its recording in `which`, int64, (K,); and the boxes.
        """
        assert self.boxes is not None
        first = np.searchsorted(self.boxes["recording"], which)
        n = np.searchsorted(self.boxes["recording"], which, side="right") - first
        places = np.repeat(np.arange(len(which)), n)
        within = np.arange(len(places)) - np.repeat(np.cumsum(n) - n, n)
        return places, self.boxes[first[places] + within]

    @cached_property
    def middles(self) -> np.ndarray:
        """The point (x, y) halfway between each recording's outermost events: float64, (R, 2)."""
        middles = np.zeros((len(self), 2))
        with_events = np.flatnonzero(np.diff(self.offsets))  # `reduceat` takes no empty slice
        if not len(with_events):
            return middles
        firsts = self.offsets[with_events]
        for axis, column in enumerate((self.x, self.y)):
            least = np.minimum.reduceat(column, firsts)
            most = np.maximum.reduceat(column, firsts)
            middles[with_events, axis] = (least.astype(np.float64) + most) / 2
        return middles

    def __add__(self, other: Recordings) -> Recordings:
        columns = {}
        for name in (*COLUMNS, "labels"):
            columns[name] = np.concatenate([getattr(self, name), getattr(other, name)])
        offsets = np.concatenate([self.offsets, self.offsets[-1] + other.offsets[1:]])
        if self.outlines is not None or other.outlines is not None:
            raise ValueError("recordings with outlines cannot be added")
        if self.boxes is not None or other.boxes is not None:
            raise ValueError("recordings with boxes cannot be added")
        return Recordings(**columns, offsets=offsets, names=self.names + other.names)

    @classmethod
    def from_events(
        cls,
        events: Iterable[np.ndarray],
        labels: Sequence[int] | np.ndarray,
        names: Sequence[str] | None = None,
    ) -> Recordings:
        """Make recordings of events in memory.

        Parameters
        ----------
        events : the events of each recording, in any accepted form, see `event_forms`.
        labels : a label for each recording.
        names : a name for each recording; by default its number.

        Raises
        ------
        TypeError, ValueError : the events have no accepted form; the lengths of the arguments
            differ; or as `RecordingsWriter.add`.
        """
        if names is None:
            names = [str(i) for i in range(len(labels))]
        if len(labels) != len(names):
            raise ParameterValueError(
                "labels", "must have one per recording", f"{len(labels)} for {len(names)}"
            )
        with RecordingsWriter() as writer:
            for recording, label, name in zip(events, labels, names, strict=True):
                writer.add(as_events(recording, ANY_SENSOR), int(label), name)
            return writer.finish()


class RecordingsWriter(contextlib.AbstractContextManager["RecordingsWriter"]):
    """A context manager that appends recordings, one at a time, to the columns of `Recordings`.

    Parameters
    ----------
    folder : the folder where the columns are written to files, 9 bytes an event. The files are
        mapped into memory. They have no names. So they vanish when the program ends, even if it
        crashes. None: the columns are in memory.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._files: dict[str, Any] = {}
        for name in COLUMNS:
            if folder is None:
                self._files[name] = io.BytesIO()
            else:
                self._files[name] = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
        self._folder = folder or Path()
        self._offsets = [0]
        self._labels: list[int] = []
        self._names: list[str] = []
        self._outlines: list[np.ndarray | None] = []
        self._outlined_us: list[int] = []

    def __exit__(self, *_: object) -> None:
        for file in self._files.values():
            # BufferError: a column of the recordings still uses the memory. OSError: the disk is
            # full, which `add` has already reported.
            with contextlib.suppress(BufferError, OSError):
                file.close()

    def add(
        self,
        events: np.ndarray,
        label: int,
        name: str,
        outline: np.ndarray | None = None,
        outlined_us: int = 0,
    ) -> None:
        """Append a recording.

        Parameters
        ----------
        events : structured array of `EVENT_DTYPE`.
        label : index of its class.
        name : its name in messages and reports.
        outline, outlined_us : its row of `Recordings.outlines`, and the time of that row's last
            moment; None: not known.

        Raises
        ------
        ValueError : times decrease or do not fit 31 bits (35 minutes).
        OSError : the disk is full.
        """
        t = events["t"]
        if len(t) and not (t[0] >= 0 and t[-1] < 1 << 31 and (np.diff(t) >= 0).all()):
            raise ValueError(
                f"{name}: times must be in order and in [0, 2**31) us, got {t[0]} to {t[-1]}"
            )
        with naming(self._folder):
            for field, dtype in COLUMNS.items():
                self._files[field].write(events[field].astype(dtype).tobytes())
        self._offsets.append(self._offsets[-1] + len(t))
        self._labels.append(label)
        self._names.append(name)
        self._outlines.append(outline)
        self._outlined_us.append(outlined_us)

    def extend(self, recordings: Recordings) -> None:
        """Append all recordings of `recordings`.

        Raises
        ------
        ValueError : they have boxes.
        OSError : the disk is full.
        """
        if recordings.boxes is not None:
            raise ValueError("recordings with boxes cannot be added")
        with naming(self._folder):
            for field in COLUMNS:
                column = getattr(recordings, field)
                for first in range(0, len(column), BLOCK):
                    self._files[field].write(column[first : first + BLOCK].tobytes())
        self._offsets += (self._offsets[-1] + recordings.offsets[1:]).tolist()
        self._labels += recordings.labels.tolist()
        self._names += recordings.names
        if recordings.outlines is not None and recordings.outlined_us is not None:
            self._outlines += list(recordings.outlines)
            self._outlined_us += recordings.outlined_us.tolist()
        else:
            self._outlines += [None] * len(recordings)
            self._outlined_us += [0] * len(recordings)

    def finish(self) -> Recordings:
        """All recordings that were added. Call this once, after the last recording.

        Mapped columns remain usable after the files are closed.
        """
        columns = {name: self._column(file, COLUMNS[name]) for name, file in self._files.items()}
        offsets = np.array(self._offsets, np.int64)
        outlines = self._all_outlines()
        return Recordings(
            **columns,
            offsets=offsets,
            labels=np.array(self._labels, np.int64),
            names=tuple(self._names),
            outlines=outlines,
            outlined_us=None if outlines is None else np.array(self._outlined_us, np.int64),
        )

    def _all_outlines(self) -> np.ndarray | None:
        """The outlines of all recordings; None if none is known."""
        shape = next((outline.shape for outline in self._outlines if outline is not None), None)
        if shape is None:
            return None
        outlines = np.full((len(self._outlines), *shape), np.nan, np.float32)
        for k, outline in enumerate(self._outlines):
            if outline is not None:
                outlines[k] = outline
        return outlines

    def _column(self, file: Any, dtype: type) -> np.ndarray:
        """The column that was written into a file."""
        n = self._offsets[-1]
        if isinstance(file, io.BytesIO):
            return np.frombuffer(file.getbuffer(), dtype)
        with naming(self._folder):
            file.flush()
        if not n:  # an empty file cannot be mapped
            return np.empty(0, dtype)
        # the kernels are compiled for writable, plain arrays
        return np.asarray(np.memmap(file, dtype, "r+", shape=n))
