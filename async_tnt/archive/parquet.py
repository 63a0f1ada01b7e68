"""The result file as Parquet: a row a recording, row groups of bounded size, the settings as metadata."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from async_tnt.archive.journal import other_settings
from async_tnt.archive.records import Record

KEY = b"async_tnt"  # of the metadata
GROUP_ROWS = 512
GROUP_ITEMS = 50_000  # windows or decisions: long recordings come in smaller groups


def import_pyarrow() -> Any:
    """The library, or one line on how to get it."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ImportError(f"Parquet needs pyarrow: pip install '.[cluster]', or write .jsonl ({error})") from None
    return pyarrow


def schema_of(kind: str, about: dict[str, Any]) -> Any:
    """Columns of the file, in their order; with an `error` only `recording`, `class` and `about_file` are filled."""
    pa = import_pyarrow()
    floats, int64 = pa.list_(pa.float64()), pa.int64()
    if kind == "evaluate":
        own = {
            "class": pa.string(),
            "label": pa.string(),
            "probabilities": floats,
            "window_start_us": pa.list_(int64),
            "window_probabilities": pa.list_(floats),
            "decided_at": pa.list_(pa.list_(int64)),
            "decisions": int64,
            "events": int64,
            "late": int64,
        }
    else:
        decision = pa.struct(
            {
                "time_us": int64,
                "window_start_us": int64,
                "label": pa.string(),
                "probability": pa.float64(),
                "probabilities": floats,
                "events": int64,
                "complete": pa.bool_(),
                "trigger": pa.string(),
            }
        )
        own = {
            "label": pa.string(),
            "probability": pa.float64(),
            "probabilities": floats,
            "windows": int64,
            "events": int64,
            "late": int64,
            "decisions": pa.list_(decision),
        }
    about_file = {"error": pa.string(), "bytes": int64, "modified_ns": int64, "settings": pa.string()}
    columns = {"recording": pa.string(), **own, **about_file}
    return pa.schema(columns, {KEY: json.dumps({"kind": kind, "about": about}, sort_keys=True).encode()})


def write_parquet(path: Path, kind: str, about: dict[str, Any], records: Iterable[Record]) -> None:
    """Write records, with no more than a row group of them in memory."""
    pa = import_pyarrow()
    schema = schema_of(kind, about)
    with pa.parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        group: list[Record] = []
        items = 0
        for record in records:
            group.append(record)
            many = record["decisions"] if kind == "run" else record["window_start_us"]
            items += len(many or ())
            if len(group) >= GROUP_ROWS or items >= GROUP_ITEMS:
                writer.write_table(pa.Table.from_pylist(group, schema))
                group, items = [], 0
        if group:
            writer.write_table(pa.Table.from_pylist(group, schema))


def is_our_parquet(path: Path) -> bool:
    """Whether a file is a result of this package, of whatever settings."""
    pa = import_pyarrow()
    try:
        return KEY in (pa.parquet.read_schema(path).metadata or {})
    except pa.ArrowException:
        return False


def read_parquet(path: Path, about: dict[str, Any]) -> Iterator[Record]:
    """The rows, one by one.

    Raises
    ------
    ValueError : no Parquet file, another program's, or one of other settings.
    """
    pa = import_pyarrow()
    try:
        with pa.parquet.ParquetFile(path) as file:
            metadata = file.schema_arrow.metadata or {}
            if KEY not in metadata:
                raise ValueError(f"{path} is no result of async-tnt: move it away, or give another --out")
            before = json.loads(metadata[KEY])["about"]
            if before != about:
                raise ValueError(other_settings(path, before, about))
            for group in range(file.num_row_groups):
                yield from file.read_row_group(group).to_pylist()
    except pa.ArrowException as error:
        raise ValueError(f"{path} is no readable Parquet file: {error}; move it away, or give another --out") from None
