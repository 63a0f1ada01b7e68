"""Many recordings on 1 and 2 workers: how much faster are they evaluated, by processes and by a Dask cluster?

    python -m experiments.archive [--recordings N] [--length K] [--folder FOLDER] [--workers 1 2] [--rounds R]

Evaluates the same recordings with each executor, interleaved, `--rounds` times, into a JSON-lines file: in this
process, in N processes, and on a Dask cluster (extra `cluster`; left out if missing) of N workers on this machine, each
a process of one thread. The recordings are the ten bundled samples in a temporary folder, each repeated `--length`
times, or those of FOLDER, <class>/<recording>. A time is that of the whole evaluation, from the list of files to the
finished result file. It includes the start of processes and their compilation; the clusters are started and warmed up
before. `first_s` is the time to the first record, `steady` the rate from there on. Exit code 1 if two executors do not
write the same bytes.
"""

from __future__ import annotations

import contextlib
import importlib.util
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt import load_model, warmup
from async_tnt.evaluation.early import every_us
from async_tnt.evaluation.job import Task, job_of, task_of
from async_tnt.evaluation.processes import run_all, run_on_dask
from async_tnt.evaluation.records import evaluate_recording
from async_tnt.evaluation.results import Progress, Run, collect
from async_tnt.networks.engines import choose_engine
from async_tnt.progress import progress
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.labelled_recordings import find_recordings
from experiments.bench_timing import machine
from experiments.script_options import complain, exit_with, script_parser, write_outputs

QUICK = 40  # recordings
REPEAT_US = 315_000  # three windows


def make_archive(folder: Path, n: int, length: int) -> None:
    """`n` recordings, the digits in turn, each of them repeated `length` times."""
    samples = [(digit, open_recording(path).read()) for digit, path in sample_recordings().items()]
    for k in range(n):
        digit, events = samples[k % len(samples)]
        repeated = np.concatenate([events] * length)
        repeated["t"] += np.repeat(np.arange(length) * REPEAT_US, len(events))
        (folder / str(digit)).mkdir(parents=True, exist_ok=True)
        np.save(folder / str(digit) / f"{k:06d}.npy", repeated)


def tasks_of(folder: Path, n: int | None) -> list[Task]:
    """Tasks of the folder's recordings, or of the first `n` of them, the classes in turn."""
    engine = choose_engine("digits")
    job = job_of("evaluate", "digits", engine, every_us=every_us(engine.config))
    found = find_recordings(folder, "Test").items()
    labelled = sorted((one.path.name, name, one.path) for name, recordings in found for one in recordings)
    return [task_of(path.relative_to(folder).as_posix(), path, job, name) for _, name, path in labelled[:n]]


@contextlib.contextmanager
def clusters(workers: list[int]) -> Iterator[dict[str, Run]]:
    """A cluster on this machine for each number of workers; none if Dask is missing."""
    with contextlib.ExitStack() as stack:
        executors: dict[str, Run] = {}
        if importlib.util.find_spec("distributed") is not None:
            from distributed import LocalCluster

            for n in workers:
                cluster = stack.enter_context(
                    LocalCluster(
                        n_workers=n, threads_per_worker=1, protocol="tcp", host="127.0.0.1", dashboard_address=":0"
                    )
                )
                executors[f"dask, {n} worker{'s' if n > 1 else ''}"] = partial(
                    run_on_dask, address=cluster.scheduler_address
                )
        yield executors


def measure(tasks: list[Task], executor: Run, out: Path) -> dict[str, float]:
    """One evaluation: seconds in all, to the first record, and the rate of the others."""
    times = []
    started = time.perf_counter()
    records = collect(
        evaluate_recording, tasks, executor, out, Progress(), watch=lambda: times.append(time.perf_counter() - started)
    )
    took = time.perf_counter() - started
    failed = [record["error"] for record in records if record["error"]]
    if failed:
        raise ValueError(f"{len(failed)} recordings cannot be evaluated; {failed[0]}")
    _, first, *_, last = times  # before that, the start
    return {"seconds": took, "first_s": first, "steady": (len(tasks) - 1) / max(last - first, 1e-9)}


def measure_all(tasks: list[Task], workers: list[int], rounds: int, folder: Path) -> dict[str, Any]:
    """Medians and quartiles of every executor over the rounds, and speed-ups against one worker of the same kind."""
    with clusters(workers) as of_dask:
        executors = {
            f"processes, {n} worker{'s' if n > 1 else ''}": partial(run_all, workers=n) for n in workers
        } | of_dask
        found: dict[str, list[dict[str, float]]] = {name: [] for name in executors}
        first: bytes | None = None
        for executor in of_dask.values():
            measure(tasks[:50], executor, folder / "warm.jsonl")
            (folder / "warm.jsonl").unlink()
        with progress(rounds * len(executors), "evaluating") as bar:
            for _ in range(rounds):
                for name, executor in executors.items():
                    out = folder / "r.jsonl"
                    found[name].append(measure(tasks, executor, out))
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
        if alone is not None:  # within a round: other load slows both
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
        speedups = [_median(row[key]) if key in row else "" for key in ("speedup", "steady_speedup")]
        yield (
            f"{name:22}{_median(row['seconds']):>20}{row['recordings_per_s']:>14,.0f}"
            f"{row['first_s']['median']:>15.2f}{speedups[0]:>20}{speedups[1]:>20}"
        )


def _median(found: dict[str, float]) -> str:
    return f"{found['median']:.2f} ({found['p25']:.2f}-{found['p75']:.2f})"


def main(argv: list[str] | None = None) -> int:
    """Measure, print, and write JSON if asked."""
    parser = script_parser("archive", __doc__, f"{QUICK} recordings, 1 round")
    parser.add_argument(
        "--recordings", type=int, metavar="N", help="number of recordings (default: 500, or all of --folder)"
    )
    parser.add_argument(
        "--length", type=int, default=20, metavar="K", help="samples of 0.3 s in a recording (default: %(default)s)"
    )
    parser.add_argument("--folder", type=Path, metavar="FOLDER", help="<class>/<recording>, such as N-MNIST")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], metavar="N", help="(default: 1 2)")
    parser.add_argument("--rounds", type=int, default=5, metavar="R", help="(default: %(default)s)")
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
            complain(str(error))
            return 1
    print("\n".join(lines(report)))
    write_outputs(args, {"machine": machine(), **report})
    return 0


if __name__ == "__main__":
    exit_with(main)
