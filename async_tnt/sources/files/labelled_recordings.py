"""Which recordings a folder holds; with labels: in class folders, or sessions with tables of what
they show.

A session is a recording with a table beside it, `NAME_labels.csv`: a row for each part that shows
one class, with the columns `class`, `start` and `end`, in microseconds, as DVS128 Gesture has them.
Its file `gesture_mapping.csv` gives class numbers their names, `trials_to_train.txt` and
`trials_to_test.txt` say which sessions are for what.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path

from async_tnt.base.checks import one_line
from async_tnt.base.files import open_regular, read_regular, refuse_git_lfs, user_path
from async_tnt.sources.files.recording import READERS

TABLE = "_labels.csv"
COLUMNS = {
    "class": ("class", "label"),
    "start": ("start", "start_us", "startTime_usec"),
    "end": ("end", "end_us", "endTime_usec"),
}
NAMES_FILE = "gesture_mapping.csv"
LISTS = {"Train": "trials_to_train.txt", "Test": "trials_to_test.txt"}
TEXTS = ".csv", ".txt"  # may be notes


@dataclass(frozen=True)
class LabelledRecording:
    """A recording of one class, or a part of one.

    Parameters
    ----------
    path : of its file.
    between_us : the events with start <= t < end; None: all.
    """

    path: Path
    between_us: tuple[int, int] | None = None

    @property
    def name(self) -> str:
        """For messages and reports: class folder and file, or the session's file and the part's
        times."""
        return (
            f"{self.path.parent.name}/{self.path.name}"
            if self.between_us is None
            else self.name_as(self.path.name)
        )

    def name_as(self, file: str) -> str:
        """The same under another name of its file, such as one relative to some folder."""
        return (
            file
            if self.between_us is None
            else f"{file}[{self.between_us[0]}:{self.between_us[1]}]"
        )


def file_of(name: str) -> str:
    """The file that a name belongs to: that of a session for each of its parts.

    Examples
    --------
    >>> file_of("user01_led.aedat[80048239:85092709]"), file_of("wave/a.npz")
    ('user01_led.aedat', 'wave/a.npz')
    """
    return name.rpartition("[")[0] if name.endswith("]") else name


def find_recordings(
    folder: str | os.PathLike[str], part: str | None = None
) -> dict[str, list[LabelledRecording]]:
    """The recordings of a folder of class folders, or of sessions.

    Parameters
    ----------
    folder : holds a folder for each class, with the name of the class, or sessions; `~` is the home
        folder. Hidden files and folders (".cache"), files that are not recordings, and deeper ones
        are ignored.
    part : such as "Train": they are in `folder/part` if that exists and has any; of sessions, those
        that the list for this part names or, without one, those that the other part's list does not
        name.

    Returns
    -------
    Class name -> recordings, both sorted by name. A class folder without recordings has an empty
    list.

    Raises
    ------
    FileNotFoundError, NotADirectoryError : no such folder.
    ValueError : neither class folders nor sessions in it, or both; a session without a table; a
        table in a class folder, or one that cannot be read.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     for name in ("left/a.npy", "left/b.npz", "right/a.npy", "right/notes.md"):
    ...         Path(folder, name).parent.mkdir(exist_ok=True)
    ...         Path(folder, name).touch()
    ...     found = find_recordings(folder)
    >>> {name: [recording.path.name for recording in recordings] for name, recordings in found.items()}
    {'left': ['a.npy', 'b.npz'], 'right': ['a.npy']}
    """
    folder = user_path(folder)
    if not folder.exists():
        raise FileNotFoundError(
            f"no folder {folder}; expected one with a folder of recordings for each class"
        )
    if not folder.is_dir():
        raise NotADirectoryError(
            f"{folder} is a file; expected a folder with a folder of recordings for each class"
        )
    if (
        part is not None
        and (folder / part).is_dir()
        and (_folders(folder / part) or _sessions(folder / part))
    ):
        folder = folder / part
    classes = _folders(folder)
    not_parts = [path for path in classes if path.name not in LISTS]
    for c in not_parts:
        if c.name.encode(errors="replace").decode() != c.name:
            raise ValueError(
                f"{folder}: the name of a class folder must be in UTF-8, got {c.name!a}; rename it"
            )
        if misplaced := list(_sessions(c)):
            raise ValueError(
                f"{c}: {misplaced[0].name} has a table of labels, but lies in a class folder; put "
                f"both into {folder}"
            )
    if sessions := _sessions(folder):
        _check_all_labelled(folder, sessions, not_parts)
        return _parts(folder, sessions, part)
    if not classes:
        raise ValueError(
            f"{folder}: no class folders; expected {folder.name}/<class name>/<recording>, or "
            "sessions "
            f"{folder.name}/NAME.* with tables NAME{TABLE}; recordings in "
            f"{', '.join(sorted(READERS))}"
        )
    return {
        c.name: [
            LabelledRecording(p) for p in sorted(c.iterdir()) if is_recording(p) and not p.is_dir()
        ]
        for c in classes
    }


def class_folders(folder: Path) -> list[Path]:
    """The class folders in `Train` or, without it, in the data set itself."""
    inner = folder / "Train"
    of = inner if inner.is_dir() and (_folders(inner) or _sessions(inner)) else folder
    return _folders(of)


def has_test(folder: Path) -> bool:
    """Whether some of a data set's recordings are set aside for "Test", as a folder or by lists."""
    return (folder / "Test").is_dir() or any((folder / file).is_file() for file in LISTS.values())


def is_recording(path: Path) -> bool:
    """Whether `open_recording` knows the suffix, and the file is neither hidden nor a table of
    labels."""
    return (
        path.suffix.lower() in READERS
        and not path.name.startswith(".")
        and not path.name.endswith(TABLE)
    )


def recordings_under(folder: Path) -> list[Path]:
    """All recordings below a folder, by suffix (`READERS`), sorted.

    Hidden files and folders are left out, and links to folders are not followed.

    Raises
    ------
    ValueError : there are none. OSError : a folder cannot be read.
    """
    found = []
    for inside, names, files in os.walk(folder, onerror=_raise):
        names[:] = [name for name in names if not name.startswith(".")]
        found += [Path(inside, name) for name in files if is_recording(Path(name))]
    if not found:
        raise ValueError(
            f"{folder}: no recordings in this folder; expected files in "
            f"{', '.join(sorted(READERS))}"
        )
    return sorted(found)


def _raise(error: OSError) -> None:
    raise error  # os.walk alone would silently skip what it may not read


def _folders(folder: Path) -> list[Path]:
    return sorted(
        path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")
    )


def _sessions(folder: Path) -> dict[Path, Path]:
    """Recording -> its table."""
    tables = {
        path.name.removesuffix(TABLE): path for path in folder.glob(f"*{TABLE}") if path.is_file()
    }
    recordings = [
        path for path in sorted(folder.iterdir()) if path.stem in tables and is_recording(path)
    ]
    sessions: dict[Path, Path] = {}
    for name, table in sorted(tables.items()):
        named = [path for path in recordings if path.stem == name]
        found = [path for path in named if path.suffix.lower() not in TEXTS] or named
        if len(found) > 1:
            raise ValueError(
                f"{folder}: {found[0].name} and {found[1].name} have one table; keep one of them "
                "there"
            )
        sessions |= dict.fromkeys(found, table)
    return sessions


def _check_all_labelled(folder: Path, sessions: Mapping[Path, Path], classes: list[Path]) -> None:
    """There are no recordings or tables beside the sessions. Those that no list names may be there,
    and texts of any kind."""
    if not any((folder / file).is_file() for file in LISTS.values()):
        for path in _unlabelled(folder):
            if path not in sessions:
                raise ValueError(
                    f"{path} has no table {path.stem}{TABLE}, as others have; write one, or remove "
                    "it"
                )
        for table in sorted({*folder.glob(f"*{TABLE}")} - {*sessions.values()}):
            raise ValueError(
                f"{table} has no recording {table.name.removesuffix(TABLE)}.*, as others have; "
                "remove it"
            )
    if of_classes := [path for c in classes for path in _unlabelled(c)]:
        raise ValueError(
            f"{folder}: expected class folders, or sessions with tables, got both: "
            f"{of_classes[0].relative_to(folder)} "
            f"and {next(iter(sessions)).name}"
        )


def _unlabelled(folder: Path) -> list[Path]:
    """Files that can only be recordings."""
    return sorted(
        p
        for p in folder.iterdir()
        if is_recording(p) and p.is_file() and p.suffix.lower() not in TEXTS
    )


def _listed(file: Path, sessions: Mapping[Path, Path]) -> set[Path] | None:
    """The sessions that a list names; None without the list."""
    if not file.is_file():
        return None
    try:
        wanted = {
            name
            for line in read_regular(file).decode("utf-8-sig").splitlines()
            if (name := line.strip())
        }
    except UnicodeDecodeError as error:
        raise ValueError(f"{file}: not a text in UTF-8: {error}") from None
    if missing := sorted(wanted - {path.name for path in sessions}):
        raise ValueError(f"{file} names {missing[0]}, which is not there, or has no table")
    return {path for path in sessions if path.name in wanted}


def _parts(
    folder: Path, sessions: Mapping[Path, Path], part: str | None
) -> dict[str, list[LabelledRecording]]:
    """The parts of the sessions, by class."""
    if part in LISTS:
        listed = {name: _listed(folder / file, sessions) for name, file in LISTS.items()}
        wanted = listed.pop(part)
        if wanted is None:
            wanted = set(sessions).difference(
                *(others for others in listed.values() if others is not None)
            )
        sessions = {path: table for path, table in sessions.items() if path in wanted}
    names = {}
    if (folder / NAMES_FILE).is_file():
        columns = {"label": ("label", "class"), "name": ("action", "gesture", "name")}
        names = {row["label"]: row["name"] for _, row in _rows(folder / NAMES_FILE, columns)}
    found: dict[str, list[LabelledRecording]] = {}
    seen = set()
    for path, table in sessions.items():
        for number, row in _rows(table, COLUMNS):
            try:
                between = int(row["start"]), int(row["end"])
            except ValueError:
                between = 0, 0
            if not 0 <= between[0] < between[1] or not row["class"]:
                got = one_line(", ".join(row.values()))
                raise ValueError(
                    f"{table}: line {number}: expected a class, and whole start < end in us, got "
                    f"{got}"
                )
            if names and row["class"] not in names:
                raise ValueError(
                    f"{table}: line {number}: {NAMES_FILE} does not name class {row['class']}"
                )
            if (path, between) in seen:
                raise ValueError(
                    f"{table}: line {number}: {between[0]} to {between[1]} us is there twice"
                )
            seen.add((path, between))
            found.setdefault(names.get(row["class"], row["class"]), []).append(
                LabelledRecording(path, between)
            )
    return dict(
        sorted(found.items(), key=lambda item: item[0].zfill(9) if item[0].isdigit() else item[0])
    )


def check_once(path: Path, wanted: Iterable[str | None], names: Sequence[str]) -> None:
    """Refuse a table in which one of the wanted columns has a name that another column has, too.

    Python's reader of CSV would silently use the last of them.
    """
    for name in wanted:
        if name is not None and names.count(name) > 1:
            raise ValueError(
                f"{path}: the column {name!r} is there {names.count(name)} times; leave out all "
                "but one"
            )


def _rows(path: Path, columns: Mapping[str, tuple[str, ...]]) -> list[tuple[int, dict[str, str]]]:
    """The rows of a CSV file, with their lines and these columns, each of which may have one of
    several names."""
    refuse_git_lfs(path)
    try:
        with TextIOWrapper(open_regular(path), encoding="utf-8-sig", newline="") as file:
            rows = csv.DictReader(file, skipinitialspace=True)
            names_there = [name.strip() for name in rows.fieldnames or () if name]
            given = {name.strip(): name for name in rows.fieldnames or () if name}
            found = {
                column: next((n for n in names if n in given), None)
                for column, names in columns.items()
            }
            lacking = [
                " or ".join(columns[column]) for column, name in found.items() if name is None
            ]
            if lacking:
                raise ValueError(
                    f"{path}: expected a column {lacking[0]}, got {', '.join(given) or 'none'}"
                )
            check_once(path, found.values(), names_there)
            return [
                (rows.line_num, {c: (row[given[n or ""]] or "").strip() for c, n in found.items()})
                for row in rows
            ]
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a CSV file: {error}") from None
