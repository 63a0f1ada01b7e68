"""The result file, JSON lines or Parquet by its suffix: records in order of the recordings' names, one each."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from async_tnt.archive.journal import WHAT_TO_DO, parsed
from async_tnt.archive.records import TIMED, Record, fields_of
from async_tnt.files import check_own, check_writable, file_of, replacing

SUFFIXES = (".jsonl", ".parquet")


def check_out(out: Path) -> None:
    """Refuse, before any work, a result file that could not be written.

    Raises
    ------
    ValueError, OSError : see `check_writable`; also of the journal. ImportError : Parquet without pyarrow.
    """
    check_own(journal_of(check_writable(out, SUFFIXES)))
    if is_parquet(out):
        from async_tnt.archive.parquet import import_pyarrow

        import_pyarrow()


def journal_of(out: Path) -> Path:
    """Where the journal of a result file lies: beside it, the file itself if `out` is a link."""
    out = file_of(out)
    return out.with_name(out.name + ".partial")


def is_parquet(out: Path) -> bool:
    return out.suffix.lower() == ".parquet"


def is_record(record: Any, kind: str) -> bool:
    """Whether something parsed is a record of that kind, of a journal or a result file."""
    return (
        isinstance(record, dict)
        and record.keys() - {TIMED} == fields_of(kind)
        and isinstance(record["recording"], str)
        and isinstance(record["settings"], str)
        and isinstance(record["error"], str | None)
    )


def check_ours(out: Path) -> None:
    """Refuse to throw away a file that is not empty and no result file, of whatever settings.

    Raises
    ------
    ValueError.
    """
    if is_parquet(out):
        from async_tnt.archive.parquet import is_our_parquet

        ours = is_our_parquet(out)
    else:
        first = next(_read_lines(out), {"recording": "", "settings": ""})
        ours = isinstance(first, dict) and {"recording", "settings"} <= first.keys()
    if out.stat().st_size and not ours:
        raise ValueError(f"{out} is no result of async-tnt: move it away, or give another --out")


def read_results(out: Path, kind: str, about: dict[str, Any], settings: str) -> Iterator[Record]:
    """The records of a result file, one by one.

    Raises
    ------
    ValueError : the file is another program's, damaged, or one of other settings.
    """
    if is_parquet(out):
        from async_tnt.archive.parquet import read_parquet

        records = read_parquet(out, about)
    else:
        records = _read_lines(out)
    before = ""
    for record in records:
        if not is_record(record, kind) or record["recording"] <= before:
            raise ValueError(
                f"{out} is no result of async-tnt {kind}, or is damaged: move it away, or give another --out"
            )
        if record["settings"] != settings:
            raise ValueError(
                f"{out} was made by another model, window, trigger, engine, version or selection of pixels, "
                f"settings {record['settings']} (now {settings}): {WHAT_TO_DO}"
            )
        before = record["recording"]
        yield record


def write_results(out: Path, kind: str, about: dict[str, Any], records: Iterable[Record], like: Path) -> None:
    """Write a result file, in its place at once when it is complete; a new one as readable as the file `like`.

    `records` are in order, without `seconds`.
    """
    with replacing(out, like=like) as part:
        if is_parquet(out):
            from async_tnt.archive.parquet import write_parquet

            write_parquet(part, kind, about, records)
        else:
            with part.open("wb") as file:
                for record in records:
                    file.write(json.dumps(record).encode() + b"\n")
        _sync(part)
    if os.name != "nt":  # the name, too, outlives a loss of power
        _sync(out.parent)


def _read_lines(out: Path) -> Iterator[Any]:
    with out.open("rb") as file:
        for line in file:
            yield parsed(line)


def _sync(path: Path) -> None:
    flags = os.O_RDONLY if path.is_dir() else os.O_RDWR
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
