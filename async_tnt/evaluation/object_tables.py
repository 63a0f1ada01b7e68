"""Tables of the objects that recordings show.

A table is a file beside the recording NAME.*, or, of DSEC-Detection, in a folder beside that of the
recording.

NAME_objects.csv  A row for each object at a moment. The columns are t, in microseconds, class, and
                  x, y, the object's middle. With the columns w, h, the row is a box, and (x, y) is
                  its upper left corner.
NAME_bbox.npy     Prophesee's boxes, with the fields t (or ts), x, y, w, h, class_id. The file may
                  also belong to a recording NAME_td.*. The file `label_map_dictionary.json` beside
                  it names the classes. Without that file, class_id k is the model's class k. eTraM
                  has such files, too.
tracks.npy        DSEC-Detection's boxes, with the same fields, in object_detections/left of the
                  sequence's folder. The recording is events/left/events.h5 there. Boxes and events
                  have the times of DSEC's clock. Class numbers are those of `DSEC_CLASSES`.

References
----------
- Gehrig, Scaramuzza 2024, Low-latency automotive vision with event cameras,
  doi:10.1038/s41586-024-07409-w; the format: https://github.com/uzh-rpg/dsec-det
- Verma et al. 2024, eTraM: event-based traffic monitoring dataset, arXiv:2403.19976
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

from async_tnt.base.files import open_regular, read_regular, refuse_git_lfs
from async_tnt.base.json_text import parse_json
from async_tnt.base.messages import one_line, short
from async_tnt.sources.files.labelled_recordings import check_once, is_recording
from async_tnt.sources.files.numpy_files import map_npy

CSV = "_objects.csv"
"""The end of the name of a table of comma-separated values."""
BOXES = "_bbox.npy"
"""The end of the name of a file of Prophesee's boxes."""
RECORDING_END = "_td"
"""The end of a recording's stem that its file of boxes does not have. The boxes of a_td.dat are in
a_bbox.npy."""
TRACKS = Path("object_detections/left/tracks.npy")
"""The boxes of a sequence of DSEC-Detection, in the sequence's folder."""
DSEC_EVENTS = Path("events/left/events.h5")
"""The events of a sequence of DSEC, in the sequence's folder."""
DSEC_CLASSES = (
    "pedestrian",
    "rider",
    "car",
    "bus",
    "truck",
    "bicycle",
    "motorcycle",
    "train",
)
"""The classes of DSEC-Detection, by their numbers."""
NAMES_FILE = "label_map_dictionary.json"
"""The file that names the classes of Prophesee's boxes. It lies beside them."""
POINT_REACH_PX = 5.0
"""The reach, in pixels, of an object that the table gives as a point. The reach of a box is the
ellipse that touches the box's sides."""


@dataclass(frozen=True)
class ObjectTable:
    """The objects that a recording shows, and when.

    Parameters
    ----------
    t : int64, (N,): times in microseconds, in increasing order.
    label : int64, (N,): the object's class, as an index of the model's classes.
    middle : float64, (N, 2): (x, y) of the object's middle, in sensor pixels.
    reach : float64, (N, 2): how far from the middle, in x and in y, the object counts as found.
    size : float64, (N, 2): the (width, height) of the object's box, or (0, 0) for a point.
    unknown : class that the model does not know -> number of its rows, which are left out.
    """

    t: np.ndarray
    label: np.ndarray
    middle: np.ndarray
    reach: np.ndarray
    size: np.ndarray
    unknown: Mapping[str, int]

    def moments(self) -> Iterator[tuple[int, slice]]:
        """Yield each time at which there are objects, and the rows of these objects."""
        times, first_rows = np.unique(self.t, return_index=True)
        for t, begin, end in zip(
            times.tolist(), first_rows, [*first_rows[1:], len(self.t)], strict=True
        ):
            yield t, slice(begin, end)


def part_folder(folder: Path, part: str) -> Path:
    """The folder of a part of a data set, such as `folder/test`; without it, `folder` itself.

    Capital letters do not matter: Prophesee's sets and DSEC write it small.

    Raises
    ------
    OSError : the folder does not exist.
    """
    for path in sorted(folder.iterdir()):
        if path.name.lower() == part.lower() and path.is_dir():
            return path
    return folder


def find_tables(folder: Path, part: str = "test") -> list[tuple[Path, Path]]:
    """The recordings of a folder that have a table, as pairs (recording, table).

    The folder may also be a sequence of DSEC-Detection, or hold sequences.

    Parameters
    ----------
    folder : holds the recordings and their tables.
    part : if the folder has a folder of this name, the recordings are looked for in there.

    Raises
    ------
    ValueError : the folder has no recording with a table, or two recordings share a table.
    OSError : the folder does not exist.
    """
    folder = part_folder(folder, part)
    pairs = _pairs_in(folder)
    if len({table for _, table in pairs}) < len(pairs):
        raise ValueError(
            f"{folder}: recordings that differ in their endings share a table of objects; keep one"
        )
    if not pairs:
        raise ValueError(
            f"{folder}: no recordings NAME.* with a table of objects, NAME{CSV} or NAME{BOXES}, "
            f"and no sequences with {TRACKS.as_posix()}"
        )
    return pairs


def has_tables(folder: Path, part: str = "test") -> bool:
    """Whether `find_tables` would find a recording with a table.

    False if the folder does not exist.
    """
    return folder.is_dir() and len(_pairs_in(part_folder(folder, part))) > 0


def _pairs_in(folder: Path) -> list[tuple[Path, Path]]:
    """The recordings in a folder that have a table, and their tables."""
    pairs = _sequences_of_dsec(folder)
    for path in sorted(folder.iterdir()):
        if not is_recording(path) or path.name.endswith((CSV, BOXES)):
            continue
        csv_table = path.with_name(path.stem + CSV)
        boxes = path.with_name(path.stem.removesuffix(RECORDING_END) + BOXES)
        if csv_table.is_file():
            pairs.append((path, csv_table))
        elif boxes.is_file():
            pairs.append((path, boxes))
    return pairs


def _sequences_of_dsec(folder: Path) -> list[tuple[Path, Path]]:
    """The recordings and tables of sequences of DSEC-Detection."""
    sequences = [folder, *sorted(path for path in folder.iterdir() if path.is_dir())]
    return [
        (sequence / DSEC_EVENTS, sequence / TRACKS)
        for sequence in sequences
        if (sequence / TRACKS).is_file() and (sequence / DSEC_EVENTS).is_file()
    ]


@dataclass(frozen=True)
class _Rows:
    """The rows of a table as they stand in its file.

    Parameters
    ----------
    names : object, (N,): names of classes.
    t : int64, (N,), in microseconds.
    corner : float64, (N, 2): the upper left corner (x, y) of a box, or the point.
    size : float64, (N, 2): the (width, height) of a box, or (0, 0) for a point.
    """

    names: np.ndarray
    t: np.ndarray
    corner: np.ndarray
    size: np.ndarray


def read_table(path: Path, classes: Sequence[str]) -> ObjectTable:
    """Read a table of objects.

    Parameters
    ----------
    classes : the model's classes. Rows of other classes are left out and counted.

    Raises
    ------
    ValueError : the table is damaged, lacks a column, or has no row of these classes.
    """
    rows = _read_boxes(path, classes) if path.suffix == ".npy" else _read_csv(path)
    if not len(rows.t):
        raise ValueError(f"{path}: no object: the table has no rows")
    index_of = {name: k for k, name in enumerate(classes)}
    label = np.array([index_of.get(name, -1) for name in rows.names], np.int64)
    unknown_classes, row_counts = np.unique(rows.names[label < 0], return_counts=True)
    indices = np.flatnonzero(label >= 0)
    if not len(indices):
        raise ValueError(f"{path}: no object of the model's classes, {', '.join(classes)}")
    with np.errstate(over="ignore"):  # of numbers near the largest one, which are refused below
        middles = rows.corner + rows.size / 2
    is_finite = np.isfinite([rows.corner[indices], rows.size[indices], middles[indices]]).all()
    if not is_finite or rows.size[indices].min() < 0 or rows.t[indices].min() < 0:
        raise ValueError(f"{path}: x, y, w and h must be finite, w, h and t at least 0")

    indices = indices[np.argsort(rows.t[indices], kind="stable")]
    size = rows.size[indices]
    is_point = (size == 0).all(1, keepdims=True)
    # a box reaches half a pixel at least
    reach = np.where(is_point, POINT_REACH_PX, np.maximum(size / 2, 0.5))
    n_rows_of = {str(name): int(n) for name, n in zip(unknown_classes, row_counts, strict=True)}
    return ObjectTable(rows.t[indices], label[indices], middles[indices], reach, size, n_rows_of)


def class_names(tables: Sequence[Path]) -> tuple[str, ...]:
    """The classes of tables, sorted by name, as the `classes` of a model that learns from them.

    Boxes whose classes have numbers alone have the classes "0", "1" and so on.

    Raises
    ------
    ValueError : a table is damaged; some tables have names and others numbers; or the numbers are
        not 0, 1, 2 and so on.
    """
    names: set[str] = set()
    numbers: set[str] = set()
    for path in tables:
        is_npy = path.suffix == ".npy"
        rows = _read_boxes(path, ()) if is_npy else _read_csv(path)
        has_names = path.name == TRACKS.name or (path.parent / NAMES_FILE).is_file()
        classes = numbers if is_npy and not has_names else names
        classes.update(rows.names.tolist())
    if not numbers:
        return tuple(sorted(names))
    remedy = f"name them in a file {NAMES_FILE} beside the boxes"
    if names:
        raise ValueError(f"some tables have names of classes, others only numbers; {remedy}")
    all_numbers = tuple(str(k) for k in range(len(numbers)))
    if numbers != set(all_numbers):
        found = ", ".join(sorted(numbers, key=int))
        raise ValueError(f"the numbers of classes must be 0, 1, 2 and so on, got {found}; {remedy}")
    return all_numbers


def _read_csv(path: Path) -> _Rows:
    """Read the rows of a table of comma-separated values."""
    refuse_git_lfs(path)
    try:
        with TextIOWrapper(open_regular(path), encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            columns = reader.fieldnames or ()
            rows = list(reader)
    except (ValueError, csv.Error) as error:
        raise ValueError(
            f"{path}: not a table of comma-separated values: {one_line(error)}"
        ) from None

    # With a column for a box's side, in any spelling, w and h are needed, so that a table of boxes
    # is not read as a table of points.
    names = {name.strip().lower() for name in columns}
    needed = ["t", "class", "x", "y"]
    if names & {"w", "h", "width", "height"}:
        needed += ["w", "h"]
    missing = [name for name in needed if name not in columns]
    if missing:
        raise ValueError(
            f"{path}: needs the columns t, class, x, y (and w, h of boxes), lacks "
            f"{', '.join(missing)}"
        )
    check_once(path, ("t", "class", "x", "y", "w", "h"), columns)
    cells = {name: _convert_column(path, name, [row[name] for row in rows]) for name in needed}

    n = len(rows)
    zeros = [0.0] * n
    corner = np.array([cells["x"], cells["y"]], np.float64).reshape(2, n).T
    size = np.array([cells.get("w", zeros), cells.get("h", zeros)], np.float64).reshape(2, n).T
    return _Rows(np.array(cells["class"], object), np.array(cells["t"], np.int64), corner, size)


def _convert_column(path: Path, name: str, column: list[Any]) -> list[Any]:
    """Convert a column of a table from texts to values.

    Parameters
    ----------
    name : name of the column, which decides the type of its values.
    column : the text in each row; None in a row that is too short.
    """
    convert = CSV_TYPES[name]
    values = []
    for k, text in enumerate(column):
        try:
            values.append(convert(text))
        except (TypeError, ValueError):  # TypeError: None, in a row that is too short
            got = f"a row ends before its {name}" if text is None else f"got {short(text)}"
            rule = "t must be whole microseconds, x, y, w and h numbers, each with a class"
            raise ValueError(f"{path}: row {k + 1}: {rule}: {got}") from None
    return values


def _microseconds(text: str) -> int:
    """Read a time of a table. A time that does not fit into int64 raises a ValueError."""
    if not -(1 << 63) <= int(text) < 1 << 63:
        raise ValueError
    return int(text)


def _class_name(text: str | None) -> str:
    """Read the name of a class. A missing name raises a TypeError, a blank one a ValueError."""
    if text is None:
        raise TypeError
    if not text.strip():
        raise ValueError
    return text


CSV_TYPES: Mapping[str, Callable[[Any], Any]] = MappingProxyType(
    {"t": _microseconds, "class": _class_name, "x": float, "y": float, "w": float, "h": float}
)
"""Column of a table -> the function that makes a value of a text."""


def _read_boxes(path: Path, classes: Sequence[str]) -> _Rows:
    """Read the rows of a file of Prophesee's boxes."""
    boxes = map_npy(path)
    try:
        has_t = "t" in (boxes.dtype.names or ())
        t = _whole_numbers(boxes["t" if has_t else "ts"])
        numbers = _whole_numbers(boxes["class_id"]).tolist()
        for name in "xywh":
            if boxes[name].ndim != 1 or boxes.dtype[name].kind not in "iuf":
                raise ValueError(f"{name} must be a number, got {boxes.dtype[name]}")
        corner = np.stack([boxes["x"], boxes["y"]], axis=-1).astype(np.float64)
        size = np.stack([boxes["w"], boxes["h"]], axis=-1).astype(np.float64)
    except (ValueError, IndexError, TypeError, AttributeError, EOFError, OverflowError) as error:
        reason = one_line(error)
        raise ValueError(
            f"{path}: not a file of boxes with the fields t, x, y, w, h and class_id: {reason}"
        ) from None
    numbered = DSEC_CLASSES if path.name == TRACKS.name else classes
    name_of = _class_names(path.parent / NAMES_FILE, numbered)
    names = [name_of.get(str(number), str(number)) for number in numbers]
    return _Rows(np.array(names, object), t, corner, size)


def _class_names(path: Path, classes: Sequence[str]) -> dict[str, str]:
    """Number of a class, as text -> name of the class.

    The names are read from the file `path`. Without this file, number k is class k of `classes`.
    """
    if not path.is_file():
        return {str(k): name for k, name in enumerate(classes)}
    try:
        content = parse_json(read_regular(path))
        if not isinstance(content, dict):
            raise ValueError(f"got {short(content)}")
    except ValueError as error:
        raise ValueError(
            f"{path}: must be an object of class numbers and names, in JSON: {one_line(error)}"
        ) from None
    return {number: str(name) for number, name in content.items()}


def _whole_numbers(column: np.ndarray) -> np.ndarray:
    """A column of whole numbers as int64.

    Other numbers are a ValueError, because the conversion would change them silently.
    """
    if column.ndim != 1 or column.dtype.kind not in "iuf":
        raise ValueError(
            f"t and class_id must be whole numbers, got {column.dtype} in shape {column.shape}"
        )
    with np.errstate(invalid="ignore"):  # no warning about nan and inf, which are refused below
        converted = column.astype(np.int64)
    fits = converted == column
    if not fits.all():
        raise ValueError(
            f"t and class_id must be whole numbers in int64, got {column[np.argmin(fits)]}"
        )
    return converted
