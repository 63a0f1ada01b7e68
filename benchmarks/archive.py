"""Many recordings on 1 and 2 workers: how much sooner is an archive evaluated, by processes and by a Dask cluster?

    python benchmarks/archive.py [--recordings N] [--length K] [--folder FOLDER] [--workers 1 2] [--rounds R]

Evaluates the same recordings in each way, in turns, `--rounds` times, into a JSON-lines file: in this process, in N
processes, and on a Dask cluster (extra `cluster`; left out where it is missing) of N workers on this machine, each a
process of one thread. The recordings are the ten bundled samples in a temporary folder, each `--length` times one after
the other, or those of FOLDER, <class>/<recording>. A time is that of the whole evaluation, from the list of files to
the finished result file: the processes' start and their compiler are in it; the clusters run, warmed up, before.
`first_s` is the time to the first record, `steady` the rate from there on. Exit code 1 if two ways do not write the
same bytes.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt import load_model, warmup
from async_tnt.archive.collect import Collected, collect_to_file
from async_tnt.archive.executor import Place
from async_tnt.archive.job import Task, job_of, task_of
from async_tnt.archive.records import evaluate_recording
from async_tnt.archive.streamed import evaluation_settings
from async_tnt.checking.timing import machine
from async_tnt.cli.options import writable_file
from async_tnt.files import write_text
from async_tnt.networks.engines import choose_engine
from async_tnt.progress import progress
from async_tnt.sources.class_folders import find_recordings
from async_tnt.sources.files.recording import open_recording, sample_recordings

QUICK = 40  # recordings
REPEAT_US = 315_000  # three windows


def make_archive(folder: Path, n: int, length: int) -> None:
    """`n` recordings, the digits by turns, each of them `length` times one after the other."""
    samples = [(digit, open_recording(path).read()) for digit, path in sample_recordings().items()]
    for k in range(n):
        digit, events = samples[k % len(samples)]
        repeated = np.concatenate([events] * length)
        repeated["t"] += np.repeat(np.arange(length) * REPEAT_US, len(events))
        (folder / str(digit)).mkdir(parents=True, exist_ok=True)
        np.save(folder / str(digit) / f"{k:06d}.npy", repeated)


def tasks_of(folder: Path, n: int | None) -> list[Task]:
    """Tasks of the folder's recordings, or of the first `n` of them, the classes by turns."""
    engine = choose_engine("digits")
    job = job_of("evaluate", "digits", engine, **evaluation_settings(engine.config))
    found = find_recordings(folder, "Test").values()
    paths = sorted((path for paths in found for path in paths), key=lambda path: (path.name, path.parent.name))
    return [task_of(path.relative_to(folder).as_posix(), path, job) for path in paths[:n]]


@contextlib.contextmanager
def clusters(workers: list[int]) -> Iterator[dict[str, Place]]:
    """A cluster on this machine for each number of workers; none where Dask is missing."""
    with contextlib.ExitStack() as stack:
        places = {}
        if importlib.util.find_spec("distributed") is not None:
            from distributed import LocalCluster

            for n in workers:
                made = stack.enter_context(
                    LocalCluster(
                        n_workers=n, threads_per_worker=1, protocol="tcp", host="127.0.0.1", dashboard_address=":0"
                    )
                )
                places[f"dask, {n} worker{'s' if n > 1 else ''}"] = Place(dask=made.scheduler_address)
        yield places


def measure(tasks: list[Task], place: Place, out: Path) -> dict[str, float]:
    """One evaluation: seconds in all, to the first record, and the rate of the others."""
    times = []
    started = time.perf_counter()
    records = collect_to_file(
        evaluate_recording, tasks, place, out, Collected(), each=lambda: times.append(time.perf_counter() - started)
    )
    took = time.perf_counter() - started
    failed = [record["error"] for record in records if record["error"]]
    if failed:
        raise ValueError(f"{len(failed)} recordings cannot be evaluated; {failed[0]}")
    return {"seconds": took, "first_s": times[0], "steady": (len(times) - 1) / max(times[-1] - times[0], 1e-9)}


def measure_all(tasks: list[Task], workers: list[int], rounds: int, folder: Path) -> dict[str, Any]:
    """Every way in turns; medians and quartiles over the rounds, and speed-ups against one worker of the same kind."""
    with clusters(workers) as places:
        ways = {f"processes, {n} worker{'s' if n > 1 else ''}": Place(n) for n in workers} | places
        found: dict[str, list[dict[str, float]]] = {name: [] for name in ways}
        first: bytes | None = None
        for name in places:
            measure(tasks[:50], places[name], folder / "warm.jsonl")
            (folder / "warm.jsonl").unlink()
        with progress(rounds * len(ways), "evaluating") as bar:
            for _ in range(rounds):
                for name, place in ways.items():
                    out = folder / "r.jsonl"
                    found[name].append(measure(tasks, place, out))
                    content = out.read_bytes()
                    out.unlink()
                    first = first or content
                    if content != first:
                        raise RuntimeError(f"{name}: not the bytes of the first evaluation")
                    bar.update()
    n_bytes = sum(task.bytes or 0 for task in tasks)
    report: dict[str, Any] = {"recordings": len(tasks), "bytes": n_bytes, "rounds": rounds, "ways": {}}
    for name, runs in found.items():
        row: dict[str, Any] = {key: spread([run[key] for run in runs]) for key in ("seconds", "first_s", "steady")}
        row["recordings_per_s"] = len(tasks) / row["seconds"]["median"]
        alone = found[f"{name.split(',')[0]}, 1 worker"] if 1 in workers else None
        if alone is not None:  # of the same round: what else the machine did weighs on both
            pairs = list(zip(alone, runs, strict=True))
            row["speedup"] = spread([one["seconds"] / run["seconds"] for one, run in pairs])
            row["steady_speedup"] = spread([run["steady"] / one["steady"] for one, run in pairs])
        report["ways"][name] = row
    return report


def spread(values: list[float]) -> dict[str, float]:
    low, median, high = np.percentile(values, [25, 50, 75])
    return {"median": float(median), "p25": float(low), "p75": float(high)}


def lines(report: dict[str, Any]) -> Iterator[str]:
    """The report as text."""
    size = f"{report['recordings']:,} recordings, {report['bytes'] / 1e6:,.0f} MB"
    yield f"{size}, medians of {report['rounds']} rounds (quartiles)"
    yield f"{'':22}{'seconds':>20}{'recordings/s':>14}{'first after s':>15}{'speed-up':>20}{'steady':>20}"
    for name, row in report["ways"].items():
        told = [_told(row[key]) if key in row else "" for key in ("speedup", "steady_speedup")]
        yield (
            f"{name:22}{_told(row['seconds']):>20}{row['recordings_per_s']:>14,.0f}"
            f"{row['first_s']['median']:>15.2f}{told[0]:>20}{told[1]:>20}"
        )


def _told(found: dict[str, float]) -> str:
    return f"{found['median']:.2f} ({found['p25']:.2f}-{found['p75']:.2f})"


def main(argv: list[str] | None = None) -> int:
    """Measure, print, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, metavar="N", help="so many (default: 500, or all of --folder)")
    parser.add_argument(
        "--length", type=int, default=20, metavar="K", help="samples of 0.3 s in a recording (default: %(default)s)"
    )
    parser.add_argument("--folder", type=Path, metavar="FOLDER", help="<class>/<recording>, such as N-MNIST")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], metavar="N", help="(default: 1 2)")
    parser.add_argument("--rounds", type=int, default=5, metavar="R", help="(default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} recordings, 1 round: does it all run?")
    parser.add_argument("--json", type=writable_file, metavar="FILE", help="also write the figures there")
    args = parser.parse_args(argv)
    if min(args.rounds, args.length, *args.workers, 2 if args.recordings is None else args.recordings - 1) < 1:
        parser.error("--rounds, --length and --workers must be at least 1, --recordings at least 2")
    n = QUICK if args.quick else args.recordings
    warmup(load_model("digits"))
    with tempfile.TemporaryDirectory() as made:
        folder = args.folder
        try:
            if folder is None:
                folder = Path(made, "archive")
                make_archive(folder, n or 500, args.length)
            tasks = tasks_of(folder, n)
            report = measure_all(tasks, args.workers, 1 if args.quick else args.rounds, Path(made))
        except (OSError, ValueError) as error:
            parser.error(str(error))
        except RuntimeError as error:
            print(f"archive.py: {error}", file=sys.stderr)
            return 1
    print("\n".join(lines(report)))
    if args.json:
        write_text(args.json, json.dumps({"machine": machine(), **report}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
