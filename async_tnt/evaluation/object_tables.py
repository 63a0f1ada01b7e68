"""Recordings with a table of the objects that they show.

NAME_objects.csv  a row for each object at a moment: t, in microseconds, class, and x, y, its
                  middle; or x, y, w, h, a box whose upper left corner is (x, y)
NAME_bbox.npy     Prophesee's boxes: t (or ts), x, y, w, h, class_id; of NAME.* or NAME_td.*. Names
                  of the classes are those of `label_map_dictionary.json` beside it or, without
                  that, those of the model, in order
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from async_tnt.base.checks import one_line, parse_json, short
from async_tnt.base.files import open_regular, read_regular, refuse_git_lfs
from async_tnt.sources.files.labelled_recordings import check_once, is_recording
from async_tnt.sources.files.numpy_files import map_npy

CSV, BOXES, OF_BOXES = "_objects.csv", "_bbox.npy", "_td"
NAMES_FILE = "label_map_dictionary.json"
WITHIN_PX = 5.0
"""An object is found within so many pixels of a point, or within a box: in the ellipse that touches
its sides."""


@dataclass(frozen=True)
class ObjectTable:
    """What a recording shows, and when.

    Parameters
    ----------
    t : int64, (N,), in order, in microseconds. label : int64, (N,): a class of the model.
    middle, reach : float64, (N, 2): (x, y) of its middle, in sensor pixels, and how near it counts
        as found.
    unknown : class -> rows that are left out, as the model does not know it.
    """

    t: np.ndarray
    label: np.ndarray
    middle: np.ndarray
    reach: np.ndarray
    unknown: Mapping[str, int]

    def moments(self) -> Iterator[tuple[int, slice]]:
        """Each time that has objects, and their rows."""
        times, first = np.unique(self.t, return_index=True)
        for t, begin, end in zip(times.tolist(), first, [*first[1:], len(self.t)], strict=True):
            yield t, slice(begin, end)


def find_tables(folder: Path) -> list[tuple[Path, Path]]:
    """The recordings of a folder, or of its folder `Test`, and the table beside each.

    Raises
    ------
    ValueError : no recording with a table. OSError : no such folder.
    """
    folder = folder / "Test" if (folder / "Test").is_dir() else folder
    found = []
    for path in sorted(folder.iterdir()):
        tables = (
            path.with_name(path.stem + CSV),
            path.with_name(path.stem.removesuffix(OF_BOXES) + BOXES),
        )
        if is_recording(path) and not path.name.endswith((CSV, BOXES)):
            found += [(path, table) for table in tables if table.is_file()][:1]
    if len({table for _, table in found}) < len(found):
        raise ValueError(
            f"{folder}: recordings that differ in their endings share a table of objects; keep one"
        )
    if not found:
        raise ValueError(
            f"{folder}: no recordings NAME.* with a table of objects, NAME{CSV} or NAME{BOXES}"
        )
    return found


def read_table(path: Path, classes: Sequence[str]) -> ObjectTable:
    """A table, whose classes are those of a model.

    Raises
    ------
    ValueError : it is damaged, lacks a column, or has no row of these classes.
    """
    names, t, corner, size = (
        _read_boxes(path, classes) if path.suffix == ".npy" else _read_csv(path)
    )
    known = {name: k for k, name in enumerate(classes)}
    label = np.array([known.get(name, -1) for name in names], np.int64)
    unknown = {
        str(name): int(n)
        for name, n in zip(*np.unique(names[label < 0], return_counts=True), strict=True)
    }
    kept = np.flatnonzero(label >= 0)
    if not len(kept):
        raise ValueError(f"{path}: no object of the model's classes, {', '.join(classes)}")
    if not (
        np.isfinite([corner[kept], size[kept]]).all() and min(size[kept].min(), t[kept].min()) >= 0
    ):
        raise ValueError(f"{path}: x, y, w and h must be finite, w, h and t at least 0")
    kept = kept[np.argsort(t[kept], kind="stable")]
    is_point = size[kept] == 0
    reach = np.where(is_point.all(1, keepdims=True), WITHIN_PX, np.maximum(size[kept] / 2, 0.5))
    return ObjectTable(t[kept], label[kept], corner[kept] + size[kept] / 2, reach, unknown)


def _read_csv(path: Path) -> tuple[np.ndarray, ...]:
    refuse_git_lfs(path)
    try:
        with TextIOWrapper(open_regular(path), encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            columns, rows = reader.fieldnames or (), list(reader)
    except (ValueError, csv.Error) as error:
        raise ValueError(
            f"{path}: not a table of comma-separated values: {one_line(error)}"
        ) from None
    of_boxes = {"w", "h", "width", "height"}.intersection(name.strip().lower() for name in columns)
    if missing := [
        name
        for name in ("t", "class", "x", "y", *("wh" if of_boxes else ""))
        if name not in columns
    ]:
        raise ValueError(
            f"{path}: needs the columns t, class, x, y (and w, h of boxes), lacks "
            f"{', '.join(missing)}"
        )
    check_once(path, ("t", "class", "x", "y", "w", "h"), columns)
    cells = {
        name: [row[name] for row in rows]
        for name in ("t", "class", "x", "y", *("wh" if of_boxes else ""))
    }
    for name, column in cells.items():
        convert = CSV_TYPES[name]
        for k, text in enumerate(column):
            try:
                column[k] = convert(text)
            except (TypeError, ValueError):  # the first: None, in a row that is too short
                got = f"a row ends before its {name}" if text is None else f"got {short(text)}"
                rule = "t must be whole microseconds, x, y, w and h numbers, each with a class"
                raise ValueError(f"{path}: row {k + 1}: {rule}: {got}") from None
    n = len(rows)
    zeros = [0.0] * n
    corner = np.array([cells["x"], cells["y"]], np.float64).reshape(2, n).T
    size = np.array([cells.get("w", zeros), cells.get("h", zeros)], np.float64).reshape(2, n).T
    return np.array(cells["class"], object), np.array(cells["t"], np.int64), corner, size


def _microseconds(text: str) -> int:
    """A time in a table; a ValueError if it does not fit into int64."""
    if not -(1 << 63) <= int(text) < 1 << 63:
        raise ValueError
    return int(text)


def _class_name(text: str | None) -> str:
    """The name of a class; a TypeError where there is none."""
    if text is None:
        raise TypeError
    return text


CSV_TYPES: Mapping[str, Callable[[Any], Any]] = MappingProxyType(
    {"t": _microseconds, "class": _class_name, "x": float, "y": float, "w": float, "h": float}
)
"""Column of a table -> what makes a value of its text."""


def _read_boxes(path: Path, classes: Sequence[str]) -> tuple[np.ndarray, ...]:
    boxes = map_npy(path)
    try:
        t = _whole(boxes["t" if "t" in (boxes.dtype.names or ()) else "ts"])
        numbers = _whole(boxes["class_id"]).tolist()
        for name in "xywh":
            if boxes[name].ndim != 1 or boxes.dtype[name].kind not in "iuf":
                raise ValueError(f"{name} must be a number, got {boxes.dtype[name]}")
        corner = np.stack([boxes["x"], boxes["y"]], axis=-1).astype(np.float64)
        size = np.stack([boxes["w"], boxes["h"]], axis=-1).astype(np.float64)
    except (ValueError, IndexError, TypeError, AttributeError, EOFError, OverflowError) as error:
        why = one_line(error)
        raise ValueError(
            f"{path}: not a file of boxes with the fields t, x, y, w, h and class_id: {why}"
        ) from None
    named: Mapping[str, str] = dict(zip(map(str, range(len(classes))), classes, strict=True))
    if (names := path.parent / NAMES_FILE).is_file():
        try:
            content = parse_json(read_regular(names))
            if not isinstance(content, dict):
                raise ValueError(f"got {short(content)}")
        except ValueError as error:
            raise ValueError(
                f"{names}: must be an object of class numbers and names, in JSON: {one_line(error)}"
            ) from None
        named = {k: str(name) for k, name in content.items()}
    return np.array([named.get(str(k), str(k)) for k in numbers], object), t, corner, size


def _whole(column: np.ndarray) -> np.ndarray:
    """A column of whole numbers as int64; a ValueError for others, which a conversion would change
    silently."""
    if column.ndim != 1 or column.dtype.kind not in "iuf":
        raise ValueError(
            f"t and class_id must be whole numbers, got {column.dtype} in shape {column.shape}"
        )
    with np.errstate(invalid="ignore"):  # of values that are not finite
        whole = column.astype(np.int64)
    fits = whole == column
    if not fits.all():
        raise ValueError(
            f"t and class_id must be whole numbers in int64, got {column[np.argmin(fits)]}"
        )
    return whole
