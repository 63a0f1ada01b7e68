"""The result file as Parquet: a row a recording, row groups of bounded size, the settings as metadata."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from async_tnt.archive.job import Job
from async_tnt.archive.records import COLUMNS, Record
from async_tnt.checks import needs_extra

KEY = b"async_tnt"  # of the metadata
GROUP_ROWS = 512
GROUP_ITEMS = 50_000  # windows or decisions: long recordings come in smaller groups


def not_ours(path: Path, more: str = "") -> str:
    """For a refusal."""
    return f"{path} is not a result of async-tnt{more}: move it away, or give another --out"


def import_pyarrow() -> Any:
    """The library, or one line on how to get it."""
    with needs_extra("cluster", "Parquet, unlike .jsonl, needs pyarrow"):
        import pyarrow
        import pyarrow.parquet
    return pyarrow


def _schema(kind: str) -> Any:
    """The columns of `COLUMNS`."""
    pa = import_pyarrow()

    def arrow(column: Any) -> Any:
        if isinstance(column, list):
            return pa.list_(arrow(column[0]))
        if isinstance(column, dict):
            return pa.struct({name: arrow(field) for name, field in column.items()})
        return pa.type_for_alias(column)

    return pa.schema({name: arrow(column) for name, column in COLUMNS[kind].items()})


def write_parquet(path: Path, job: Job, records: Iterable[Record]) -> None:
    """Write records, with no more than a row group of them in memory."""
    pa = import_pyarrow()
    metadata = json.dumps({"kind": job.kind, "about": job.metadata}, sort_keys=True)
    schema = _schema(job.kind).with_metadata({KEY: metadata.encode()})
    with pa.parquet.ParquetWriter(path, schema, compression="zstd", write_page_checksum=True) as writer:
        group: list[Record] = []
        items = 0
        for record in records:
            group.append(record)
            items += len(record["decisions" if job.kind == "run" else "window_start_us"] or ())
            if len(group) >= GROUP_ROWS or items >= GROUP_ITEMS:
                writer.write_table(pa.Table.from_pylist(group, schema))
                group, items = [], 0
        if group:
            writer.write_table(pa.Table.from_pylist(group, schema))


def read_metadata(path: Path) -> dict[str, Any]:
    """The `Job.metadata` that a result was made with.

    Raises
    ------
    ValueError : the file is not Parquet, or another program's.
    """
    pa = import_pyarrow()
    try:
        metadata = pa.parquet.read_schema(path).metadata or {}
    except pa.ArrowException:
        metadata = {}
    if KEY not in metadata:
        raise ValueError(not_ours(path))
    return json.loads(metadata[KEY])["about"]


def read_parquet(path: Path) -> Iterator[Record]:
    """The rows, one by one."""
    pa = import_pyarrow()
    try:
        with pa.parquet.ParquetFile(path, page_checksum_verification=True) as file:
            kind = json.loads(file.schema_arrow.metadata[KEY])["kind"]
            if not file.schema_arrow.equals(_schema(kind)):  # no checksum covers the names of columns
                raise ValueError(f"its columns are not those of {kind!r}")
            for group in range(file.num_row_groups):
                yield from file.read_row_group(group).to_pylist()
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(not_ours(path, f" that can be read ({error})")) from None
