"""Streaming archives of many recordings for `async-tnt run --out` and `evaluate`."""

from __future__ import annotations

import argparse
import contextlib
import functools
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from async_tnt.cli.options import check_of_windows, paths_of, triggers_of
from async_tnt.cli.output import complain, complain_late, counted, say
from async_tnt.cli.pixel_options import selector_of
from async_tnt.compile_ahead import fill_cache
from async_tnt.evaluation.job import Task, job_of, task_of
from async_tnt.evaluation.processes import run_all, run_on_dask
from async_tnt.evaluation.records import Record, run_recording
from async_tnt.evaluation.results import SUFFIXES, Progress, Run, collect
from async_tnt.files import check_writable
from async_tnt.networks.engines import choose_engine
from async_tnt.processor import Processor
from async_tnt.progress import progress as progress_bar
from async_tnt.sources.labelled_recordings import recordings_under

SHOWN = 20  # errors that are printed one by one


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


def stream_archive(
    args: argparse.Namespace,
    function: Callable[[Task], Record],
    tasks: Sequence[Task],
    run: Run,
    progress: Progress,
    is_gone: Callable[[str], bool],
) -> Iterable[Record]:
    """All records in order of the recordings' names, with a progress bar; written to the file of --out, if given.

    Raises
    ------
    KeyboardInterrupt : with what is done by then. Others : as `collect`.
    """
    bar: Any = None

    def watch() -> None:
        nonlocal bar
        if bar is not None:
            bar.update()
            return
        n = progress.total - progress.kept
        if progress.kept and n:
            total = counted(progress.total, "recording")
            complain(f"{args.out}: {progress.kept:,} of {total} are done, resuming")
        bar = stack.enter_context(progress_bar(n, "streaming"))

    try:
        with contextlib.ExitStack() as stack:
            out = args.out or Path(stack.enter_context(tempfile.TemporaryDirectory()), "results.jsonl")
            how = {"restart": args.restart, "is_gone": is_gone, "watch": watch}
            records = collect(function, tasks, run, out, progress, **how)
            return records if args.out else list(records)  # while the temporary file is there
    except KeyboardInterrupt:
        n_done = progress.kept + progress.done
        kept = "the same command resumes" if args.out else "nothing is kept without --out"
        total = counted(progress.total, "recording")
        raise KeyboardInterrupt(f"interrupted: {n_done:,} of {total} are done; {kept}") from None
    finally:
        if progress.gone:
            are = "no longer exists and is" if progress.gone == 1 else "no longer exist and are"
            complain(f"{args.out}: {counted(progress.gone, 'recording')} {are} left out")


def run_archive(args: argparse.Namespace) -> int:
    """`async-tnt run --out`: the decisions of all recordings, into a file, and a summary."""
    run = how_to_run(args)
    _check_run(args)
    engine = choose_engine(args.model)
    check_of_windows(engine.finds_objects, args.model)
    fill_cache()
    settings = {"start_us": args.start_us, "hop_us": args.hop_us, "late": args.late, **triggers_of(args)}
    # refuses bad settings before any work
    Processor(engine.model, classes=engine.classes, **engine.networks, **settings)
    pixels = selector_of(args, engine.model)
    paths = recordings_under(paths_of(args))
    job = job_of("run", args.model, engine, pixels.selection, **settings)
    tasks = [task_of(str(path), path, job) for path in paths]
    progress = Progress()
    started = time.monotonic()
    labels = dict.fromkeys(engine.classes, 0)
    n_decisions = n_events = n_late = 0
    errors = []
    for record in stream_archive(args, run_recording, tasks, run, progress, lambda name: not Path(name).exists()):
        if record["error"] is not None:
            errors.append(record["error"])
            continue
        labels[record["label"]] += 1
        n_decisions += len(record["decisions"])
        n_events += record["events"]
        n_late += record["late"]
    took = time.monotonic() - started
    unread = f" ({len(errors):,} of them with an error)" if errors else ""
    recordings = counted(progress.total, "recording") + unread
    say(f"{args.out}: {recordings}, {counted(n_decisions, 'decision')}, {counted(n_events, 'event')}")
    if progress.done:
        say(f"{counted(progress.done, 'recording')} streamed now, {progress.done / took:,.1f} a second")
    if any(labels.values()):
        say(", ".join(f"{name} {n:,}" for name, n in labels.items() if n))
    complain_late(str(args.out), n_late, n_events, "--late, --start-us, and `late` in that file")
    for error in errors[:SHOWN]:
        complain(error)
    if len(errors) > SHOWN:
        complain(f"and {len(errors) - SHOWN:,} more with an `error` in {args.out}")
    return 2 if errors else 0


def _check_run(args: argparse.Namespace) -> None:
    for name in ("json", "keep_up"):
        if getattr(args, name):
            raise ValueError(f"--{name.replace('_', '-')} does not go with --out")
    for path in paths_of(args):
        if not isinstance(path, Path):
            raise ValueError(f"--out takes recordings and folders of them, got {path}")
