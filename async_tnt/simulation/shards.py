"""A shard: many recordings in one .safetensors file.

With N events in R recordings, all of which last `duration_us`:

    t              int32    (N,)       time since the recording's start, us; 0 <= t < duration_us
    x, y           uint8    (N,)       pixel; uint16 where the sensor is wider or higher than 256
    p              uint8    (N,)       1 = ON, 0 = OFF
    offsets        int64    (R + 1,)   recording i is events offsets[i] to offsets[i + 1]; in order of time
    labels         uint8    (R,)       class
    image          int32    (R,)       index of the image in its data set, from 0
    flow           float32  (R, K, 2)  optical flow (vx, vy) of the whole image, px/s, at each of
    flow_times_us  int64    (K,)       these times; K = 1 where the flow is constant

and one metadata entry, `shard`: JSON with `format`, `version`, `sensor` [width, height], `duration_us` and
more: the motion, the seed, the simulator's parameters.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from async_tnt.checks import plain_array
from async_tnt.events import EVENT_DTYPE, structured
from async_tnt.files import replacing

FORMAT = "async_tnt.shard"
VERSION = 1
COLUMNS = ("t", "x", "y", "p", "offsets", "labels", "image", "flow", "flow_times_us")


@dataclass(frozen=True, eq=False)
class Shard:
    """Recordings of one file. Made by `open_shard`; the arrays are read-only.

    Attributes
    ----------
    path : the file.
    t, x, y, p, offsets, labels, image, flow, flow_times_us : the columns; see the module's docstring.
    metadata : `sensor`, `duration_us`, `motion` and more.
    """

    path: Path
    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    p: np.ndarray
    offsets: np.ndarray
    labels: np.ndarray
    image: np.ndarray
    flow: np.ndarray
    flow_times_us: np.ndarray
    metadata: dict[str, Any]

    def __len__(self) -> int:
        """Recordings in the shard."""
        return len(self.labels)

    def __repr__(self) -> str:
        return f"Shard({str(self.path)!r}, {len(self)} recordings, {self.n_events} events)"

    @property
    def n_events(self) -> int:
        """Events of all recordings together."""
        return len(self.t)

    @property
    def sensor(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        width, height = self.metadata["sensor"]
        return width, height

    @property
    def duration_us(self) -> int:
        """How long each recording lasts, in microseconds."""
        return self.metadata["duration_us"]

    def columns(self, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Columns (t, x, y, p) of recording `i`, without a copy.

        Raises
        ------
        IndexError : no such recording. Negative indices count from the end.
        """
        if not -len(self) <= i < len(self):
            raise IndexError(f"recording must be in [{-len(self)}, {len(self)}), got {i}: {self.path}")
        i %= len(self)
        some = slice(int(self.offsets[i]), int(self.offsets[i + 1]))
        return self.t[some], self.x[some], self.y[some], self.p[some]

    def recording(self, i: int) -> np.ndarray:
        """Events of recording `i`: a structured array of `EVENT_DTYPE`, the caller's to change.

        Raises
        ------
        IndexError : no such recording. Negative indices count from the end.
        """
        return structured(self.columns(i))


def write_shard(
    path: str | os.PathLike[str],
    recordings: Sequence[np.ndarray],
    *,
    labels: np.ndarray,
    image: np.ndarray,
    flow: np.ndarray,
    flow_times_us: np.ndarray,
    sensor: tuple[int, int],
    duration_us: int,
    metadata: Mapping[str, Any] | None = None,
) -> Path:
    """Write recordings to a shard; the same arguments give the same bytes.

    An existing file is replaced at once when the new one is complete; it stays if that fails.

    Parameters
    ----------
    path : the .safetensors file.
    recordings : R structured arrays of `EVENT_DTYPE`, each in order of time, times from 0.
    labels, image : R integers each.
    flow : shape (R, K, 2), px/s.
    flow_times_us : shape (K,), the times of the flow.
    sensor : (width, height).
    duration_us : events lie in [0, duration_us).
    metadata : more to keep, as JSON.

    Raises
    ------
    ValueError : a value breaks the format's rules; nothing is written then.
    OSError : the file cannot be written.
    """
    path = Path(path)
    about = {**(metadata or {}), "format": FORMAT, "version": VERSION}
    about |= {"sensor": [int(n) for n in sensor], "duration_us": int(duration_us)}
    types = _column_types(about)
    events = np.concatenate([np.empty(0, EVENT_DTYPE), *recordings])
    given = {
        **{name: events[name] for name in "txyp"},
        "offsets": np.cumsum([0, *(len(events) for events in recordings)]),
        "labels": labels,
        "image": image,
        "flow": flow,
        "flow_times_us": flow_times_us,
    }
    columns = {name: _as_type(name, given[name], types[name]) for name in COLUMNS}
    _check_columns(columns, about)
    content = save(columns, metadata={"shard": json.dumps(about)})
    with replacing(path) as part:
        part.write_bytes(content)
    return path


def open_shard(path: str | os.PathLike[str]) -> Shard:
    """Read the shard at `path` and check every value against the format's rules.

    Raises
    ------
    ValueError : damaged, or not a shard of this version; the message names the file and what is wrong.
    OSError : missing or not readable.
    """
    path = Path(path)
    try:
        with safe_open(path, framework="numpy") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (it is not iterable)
            strings = file.metadata() or {}
        metadata = _parsed_metadata(strings)
        types = _column_types(metadata)
        if set(tensors) != set(COLUMNS):
            raise ValueError(f"must hold {', '.join(COLUMNS)}, got {', '.join(sorted(tensors)) or 'nothing'}")
        for name, column in tensors.items():
            if column.dtype != types[name]:
                raise ValueError(f"`{name}` must be {types[name]}, got {column.dtype}")
        _check_columns(tensors, metadata)
    except (SafetensorError, ValueError, TypeError, AttributeError) as error:  # the latter two: a type NumPy lacks
        raise ValueError(f"{path}: not a shard, or a damaged one: {error}") from None
    for column in tensors.values():
        column.flags.writeable = False
    return Shard(path, **tensors, metadata=metadata)


def _parsed_metadata(strings: Mapping[str, str]) -> dict[str, Any]:
    if "shard" not in strings:
        raise ValueError("no `shard` in its metadata")
    try:
        metadata = json.loads(strings["shard"])
    except (ValueError, RecursionError) as error:
        raise ValueError(f"its metadata is not JSON: {error}") from None
    if not isinstance(metadata, dict) or metadata.get("format") != FORMAT:
        raise ValueError(f"its metadata must have the format {FORMAT!r}")
    if metadata.get("version") != VERSION:
        raise ValueError(f"this release reads version {VERSION} of the format, got {metadata.get('version')!r}")
    return metadata


def _column_types(metadata: Mapping[str, Any]) -> dict[str, np.dtype]:
    """Type of each column, from the sensor."""
    sensor, duration_us = metadata.get("sensor"), metadata.get("duration_us")
    if not (isinstance(sensor, list) and len(sensor) == 2 and all(type(n) is int and 0 < n <= 1 << 16 for n in sensor)):
        raise ValueError(f"`sensor` must be a width and a height in 1-65536, got {sensor!r}")
    if not (type(duration_us) is int and 0 < duration_us < 1 << 31):
        raise ValueError(f"`duration_us` must be a whole number in [1, 2^31), got {duration_us!r}")
    pixel = "u1" if max(sensor) <= 256 else "u2"
    codes = ("i4", pixel, pixel, "u1", "i8", "u1", "i4", "f4", "i8")
    return {name: np.dtype(code) for name, code in zip(COLUMNS, codes, strict=True)}


def _as_type(name: str, values: Any, dtype: np.dtype) -> np.ndarray:
    """The values in the column's type; refuses those it cannot hold."""
    array = plain_array(name, values)
    if dtype.kind != "f" and array.size:
        if array.dtype.kind not in "iub":
            raise ValueError(f"`{name}` must be whole numbers, got {array.dtype}")
        limits = np.iinfo(dtype)
        if array.min() < limits.min or array.max() > limits.max:
            raise ValueError(f"`{name}` must be in [{limits.min}, {limits.max}], got {array.min()} to {array.max()}")
    with np.errstate(over="ignore"):  # becomes inf, which the check refuses
        return np.ascontiguousarray(array, dtype)


def _check_columns(columns: Mapping[str, np.ndarray], metadata: Mapping[str, Any]) -> None:
    """The format's rules, for writer and reader alike."""
    t, offsets, times = columns["t"], columns["offsets"], columns["flow_times_us"]
    n_events, n_recordings, n_times = t.size, columns["labels"].size, times.size
    expected = {
        **dict.fromkeys("txyp", (n_events,)),
        "offsets": (n_recordings + 1,),
        "labels": (n_recordings,),
        "image": (n_recordings,),
        "flow": (n_recordings, n_times, 2),
        "flow_times_us": (n_times,),
    }
    for name, shape in expected.items():
        if columns[name].shape != shape:
            raise ValueError(f"`{name}` must have shape {shape}, got {columns[name].shape}")
    if offsets[0] != 0 or offsets[-1] != n_events or (offsets[1:] < offsets[:-1]).any():
        raise ValueError(f"`offsets` must rise from 0 to {n_events}, the number of events")
    (width, height), duration_us = metadata["sensor"], metadata["duration_us"]
    for name, limit in (("t", duration_us), ("x", width), ("y", height), ("p", 2)):
        _check_range(name, columns[name], limit)
    falls = np.flatnonzero(t[1:] < t[:-1]) + 1
    if not np.isin(falls, offsets).all():
        i = int(falls[~np.isin(falls, offsets)][0])
        raise ValueError(f"`t` must not decrease within a recording, got {t[i]} after {t[i - 1]} at event {i}")
    _check_range("image", columns["image"], 1 << 31)
    _check_range("flow_times_us", times, duration_us + 1)
    if n_times == 0 or (times[1:] <= times[:-1]).any():
        raise ValueError("`flow_times_us` must hold at least one time, each later than the one before")
    if not np.isfinite(columns["flow"]).all():
        raise ValueError("`flow` must be finite")


def _check_range(name: str, values: np.ndarray, limit: int) -> None:
    if values.size and (values.min() < 0 or values.max() >= limit):
        i = int(np.argmax((values < 0) | (values >= limit)))
        raise ValueError(f"`{name}` must be in [0, {limit}), got {values[i]} at {i}")
