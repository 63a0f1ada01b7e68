"""The recordings in a folder, and the labels of a data set.

A data set has its recordings in class folders, or it has sessions. A session is a recording with a
table beside it, `NAME_labels.csv`: a row for each part that shows one class, with the columns
`class`, `start` and `end`, in microseconds, as DVS128 Gesture has them. Beside the sessions,
`gesture_mapping.csv` may give class numbers their names, and `trials_to_train.txt` and
`trials_to_test.txt` may list the sessions to train on and to test on.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path

from async_tnt.base.files import open_regular, read_regular, refuse_git_lfs, user_path
from async_tnt.base.messages import one_line
from async_tnt.sources.files.recording import READERS

TABLE = "_labels.csv"
"""End of the name of a session's table."""

COLUMNS = {
    "class": ("class", "label"),
    "start": ("start", "start_us", "startTime_usec"),
    "end": ("end", "end_us", "endTime_usec"),
}
"""Column of a session's table -> the names that the column may have."""

NAMES_FILE = "gesture_mapping.csv"
"""Name of the file that gives class numbers their names."""

NAMES_COLUMNS = {"label": ("label", "class"), "name": ("action", "gesture", "name")}
"""Column of the file of names -> the names that the column may have."""

LISTS = {"Train": "trials_to_train.txt", "Test": "trials_to_test.txt"}
"""Part of a data set -> name of the file that lists its sessions."""

TEXTS = (".csv", ".txt")
"""Suffixes that recordings share with notes."""


@dataclass(frozen=True)
class LabelledRecording:
    """A recording of one class, or the part of a recording that shows one class.

    Parameters
    ----------
    path : path of the recording's file.
    between_us : (start, end): the events with start <= t < end belong to it; None: all events.
    """

    path: Path
    between_us: tuple[int, int] | None = None

    @property
    def name(self) -> str:
        """The name for messages and reports.

        It names the class folder and the file, or the session's file and the part's times.
        """
        if self.between_us is None:
            return f"{self.path.parent.name}/{self.path.name}"
        return self.name_as(self.path.name)

    def name_as(self, file: str) -> str:
        """The name with another name of its file, such as a path relative to some folder."""
        if self.between_us is None:
            return file
        start_us, end_us = self.between_us
        return f"{file}[{start_us}:{end_us}]"


def file_of(name: str) -> str:
    """The file that a name belongs to. The parts of a session belong to the session's file.

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
        folder. Hidden files and folders (".cache"), files that are not recordings, and deeper
        folders are ignored.
    part : part of the data set, such as "Train". Only the folder `folder/part` is searched, if it
        exists and has recordings. Sessions are found only if the list for this part names them.
        Without this list, sessions are found unless the other part's list names them.

    Returns
    -------
    Class name -> recordings, both sorted by name. A class folder without recordings has an empty
    list.

    Raises
    ------
    FileNotFoundError, NotADirectoryError : there is no such folder.
    ValueError : the folder has neither class folders nor sessions, or has both; a session has no
        table; a table is in a class folder, or cannot be read.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     for name in ("left/a.npy", "left/b.npz", "right/a.npy", "right/notes.md"):
    ...         Path(folder, name).parent.mkdir(exist_ok=True)
    ...         Path(folder, name).touch()
    ...     found = find_recordings(folder)
    >>> list(found)
    ['left', 'right']
    >>> [recording.name for recording in found["left"]]
    ['left/a.npy', 'left/b.npz']
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
    if part is not None:
        folder = _folder_of_part(folder, part)
    folders = _folders(folder)
    # Folders with the names of parts, such as "Train", are not checked as classes.
    classes = [path for path in folders if path.name not in LISTS]
    for path in classes:
        _check_class_folder(path)
    sessions = _sessions(folder)
    if sessions:
        _check_all_labelled(folder, sessions, classes)
        return _parts(folder, sessions, part)
    if not folders:
        raise ValueError(
            f"{folder}: no class folders; expected {folder.name}/<class name>/<recording>, or "
            f"sessions {folder.name}/NAME.* with tables NAME{TABLE}; recordings in "
            f"{', '.join(sorted(READERS))}"
        )
    return {path.name: _recordings_in(path) for path in folders}


def _folder_of_part(folder: Path, part: str) -> Path:
    """The folder of a part of a data set: `folder/part` if it holds any data, else `folder`."""
    inner = folder / part
    if inner.is_dir() and (_folders(inner) or _sessions(inner)):
        return inner
    return folder


def _check_class_folder(folder: Path) -> None:
    """Refuse a class folder with a name that is not in UTF-8, or with a session in it."""
    name = folder.name
    if name.encode(errors="replace").decode() != name:
        raise ValueError(
            f"{folder.parent}: the name of a class folder must be in UTF-8, got {name!a}; rename it"
        )
    misplaced = list(_sessions(folder))
    if misplaced:
        raise ValueError(
            f"{folder}: {misplaced[0].name} has a table of labels, but lies in a class folder; put "
            f"both into {folder.parent}"
        )


def _recordings_in(folder: Path) -> list[LabelledRecording]:
    """The recordings in a class folder, sorted by name."""
    paths = [path for path in sorted(folder.iterdir()) if is_recording(path)]
    return [LabelledRecording(path) for path in paths if not path.is_dir()]


def class_folders(folder: Path) -> list[Path]:
    """The class folders in `Train` or, without it, in the data set itself."""
    return _folders(_folder_of_part(folder, "Train"))


def has_test(folder: Path) -> bool:
    """Whether a data set sets some recordings aside for "Test", in a folder or by lists."""
    return (folder / "Test").is_dir() or any((folder / file).is_file() for file in LISTS.values())


def is_recording(path: Path) -> bool:
    """Whether a file is a recording by its suffix, not hidden, and not a table of labels."""
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
    ValueError : there are no recordings.
    OSError : a folder cannot be read.
    """
    recordings = []
    for parent, names, files in os.walk(folder, onerror=_raise):
        names[:] = [name for name in names if not name.startswith(".")]
        recordings += [Path(parent, name) for name in files if is_recording(Path(name))]
    if not recordings:
        raise ValueError(
            f"{folder}: no recordings in this folder; expected files in "
            f"{', '.join(sorted(READERS))}"
        )
    return sorted(recordings)


def _raise(error: OSError) -> None:
    """Raise an error that os.walk alone would silently skip."""
    raise error


def _folders(folder: Path) -> list[Path]:
    """The folders in a folder that are not hidden, sorted by name."""
    visible = [path for path in folder.iterdir() if not path.name.startswith(".")]
    return sorted(path for path in visible if path.is_dir())


def _sessions(folder: Path) -> dict[Path, Path]:
    """The sessions of a folder: the table of each recording that has one."""
    tables = {
        path.name.removesuffix(TABLE): path for path in folder.glob(f"*{TABLE}") if path.is_file()
    }
    recordings = [
        path for path in sorted(folder.iterdir()) if path.stem in tables and is_recording(path)
    ]
    sessions: dict[Path, Path] = {}
    for name, table in sorted(tables.items()):
        namesakes = [path for path in recordings if path.stem == name]
        # of files with one name, a text may be a note about the recording
        candidates = [path for path in namesakes if path.suffix.lower() not in TEXTS] or namesakes
        if len(candidates) > 1:
            raise ValueError(
                f"{folder}: {candidates[0].name} and {candidates[1].name} have one table; keep one "
                "of them there"
            )
        sessions |= dict.fromkeys(candidates, table)
    return sessions


def _check_all_labelled(folder: Path, sessions: Mapping[Path, Path], classes: list[Path]) -> None:
    """Refuse recordings or tables beside the sessions, and recordings in class folders.

    Texts of any kind are allowed. With a list of sessions, recordings without a table are allowed,
    too.
    """
    if not any((folder / file).is_file() for file in LISTS.values()):
        for path in _sure_recordings(folder):
            if path not in sessions:
                raise ValueError(
                    f"{path} has no table {path.stem}{TABLE}, as others have; write one, or remove "
                    "it"
                )
        unused = sorted({*folder.glob(f"*{TABLE}")} - {*sessions.values()})
        if unused:
            table = unused[0]
            raise ValueError(
                f"{table} has no recording {table.name.removesuffix(TABLE)}.*, as others have; "
                "remove it"
            )
    misplaced = [path for folder_of_class in classes for path in _sure_recordings(folder_of_class)]
    if misplaced:
        session = next(iter(sessions))
        raise ValueError(
            f"{folder}: expected class folders, or sessions with tables, got both: "
            f"{misplaced[0].relative_to(folder)} and {session.name}"
        )


def _sure_recordings(folder: Path) -> list[Path]:
    """The files in a folder that can only be recordings, sorted by name."""
    recordings = [path for path in folder.iterdir() if is_recording(path) and path.is_file()]
    return sorted(path for path in recordings if path.suffix.lower() not in TEXTS)


def _sessions_in_list(file: Path, sessions: Mapping[Path, Path]) -> set[Path] | None:
    """The sessions that a list names; None if there is no list."""
    if not file.is_file():
        return None
    try:
        lines = read_regular(file).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{file}: not a text in UTF-8: {error}") from None
    wanted = {line.strip() for line in lines} - {""}
    missing = sorted(wanted - {path.name for path in sessions})
    if missing:
        raise ValueError(f"{file} names {missing[0]}, which is not there, or has no table")
    return {path for path in sessions if path.name in wanted}


def _sessions_for(
    folder: Path, sessions: Mapping[Path, Path], part: str | None
) -> Mapping[Path, Path]:
    """The sessions that belong to a part of the data set."""
    if part not in LISTS:
        return sessions
    listed = {name: _sessions_in_list(folder / file, sessions) for name, file in LISTS.items()}
    wanted = listed.pop(part)
    if wanted is None:
        # all sessions that no other list names
        wanted = set(sessions)
        for others in listed.values():
            wanted -= others or set()
    return {path: table for path, table in sessions.items() if path in wanted}


def _parts(
    folder: Path, sessions: Mapping[Path, Path], part: str | None
) -> dict[str, list[LabelledRecording]]:
    """The parts of sessions that show each class, by the name of the class."""
    sessions = _sessions_for(folder, sessions, part)
    names = {}
    if (folder / NAMES_FILE).is_file():
        rows = _rows(folder / NAMES_FILE, NAMES_COLUMNS)
        names = {row["label"]: row["name"] for _, row in rows}

    by_class: dict[str, list[LabelledRecording]] = {}
    known = set()
    for path, table in sessions.items():
        for number, row in _rows(table, COLUMNS):
            place = f"{table}: line {number}"
            label = row["class"]
            between_us = _times_in(place, row)
            if names and label not in names:
                raise ValueError(f"{place}: {NAMES_FILE} does not name class {label}")
            recording = LabelledRecording(path, between_us)
            if recording in known:
                start_us, end_us = between_us
                raise ValueError(f"{place}: {start_us} to {end_us} us is there twice")
            known.add(recording)
            by_class.setdefault(names.get(label, label), []).append(recording)
    return dict(sorted(by_class.items(), key=lambda item: _sort_key(item[0])))


def _times_in(place: str, row: Mapping[str, str]) -> tuple[int, int]:
    """Start and end, in microseconds, in a row of a session's table.

    Raises
    ------
    ValueError : start or end is not a time, or the row has no class.
    """
    try:
        start_us = int(row["start"])
        end_us = int(row["end"])
    except ValueError:
        # times that the test below refuses
        start_us = 0
        end_us = 0
    if not 0 <= start_us < end_us or not row["class"]:
        got = one_line(", ".join(row.values()))
        raise ValueError(f"{place}: expected a class, and whole start < end in us, got {got}")
    return start_us, end_us


def _sort_key(label: str) -> str:
    """The text by which classes are sorted: numbers by their value."""
    return label.zfill(9) if label.isdigit() else label


def check_once(path: Path, wanted: Iterable[str | None], names: Sequence[str]) -> None:
    """Refuse a table in which a wanted column has the same name as another column.

    Python's reader of CSV would silently use the last column of this name.
    """
    for name in wanted:
        if name is not None and names.count(name) > 1:
            raise ValueError(
                f"{path}: the column {name!r} is there {names.count(name)} times; leave out all "
                "but one"
            )


def _rows(path: Path, columns: Mapping[str, tuple[str, ...]]) -> list[tuple[int, dict[str, str]]]:
    """The rows of a CSV file: the line number of each, and its words by column.

    Parameters
    ----------
    columns : wanted column -> the names that the column may have in the file.

    Raises
    ------
    ValueError : the table is not a CSV file, a column is missing, or a column occurs twice.
    """
    refuse_git_lfs(path)
    try:
        with TextIOWrapper(open_regular(path), encoding="utf-8-sig", newline="") as file:
            rows = csv.DictReader(file, skipinitialspace=True)
            fields = [name for name in rows.fieldnames or () if name]
            name_in_file = {name.strip(): name for name in fields}
            chosen_names = {}
            for column, names in columns.items():
                present = [name for name in names if name in name_in_file]
                if not present:
                    raise ValueError(
                        f"{path}: expected a column {' or '.join(names)}, got "
                        f"{', '.join(name_in_file) or 'none'}"
                    )
                chosen_names[column] = present[0]
            check_once(path, chosen_names.values(), [name.strip() for name in fields])
            numbered_rows = []
            for row in rows:
                words = {}
                for column, name in chosen_names.items():
                    word = row[name_in_file[name]] or ""  # None in a row that is too short
                    words[column] = word.strip()
                numbered_rows.append((rows.line_num, words))
            return numbered_rows
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a CSV file: {error}") from None
