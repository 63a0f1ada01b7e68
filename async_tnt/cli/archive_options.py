"""The options for archives of many recordings, and `async-tnt run --out`."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from async_tnt.archive.collect import Collected, collect, collect_to_file, counted
from async_tnt.archive.executor import Place
from async_tnt.archive.find import recordings_under
from async_tnt.archive.job import Task, job_of, task_of
from async_tnt.archive.records import Record, run_recording
from async_tnt.archive.results import check_out
from async_tnt.cli.options import paths_of, positive_int, triggers_of
from async_tnt.cli.output import complain, one_line
from async_tnt.cli.pixel_options import selector_of
from async_tnt.networks.engines import choose_engine
from async_tnt.progress import progress

SHOWN = 20  # errors that are told one by one


class Interrupted(Exception):
    """Ctrl-C, told: what remains is exit code 130."""


def add_archive(parser: argparse.ArgumentParser, *, needs_out: bool) -> None:
    """--workers, --dask, --out, --restart; `needs_out`: the others belong to --out."""
    of_out = "of --out: " if needs_out else ""
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="stream into this result file, .jsonl or .parquet (extra `cluster`), one record a recording; after an "
        "interruption or kill the same command goes on",
    )
    parser.add_argument(
        "--workers", type=positive_int, metavar="N", help=f"{of_out}processes that stream recordings (default: 1)"
    )
    parser.add_argument(
        "--dask",
        metavar="ADDRESS",
        help=f"{of_out}stream on the workers of a Dask cluster, whose scheduler is at this address (extra `cluster`)",
    )
    parser.add_argument(
        "--restart", action="store_true", help="of --out: throw away what an earlier run has left, and begin anew"
    )


def place_of(args: argparse.Namespace) -> Place:
    """Where to stream, with all that these options say checked before any work.

    Raises
    ------
    ValueError, OSError, ImportError : options that do not go together; a result file that cannot be written.
    """
    if args.workers is not None and args.dask is not None:
        raise ValueError("--workers are processes here and --dask a cluster's: give one of them")
    if args.restart and args.out is None:
        raise ValueError("--restart belongs to --out: it throws away what is in that file")
    if args.out is not None:
        check_out(args.out)
    return Place(args.workers or 1, args.dask)


def stream_archive(
    args: argparse.Namespace,
    function: Callable[[Task], Record],
    tasks: Sequence[Task],
    place: Place,
    collected: Collected,
    gone: Callable[[str], bool],
    folder: str | None,
) -> Iterable[Record]:
    """All records in order of the recordings' names, with a progress bar; through the file of --out if there is one.

    `gone`, `folder` : as for `collect_to_file`.

    Raises
    ------
    Interrupted : Ctrl-C; what is done is said. Others : as `collect_to_file`.
    """
    try:
        if args.out is None:
            with progress(len(tasks), "streaming") as bar:
                return collect(function, tasks, place, collected, each=bar.update)
        bars: list[Any] = []

        def begin(n: int) -> None:
            if collected.kept and n:
                total = counted(collected.total, "recording")
                complain(f"{args.out}: {collected.kept:,} of {total} are done, going on")
            bars.append(progress(n, "streaming"))

        try:
            return collect_to_file(
                function,
                tasks,
                place,
                args.out,
                collected,
                folder=folder,
                restart=args.restart,
                gone=gone,
                begin=begin,
                each=lambda: bars[0].update(),
            )
        finally:
            for bar in bars:
                bar.__exit__(None, None, None)
            if collected.gone:
                are = "is" if collected.gone == 1 else "are"
                complain(f"{args.out}: {counted(collected.gone, 'recording')} {are} no longer there, and left out")
    except KeyboardInterrupt:
        n_done = collected.kept + collected.done
        kept = "the same command goes on" if args.out else "and kept nowhere: see --out"
        complain(f"interrupted: {n_done:,} of {counted(collected.total, 'recording')} are done; {kept}")
        raise Interrupted from None


def run_archive(args: argparse.Namespace) -> int:
    """`async-tnt run --out`: the decisions of all recordings, into a file, and a summary."""
    place = place_of(args)
    _check_run(args)
    engine = choose_engine(args.model, args.engine)
    settings = {"start_us": args.start_us, "hop_us": args.hop_us, "late": args.late, **triggers_of(args)}
    engine.processor(**settings)  # what it refuses shows before any work
    pixels = selector_of(args, engine.model)
    paths = recordings_under(paths_of(args))
    folder = None if all(path.is_absolute() for path in paths) else os.getcwd()
    job = job_of("run", args.model, engine, pixels.selection, **settings)
    tasks = [task_of(str(path), path, job) for path in paths]
    collected = Collected()
    started = time.monotonic()
    labels = dict.fromkeys(engine.classes, 0)
    n_decisions = n_events = n_late = 0
    errors = []
    try:
        for record in stream_archive(
            args, run_recording, tasks, place, collected, lambda name: not Path(name).exists(), folder
        ):
            if record["error"] is not None:
                errors.append(record["error"])
                continue
            labels[record["label"]] += 1
            n_decisions += len(record["decisions"])
            n_events += record["events"]
            n_late += record["late"]
    except Interrupted:
        return 130
    took = time.monotonic() - started
    unread = f" ({len(errors):,} of them with an error)" if errors else ""
    recordings = counted(collected.total, "recording") + unread
    print(f"{one_line(str(args.out))}: {recordings}, {counted(n_decisions, 'decision')}, {counted(n_events, 'event')}")
    if collected.done:
        print(f"{counted(collected.done, 'recording')} streamed now, {collected.done / took:,.1f} a second")
    if any(labels.values()):
        print(", ".join(f"{name} {n:,}" for name, n in labels.items() if n))
    if n_late:
        complain(f"{n_late:,} events dropped: they came late (see --late, --start-us, and `late` in {args.out})")
    for error in errors[:SHOWN]:
        complain(error)
    if len(errors) > SHOWN:
        complain(f"and {len(errors) - SHOWN:,} more with an `error` in {args.out}")
    return 2 if errors else 0


def _check_run(args: argparse.Namespace) -> None:
    for name in ("live", "speed", "json", "latest"):
        if getattr(args, name, None):
            raise ValueError(f"--{name} does not go with --out")
    for path in paths_of(args):
        if not isinstance(path, Path):
            raise ValueError(f"--out takes recordings and folders of them, got {path}")


def check_no_archive(args: argparse.Namespace) -> None:
    """Without --out, refuse what belongs to it."""
    for name in ("workers", "dask", "restart"):
        if getattr(args, name):
            raise ValueError(f"--{name} belongs to --out: streaming many recordings into a result file")
