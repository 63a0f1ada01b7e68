"""`async-tnt train`: train a classifier on class folders, or on N-MNIST, simulated recordings, or both."""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from async_tnt.checks import needs_extra
from async_tnt.cli.data_options import command_words
from async_tnt.cli.output import note, say
from async_tnt.cli.train_data import config_of, of_dataset, of_digits
from async_tnt.cli.train_motions import other_motions
from async_tnt.cli.train_option_checks import check_options
from async_tnt.cli.train_options import NETWORK, add_arguments
from async_tnt.evaluation.scores import Scores
from async_tnt.files import check_folder, check_ours, check_writable, locked_folder, write_text
from async_tnt.networks.loading import load_model
from async_tnt.progress import progress
from async_tnt.training.run_folder import BEST, CURVES, LAST, RUN_FILES, has_checkpoint, plot_curves

__all__ = ["add_arguments", "main"]

NUMBERS, PICTURES = ".json", (".curves.png", ".confusion.png")
TITLES = {
    "validation": "held out",
    "validation_motions": "held out, in other motions",
    "test": "Test",
    "test_windows_from_first_event": "Test, windows from the first event",
}


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt train`. Returns the exit code 0."""
    with needs_extra("train", "training needs torch"):
        import torch
        from tnt_reference import Classifier  # noqa: F401
    args.out = args.out or Path("smoke.safetensors" if args.smoke else "model.safetensors")
    run_folder = args.run or Path("runs") / args.out.stem
    check_writable(args.out, (".safetensors",))  # q.pt and q.safetensors would share a run folder and q.json
    if args.dataset is not None:
        beside = [args.out.with_suffix(suffix) for suffix in (NUMBERS, *PICTURES)]
        check_ours(beside, ('"held_out"', '"summary"', '"history"'))
    check_folder(run_folder, RUN_FILES)
    if run_folder.is_dir() and not has_checkpoint(run_folder):
        check_ours([run_folder / name for name in RUN_FILES[1:]], ('"settings"', '"history"'))
    check_options(args)
    if args.threads is not None:
        torch.set_num_threads(args.threads)
    try:
        with locked_folder(run_folder, "command.lock"):
            return _train(args, run_folder)
    except KeyboardInterrupt:
        kept = f"what is finished is kept in {run_folder}. Give the same command again to resume."
        raise KeyboardInterrupt(f"interrupted; {kept}") from None


def _train(args: argparse.Namespace, run_folder: Path) -> int:
    from async_tnt.training.batches import BatchVolumes
    from async_tnt.training.evaluation import evaluate
    from async_tnt.training.loop import train
    from async_tnt.training.pipeline import check_network, pipeline_of
    from async_tnt.training.temperature import calibrated

    start = load_model(args.start_from) if args.start_from else None
    config = config_of(args) if start is None else start.config
    BatchVolumes(config)  # refuses windows that cannot be trained on, before any data is read
    if start is None:
        check_network(args.network or NETWORK, config)
    read = of_dataset if args.dataset is not None else of_digits
    data, settings, sources = read(args, config, start, run_folder)
    config = data.config
    note(f"{len(data.training)} windows to train on, {len(data.validation)} held out")
    n_epochs = settings.n_epochs(len(data.training))
    motions = other_motions(args, data, settings, start, run_folder)
    result = train(
        config,
        data.training,
        data.validation,
        settings,
        run_folder,
        classes=data.classes,
        start=start,
        motions=motions,
        sources=sources,
        progress=progress,
        report=_reporter(n_epochs),
    )
    keep = args.keep or ("last" if settings.patience is None else "best")
    model = result.best if keep == "best" else result.last
    n_trained = len(result.history)
    if n_trained < n_epochs:
        note(
            f"stopped: no lower validation loss for {settings.patience} epochs; the best was epoch {result.best_epoch}"
        )
    summary: dict[str, Any] = {
        "data": data.record,
        "command": _command(args),
        "network": Path(settings.network).name if start is None else "that of the model it started from",
        "seed": args.seed,
        "epochs": n_trained,
        "iterations": int(result.history[-1]["iterations"]),
        "kept": f"epoch {result.best_epoch if keep == 'best' else n_trained}",
        "versions": {"python": platform.python_version()}
        | {name: version(name) for name in ("numpy", "numba", "torch")},
    }
    if motions is not None:
        summary["motions"] = motions.record
    if start is not None:
        names = ("command", "data", "epochs", "seed", "validation", "test", "started_from")
        summary["started_from"] = {name: start.record[name] for name in names if name in start.record}
    times_ms = tuple(config.window_us * k / 1e4 for k in range(1, 10))
    if args.dataset is None:
        times_ms = tuple(float(ms) for ms in range(10, 101, 10))
    scores = None
    if len(data.validation):
        note("evaluating on the held-out recordings")
        found = evaluate(pipeline_of(model), data.validation, times_ms=times_ms)
        model, temperature = calibrated(model, found.temperature)
        found = found.at_temperature(temperature)
        summary |= {"validation": found.to_dict(), "temperature": round(temperature, 5)}
        scores = Scores(data.classes, found.recording_confusion, found.confusion)
    pipeline = pipeline_of(model)
    if motions is not None and len(motions.validation):
        moved = evaluate(pipeline, motions.validation, times_ms=times_ms).to_dict()
        summary["validation_motions"] = {name: moved[name] for name in moved if "recording" not in name}
    result.last.save(run_folder / LAST)
    result.best.save(run_folder / BEST)
    plot_curves(result.history, run_folder / CURVES)

    def save() -> list[Path]:
        """The model with the summary so far and, for a dataset, its numbers beside it."""
        written = [replace(model, record=summary).save(args.out)]
        if args.dataset is not None:
            numbers = {} if scores is None else scores.to_dict()
            numbers |= {"held_out": list(data.held_out), "summary": summary, "history": result.history}
            written.append(args.out.with_suffix(NUMBERS))
            write_text(written[-1], json.dumps(numbers, indent=1))
        return written

    written = save()  # before Test, which may take long; once more with its accuracy
    if args.dataset is not None:
        written += _draw(args.out, scores, result.history)
    if data.tests:
        note("evaluating on Test")
        for name, (windows, record) in data.tests.items():
            summary[name] = {**evaluate(pipeline, windows, times_ms=times_ms).to_dict(), **record}
        save()
    for line in data.left_out:  # once more: the first time may be hours ago
        note(f"left out: {line}")
    _print_summary(summary, args, written)
    return 0


def _reporter(n_epochs: int) -> Callable[[dict[str, float]], None]:
    """Prints a line after an epoch, at most one a second: hundreds of short epochs need no line each."""
    printed_at = -1.0

    def report(row: dict[str, float]) -> None:
        nonlocal printed_at
        if row["epoch"] < n_epochs and 0 <= printed_at > time.monotonic() - 1.0:
            return
        printed_at = time.monotonic()
        text = f"epoch {row['epoch']:.0f}/{n_epochs}  loss {row['loss']:.4f}"
        if "per_window" in row:
            text += f"  held out: {row['per_window']:.4f} by window, {row['per_recording']:.4f} by recording"
        if "motions_per_window" in row:
            text += f"; in other motions {row['motions_per_window']:.4f} by window"
        note(text)

    return report


def _draw(out: Path, scores: Scores | None, history: list[dict[str, float]]) -> list[Path]:
    """Draw <out>.curves.png and <out>.confusion.png where matplotlib is installed; returns the files."""
    curves, confusion = (out.with_suffix(suffix) for suffix in PICTURES)
    if not plot_curves(history, curves):
        note("no pictures: matplotlib is not installed (pip install 'async_tnt[plot]')")
        return []
    if scores is None:
        return [curves]
    from async_tnt.views.figure_confusion import write_confusion

    title = f"{out.stem}: {scores.accuracy:.1%} of {scores.confusion.sum()} held-out recordings right"
    return [curves, write_confusion(scores.confusion, scores.classes, confusion, title)]


def _command(args: argparse.Namespace) -> str:
    """The command as given, without paths; but --mask is kept, as it decides what is learned."""
    words = command_words("async-tnt train", args, add_arguments, leave_out=("json", "skip_damaged", "workers"))
    return words if args.mask is None else f"{words} --mask MASK"


def _print_summary(summary: dict[str, Any], args: argparse.Namespace, written: list[Path]) -> None:
    if args.json:
        say(json.dumps({"out": str(args.out), **summary}))
        return
    for name, title in TITLES.items():
        if name in summary:
            found = summary[name]
            by_recording = ""
            if "recordings" in found:
                by_recording = f", {found['per_recording']:.4f} of {found['recordings']} recordings"
            say(f"{title}: {found['per_window']:.4f} of {found['windows']} windows{by_recording} right")
    say(f"wrote {', '.join(map(str, written))}")
