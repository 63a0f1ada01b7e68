"""The result file as Parquet: a row a recording, row groups of bounded size, the settings as metadata."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from async_tnt.archive.job import Job
from async_tnt.archive.records import COLUMNS, Record

KEY = b"async_tnt"  # of the metadata
GROUP_ROWS = 512
GROUP_ITEMS = 50_000  # windows or decisions: long recordings come in smaller groups


def not_ours(path: Path, more: str = "") -> str:
    """For a refusal."""
    return f"{path} is not a result of async-tnt{more}: move it away, or give another --out"


def import_pyarrow() -> Any:
    """The library, or one line on how to get it."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ImportError(f"Parquet needs pyarrow: pip install '.[cluster]', or write .jsonl ({error})") from None
    return pyarrow


def schema_of(job: Job) -> Any:
    """The columns of `COLUMNS`, and the settings as metadata."""
    pa = import_pyarrow()

    def arrow(kind: Any) -> Any:
        if isinstance(kind, list):
            return pa.list_(arrow(kind[0]))
        if isinstance(kind, dict):
            return pa.struct({name: arrow(field) for name, field in kind.items()})
        return pa.type_for_alias(kind)

    metadata = json.dumps({"kind": job.kind, "about": job.metadata}, sort_keys=True)
    columns = {name: arrow(kind) for name, kind in COLUMNS[job.kind].items()}
    return pa.schema(columns, {KEY: metadata.encode()})


def write_parquet(path: Path, job: Job, records: Iterable[Record]) -> None:
    """Write records, with no more than a row group of them in memory."""
    pa = import_pyarrow()
    schema = schema_of(job)
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
            for group in range(file.num_row_groups):
                yield from file.read_row_group(group).to_pylist()
    except (pa.ArrowException, OSError) as error:
        raise ValueError(not_ours(path, f" that can be read ({error})")) from None
