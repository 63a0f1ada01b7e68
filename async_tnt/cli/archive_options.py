"""The options of commands that stream archives of many recordings."""

from __future__ import annotations

import argparse
from pathlib import Path

from async_tnt.cli.options import positive_int


def add_archive(parser: argparse.ArgumentParser, *, needs_out: bool) -> None:
    """--workers, --dask, --out, --restart; `needs_out`: the others require --out."""
    with_out = "with --out: " if needs_out else ""
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="stream into this result file, .jsonl, one record per recording; after an interruption or a kill the same "
        "command resumes",
    )
    parser.add_argument(
        "--workers", type=positive_int, metavar="N", help=f"{with_out}processes that stream recordings (default: 1)"
    )
    parser.add_argument(
        "--dask",
        metavar="ADDRESS",
        help=f"{with_out}stream on the workers of a Dask cluster with its scheduler at this address (extra `cluster`)",
    )
    parser.add_argument(
        "--restart", action="store_true", help="with --out: discard the results of an earlier run and start over"
    )


def check_no_archive(args: argparse.Namespace) -> None:
    """Refuse options that require --out where it is missing."""
    for name in ("workers", "dask", "restart"):
        if getattr(args, name):
            raise ValueError(f"--{name} requires --out: streaming many recordings into a result file")
