"""Streaming archives of many recordings, for `async-tnt evaluate`."""

from __future__ import annotations

import argparse
import contextlib
import functools
import tempfile
from collections.abc import Sequence
from pathlib import Path

from async_tnt.cli.options import positive_int
from async_tnt.cli.output import complain
from async_tnt.evaluation.job import Task
from async_tnt.evaluation.processes import run_all, run_on_dask
from async_tnt.evaluation.records import Record, evaluate_recording
from async_tnt.evaluation.results import SUFFIXES, Run, collect
from async_tnt.files import check_writable
from async_tnt.progress import progress


def add_archive(parser: argparse.ArgumentParser) -> None:
    """--workers, --dask, --out, --restart."""
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="keep the results in this file, .jsonl, a record per recording; after an interruption or a kill the same "
        "command resumes",
    )
    parser.add_argument(
        "--workers", type=positive_int, metavar="N", help="processes that stream recordings (default: 1)"
    )
    parser.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="stream on the workers of a Dask cluster with its scheduler at this address (extra `cluster`)",
    )
    parser.add_argument(
        "--restart", action="store_true", help="with --out: discard the results of an earlier run and start over"
    )


def how_to_run(args: argparse.Namespace) -> Run:
    """Where to stream; checks, before any work, that the options agree and that --out can be written.

    Raises
    ------
    ValueError, OSError.
    """
    if args.workers is not None and args.dask is not None:
        raise ValueError("--workers are processes here and --dask is a cluster: give one of them")
    if args.restart and args.out is None:
        raise ValueError("--restart requires --out: it discards the results in that file")
    if args.out is not None:
        check_writable(args.out, SUFFIXES)
    if args.dask is None:
        return functools.partial(run_all, workers=args.workers or 1)
    return functools.partial(run_on_dask, address=args.dask)


def stream_archive(args: argparse.Namespace, tasks: Sequence[Task], run: Run) -> list[Record]:
    """All records in order of the recordings' names, with a progress bar; written to the file of --out, if given.

    Raises
    ------
    KeyboardInterrupt : with what is done by then. Others : as `collect`.
    """
    try:
        with contextlib.ExitStack() as stack:
            out = args.out or Path(stack.enter_context(tempfile.TemporaryDirectory()), "results.jsonl")
            return collect(
                evaluate_recording, tasks, run, out, restart=args.restart, progress=progress, report=complain
            )
    except KeyboardInterrupt as error:
        n_done = f": {error}" if str(error) else ""
        kept = "the same command resumes" if args.out else "nothing is kept without --out"
        raise KeyboardInterrupt(f"interrupted{n_done}; {kept}") from None
