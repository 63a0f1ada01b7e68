"""A shard: many recordings in one .safetensors file.

With N events in R recordings, all of which last `duration_us`:

    t              int32    (N,)       time since the recording's start, us; 0 <= t < duration_us
    x, y           uint8    (N,)       pixel
    p              uint8    (N,)       1 = ON, 0 = OFF
    offsets        int64    (R + 1,)   recording i is events offsets[i] to offsets[i + 1], which are
                                       in order of time
    labels         uint8    (R,)       class
    image          int32    (R,)       index of the image in its data set, from 0
    flow           float32  (R, K, 2)  optical flow (vx, vy) of the whole image, px/s, to the right
                                       and downwards, at the times of flow_times_us
    flow_times_us  int64    (K,)       times of the flow, us; K = 1 if the flow is constant

The file has one metadata entry, `shard`. It is JSON with `sensor` [width, height], `duration_us`
and more: the motion, the seed, the simulator's parameters.
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

from async_tnt import EVENT_DTYPE
from async_tnt.base.files import replacing
from async_tnt.volume.events import structured

COLUMNS = {
    "t": "i4",
    "x": "u1",
    "y": "u1",
    "p": "u1",
    "offsets": "i8",
    "labels": "u1",
    "image": "i4",
    "flow": "f4",
    "flow_times_us": "i8",
}
"""Column -> its type."""


@dataclass(frozen=True, eq=False)
class Shard:
    """The columns of one file, which are read-only, and its metadata. Made by `open_shard`."""

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
        """The number of recordings in the shard."""
        return len(self.labels)

    def recording(self, i: int) -> np.ndarray:
        """The events of recording `i`: a new structured array, which the caller may change."""
        events = slice(int(self.offsets[i]), int(self.offsets[i + 1]))
        return structured([self.t[events], self.x[events], self.y[events], self.p[events]])


def write_shard(
    path: Path,
    recordings: Sequence[np.ndarray],
    *,
    labels: np.ndarray,
    image: np.ndarray,
    flow: np.ndarray,
    flow_times_us: np.ndarray,
    sensor: tuple[int, int],
    duration_us: int,
    metadata: Mapping[str, Any],
) -> None:
    """Write a shard of recordings. The same arguments give the same bytes.

    Parameters
    ----------
    recordings : structured arrays of `EVENT_DTYPE`.
    labels, image, flow, flow_times_us, sensor, duration_us : see the module's docstring.
    metadata : more entries of the JSON.

    Raises
    ------
    ValueError : a value breaks the format's rules. Then nothing is written.
    """
    shard_metadata = {
        **metadata,
        "sensor": [int(n) for n in sensor],
        "duration_us": int(duration_us),
    }
    events = np.concatenate([np.empty(0, EVENT_DTYPE), *recordings])
    values = {
        **{name: events[name] for name in "txyp"},
        "offsets": np.cumsum([0, *(len(events) for events in recordings)]),
        "labels": labels,
        "image": image,
        "flow": flow,
        "flow_times_us": flow_times_us,
    }
    columns = {}
    for name, dtype in COLUMNS.items():
        columns[name] = np.asarray(values[name]).astype(dtype)
        if name != "flow" and not np.array_equal(columns[name], values[name]):
            raise ValueError(f"`{name}` must hold whole numbers that fit in {np.dtype(dtype)}")
    _check(columns, shard_metadata)
    content = save(columns, metadata={"shard": json.dumps(shard_metadata)})
    with replacing(path) as part:
        part.write_bytes(content)


def open_shard(path: str | os.PathLike[str]) -> Shard:
    """Read a shard and check every value against the format's rules.

    Raises
    ------
    ValueError : the file is damaged, or not a shard. The message names the file and what is wrong.
    """
    path = Path(path)
    try:
        with safe_open(path, framework="numpy") as file:
            columns = {name: file.get_tensor(name) for name in COLUMNS}
            metadata = json.loads((file.metadata() or {})["shard"])
        for name, dtype in COLUMNS.items():
            if columns[name].dtype != np.dtype(dtype):
                raise ValueError(f"`{name}` must be {np.dtype(dtype)}, got {columns[name].dtype}")
        _check(columns, metadata)
    except (
        SafetensorError,
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        RecursionError,
    ) as error:
        raise ValueError(f"{path}: not a shard, or a damaged one: {error}") from None
    for column in columns.values():
        column.flags.writeable = False
    return Shard(path, **columns, metadata=metadata)


def _check(columns: Mapping[str, np.ndarray], metadata: Mapping[str, Any]) -> None:
    """Check the format's rules, when a shard is written and when it is read."""
    t = columns["t"]
    offsets = columns["offsets"]
    times = columns["flow_times_us"]
    n_recordings = columns["labels"].size
    expected = {
        **dict.fromkeys("txyp", (t.size,)),
        "offsets": (n_recordings + 1,),
        "labels": (n_recordings,),
        "image": (n_recordings,),
        "flow": (n_recordings, times.size, 2),
        "flow_times_us": (times.size,),
    }
    for name, shape in expected.items():
        if columns[name].shape != shape:
            raise ValueError(f"`{name}` must have shape {shape}, got {columns[name].shape}")
    if offsets[0] != 0 or offsets[-1] != t.size or (offsets[1:] < offsets[:-1]).any():
        raise ValueError(f"`offsets` must rise from 0 to {t.size}, the number of events")
    width, height = metadata["sensor"]
    duration_us = metadata["duration_us"]
    limits = {
        "t": duration_us,
        "x": width,
        "y": height,
        "p": 2,
        "image": 1 << 31,
        "flow_times_us": duration_us + 1,
    }
    for name, limit in limits.items():
        values = columns[name]
        if values.size and (values.min() < 0 or values.max() >= limit):
            raise ValueError(
                f"`{name}` must be in [0, {limit}), got {values.min()} to {values.max()}"
            )
    # time may fall from one recording to the next only
    falls = np.flatnonzero(t[1:] < t[:-1]) + 1
    if not np.isin(falls, offsets).all():
        raise ValueError("`t` must not decrease within a recording")
    if not np.isfinite(columns["flow"]).all():
        raise ValueError("`flow` must be finite")
