"""Made recordings of frames and crosses that move, with tables of their boxes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from made import events_of
from sources.files.written import dat

SENSOR = (64, 48)
CLASSES = ("cross", "frame")
STEP_US = 50_000
"""Time between two moments of a table."""
PLACES = ((16, 13), (47, 13), (16, 35), (47, 35))
BOX_FIELDS = [("t", "i8"), *((name, "f8") for name in "xywh"), ("class_id", "u4")]


class Row(NamedTuple):
    """A box of a table: (x, y) is its upper left corner."""

    t: int
    name: str
    x: float
    y: float
    w: float
    h: float


def shape(rng, kind, size, middle, duration_us):
    """Columns t, x, y, p of a shape: events on its lines, 30 a second and pixel of its border."""
    w, h = size
    n = int(duration_us / 1e6 * 30 * 2 * (w + h))
    t = np.sort(rng.integers(0, duration_us, n))
    along = rng.uniform(-0.5, 0.5, n)
    is_flat = rng.random(n) < 0.5
    # a line of a frame is at the border of the box, one of a cross in its middle
    aside = rng.choice([-0.5, 0.5], n) if kind == "frame" else np.zeros(n)
    x = middle(t)[0] + w * np.where(is_flat, along, aside)
    y = middle(t)[1] + h * np.where(is_flat, aside, along)
    return t, x, y, rng.integers(0, 2, n)


def recording(seed, n_steps=12):
    """The events of one to three shapes and of noise, and the rows of their table."""
    rng = np.random.default_rng(seed)
    duration_us = n_steps * STEP_US
    columns = []
    rows = []
    for k in rng.permutation(len(PLACES))[: rng.integers(1, 4)]:
        kind = CLASSES[rng.integers(2)]
        w, h = rng.uniform(9, 18, 2).round(2)
        speed = rng.uniform(-12, 12, 2)
        start = PLACES[k] + rng.uniform(-2, 2, 2) - speed * duration_us / 2e6

        def middle(t, start=start, speed=speed):
            return start[:, None] + speed[:, None] * np.atleast_1d(t) / 1e6

        columns.append(shape(rng, kind, (w, h), middle, duration_us))
        for t in range(2 * STEP_US, duration_us + 1, STEP_US):
            x, y = middle(t)[:, 0]
            rows.append(Row(t, kind, round(x - w / 2, 2), round(y - h / 2, 2), w, h))
    n = rng.poisson(0.5 * SENSOR[0] * SENSOR[1] * duration_us / 1e6)
    noise = (
        rng.integers(0, duration_us, n),
        rng.integers(0, SENSOR[0], n),
        rng.integers(0, SENSOR[1], n),
        rng.integers(0, 2, n),
    )
    t, x, y, p = [np.concatenate(column) for column in zip(*columns, noise, strict=True)]
    x = np.rint(x).astype(int)
    y = np.rint(y).astype(int)
    is_on = (x >= 0) & (x < SENSOR[0]) & (y >= 0) & (y < SENSOR[1])
    order = np.flatnonzero(is_on)[np.argsort(t[is_on], kind="stable")]
    return events_of(t[order], x[order], y[order], p[order]), sorted(rows)


def write_csv(folder: Path, name: str, events, rows, *, sensor=SENSOR):
    """`NAME.npz` and `NAME_objects.csv`."""
    folder.mkdir(parents=True, exist_ok=True)
    stated = {} if sensor is None else {"sensor": np.array(sensor)}
    np.savez(folder / f"{name}.npz", events=events, **stated)
    lines = ["t,class,x,y,w,h", *(",".join(map(str, row)) for row in rows)]
    (folder / f"{name}_objects.csv").write_text("\n".join(lines) + "\n")


def write_boxes(folder: Path, name: str, events, rows, *, names=True):
    """`NAME_td.dat` and `NAME_bbox.npy`, as Gen1 has them, and which number means which class."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}_td.dat").write_bytes(dat(events, SENSOR))
    boxes = [(t, x, y, w, h, CLASSES.index(kind)) for t, kind, x, y, w, h in rows]
    np.save(folder / f"{name}_bbox.npy", np.array(boxes, [("ts", "i8"), *BOX_FIELDS[1:]]))
    if names:
        labels = json.dumps({str(k): kind for k, kind in enumerate(CLASSES)})
        (folder / "label_map_dictionary.json").write_text(labels)


def write_sequence(folder: Path, events, rows, *, start_us=49_599_300_523, numbers=(2, 7)):
    """A sequence of DSEC-Detection, whose times are those of its clock. Needs h5py."""
    import h5py

    for part in ("events/left", "object_detections/left"):
        (folder / part).mkdir(parents=True)
    with h5py.File(folder / "events/left/events.h5", "w") as file:
        file["events/t"] = events["t"].astype("u4")
        for name, dtype in (("x", "u2"), ("y", "u2"), ("p", "u1")):
            file[f"events/{name}"] = events[name].astype(dtype)
        file["t_offset"] = start_us
    tracks = [
        (start_us + t, x, y, w, h, numbers[CLASSES.index(kind)]) for t, kind, x, y, w, h in rows
    ]
    np.save(folder / "object_detections/left/tracks.npy", np.array(tracks, BOX_FIELDS))


def write_set(folder: Path, n: int, *, seed: int = 0) -> Path:
    """So many recordings with tables of comma-separated values."""
    for k in range(n):
        write_csv(folder, f"r{k:02}", *recording((seed, k)))
    return folder
