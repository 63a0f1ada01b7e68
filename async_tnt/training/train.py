"""The training loop: the same settings, data and machine give the same weights, interrupted or not."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F

from async_tnt.config import TNTConfig
from async_tnt.model import Model
from async_tnt.whole_files import replacing

from .augment import Draws
from .evaluate import accuracy_by_recording, class_probabilities
from .networks import export, pipeline_before_export
from .pipelines import Pipeline, new_pipeline
from .run_folder import other_run
from .settings import TrainSettings
from .windows import CLASSES, Progress, Windows, no_progress

FORMAT = 2  # of the checkpoint
CHECKPOINT = "checkpoint.pt"
HISTORY = "history.json"


@dataclass(frozen=True)
class TrainResult:
    """The models after the last and after the best epoch, and one dict per epoch (loss, accuracies)."""

    last: Model
    best: Model
    best_epoch: int
    history: list[dict[str, float]]


def train(
    config: TNTConfig,
    training: Windows,
    validation: Windows,
    settings: TrainSettings,
    run_folder: Path,
    *,
    classes: tuple[str, ...] = CLASSES,
    start: Model | None = None,
    progress: Progress = no_progress,
    report: Callable[[dict[str, float]], None] = lambda row: None,
    device: str | None = None,
) -> TrainResult:
    """Train the thesis' classifier.

    After each epoch a checkpoint goes into the run folder; a run that finds one there goes on from it and
    ends with the same weights as if it had never stopped, for all randomness is drawn from (seed, epoch).

    Parameters
    ----------
    config : how events become volumes.
    training : windows to learn from.
    validation : windows that choose the best epoch (the later of equals); may be empty: then it is the last, and
        no patience runs out.
    run_folder : for checkpoint and history; made if missing.
    classes : names, one for each label from 0 on.
    start : a model to train on from; None starts with random weights.
    progress : shows each epoch's steps.
    report : called with the history's new row after each epoch, when its checkpoint is written.
    device : of torch; a GPU where torch sees one, else the CPU.

    Raises
    ------
    ValueError : no training windows, `start` has another configuration or other classes, or the run folder
        holds a run with other settings or data.
    """
    if len(training) == 0:
        raise ValueError("`training` must hold at least one window, got none")
    for windows in (training, validation):
        if len(windows) and not 0 <= windows.labels.min() <= windows.labels.max() < len(classes):
            raise ValueError(f"labels must be in [0, {len(classes)}), one for each class, got {windows.labels.max()}")
    if start is not None and (start.config, start.classes) != (config, classes):
        raise ValueError(
            f"`start` must have the configuration and classes of this training (classes {', '.join(classes)}), "
            f"got {start.config} and classes {', '.join(start.classes)}"
        )
    device = device or ("cuda" if torch.cuda.is_available() else "cpu")
    run_folder.mkdir(parents=True, exist_ok=True)
    pipeline = (
        new_pipeline(config, len(classes), settings.seed, training)
        if start is None
        else pipeline_before_export(start, training)
    ).to(device)
    placed: Any = pipeline  # the stubs of `to` know no memory_format
    placed.to(memory_format=torch.channels_last)  # a third faster
    optimizer = _optimizer(pipeline, settings)
    identity = _identity(config, settings, training, validation, start, classes)
    state = _load_checkpoint(run_folder / CHECKPOINT, identity)
    history: list[dict[str, float]] = []
    best: dict[str, torch.Tensor] = {}
    best_epoch = 0
    if state is not None:
        pipeline.load_state_dict(state["pipeline"])
        optimizer.load_state_dict(state["optimizer"])
        history, best, best_epoch = state["history"], state["best"], state["best_epoch"]

    steps = math.ceil(len(training) / settings.batch)
    n_iterations = settings.n_iterations(len(training))
    n_epochs = settings.n_epochs(len(training))
    for epoch in range(len(history), n_epochs):
        if settings.patience is not None and epochs_since_best(history) >= settings.patience:
            break
        pipeline.train()
        total_loss, right, seen = 0.0, 0, 0
        here = min(steps, n_iterations - epoch * steps)
        batches = islice(_batches(config, training, settings, epoch), here)
        for step, (windows, draws) in enumerate(progress(batches, f"epoch {epoch + 1}/{n_epochs}", here)):
            _set_rate(optimizer, settings, epoch * steps + step, n_iterations)
            target = torch.from_numpy(windows.labels).to(device)
            with torch.autocast(device, torch.bfloat16, enabled=settings.precision == "bfloat16"):
                logits = pipeline(windows, draws)
            loss = F.cross_entropy(logits, target, label_smoothing=settings.label_smoothing)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            total_loss += loss.item() * len(windows)
            right += int((logits.argmax(1) == target).sum())
            seen += len(windows)
        row = {
            "epoch": epoch + 1, "iterations": epoch * steps + here, "loss": total_loss / seen, "training": right / seen,
        }  # fmt: skip
        row.update(_validate(pipeline, validation, balance=settings.balance))
        history.append(row)
        if _is_best(history, by_loss=settings.patience is not None):
            best_epoch = epoch + 1
            best = {name: w.detach().clone() for name, w in pipeline.state_dict().items()}
        checkpoint = {
            "identity": identity, "pipeline": pipeline.state_dict(), "optimizer": optimizer.state_dict(),
            "history": history, "best": best, "best_epoch": best_epoch,
        }  # fmt: skip
        with replacing(run_folder / CHECKPOINT) as part:
            torch.save(checkpoint, part)
        text = json.dumps({"settings": json.loads(identity), "history": history}, indent=1)
        with replacing(run_folder / HISTORY) as part:
            part.write_text(text, encoding="utf-8")
        report(row)

    last = export(pipeline, classes, {})
    pipeline.load_state_dict(best)
    return TrainResult(last, export(pipeline, classes, {}), best_epoch, history)


def epochs_since_best(history: list[dict[str, float]]) -> int:
    """Epochs since the validation loss was lowest (the later of equals); 0 without validation."""
    losses = [row["validation_loss"] for row in history if "validation_loss" in row]
    return losses[::-1].index(min(losses)) if losses else 0


def _is_best(history: list[dict[str, float]], *, by_loss: bool) -> bool:
    """Whether the newest epoch is."""
    if by_loss:
        return epochs_since_best(history) == 0
    return history[-1].get("per_window", 0.0) >= max(row.get("per_window", 0.0) for row in history)


def _batches(
    config: TNTConfig, windows: Windows, settings: TrainSettings, epoch: int
) -> Iterator[tuple[Windows, Draws | None]]:
    rng = np.random.default_rng((settings.seed, epoch))
    order = balanced_order(windows.labels, rng) if settings.balance else rng.permutation(len(windows))
    for first in range(0, len(order), settings.batch):
        some = windows[order[first : first + settings.batch]]
        augmentation = settings.augmentation
        yield some, None if augmentation is None else augmentation.draw(len(some), config, rng)


def balanced_order(labels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """As many places as there are labels, every class equally often (to one place), in random order.

    A class with fewer windows than its share is gone through again and again, each time in another order; of one with
    more, each epoch shows others. We sample rather than weigh the loss: a rare class in every batch gives steadier
    steps than one that comes seldom with a large weight, and augmentation makes every showing of a window another.

    Examples
    --------
    >>> labels = np.array([0, 0, 0, 0, 0, 0, 0, 1])
    >>> np.bincount(labels[balanced_order(labels, np.random.default_rng(0))])
    array([4, 4])
    """
    members = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    shares = np.diff(np.linspace(0, len(labels), len(members) + 1).astype(np.int64))
    rng.shuffle(shares)  # whose share is one larger
    chosen = []
    for places, share in zip(members, shares, strict=True):
        rounds = -(-int(share) // len(places))
        chosen.append(np.concatenate([rng.permutation(places) for _ in range(rounds)])[:share])
    return rng.permutation(np.concatenate(chosen))


def _validate(pipeline: Pipeline, windows: Windows, *, balance: bool) -> dict[str, float]:
    if len(windows) == 0:
        return {}
    probabilities = class_probabilities(pipeline, windows)
    per_window = float((probabilities.argmax(1) == windows.labels).mean())
    log_likelihood = np.log(probabilities[np.arange(len(windows)), windows.labels] + 1e-12)
    if balance:  # else, of 95 windows of one class and 5 of another, the 5 would hardly count
        loss = -float(np.mean([log_likelihood[windows.labels == label].mean() for label in np.unique(windows.labels)]))
    else:
        loss = -float(log_likelihood.mean())
    return {
        "per_window": per_window,
        "per_recording": accuracy_by_recording(probabilities, windows)[0],
        "validation_loss": loss,
    }


def _optimizer(pipeline: Pipeline, settings: TrainSettings) -> torch.optim.Optimizer:
    weights = [w for w in pipeline.parameters() if w.ndim > 1]
    biases = [w for w in pipeline.parameters() if w.ndim == 1]
    groups: list[dict[str, Any]] = [{"params": weights}, {"params": biases, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, lr=settings.learning_rate, weight_decay=settings.weight_decay)


def _set_rate(optimizer: torch.optim.Optimizer, settings: TrainSettings, step: int, n_steps: int) -> None:
    warm = max(1, n_steps // 20)
    if step < warm:
        share = (step + 1) / warm
    else:
        share = 0.5 * (1.0 + math.cos(math.pi * (step - warm) / max(1, n_steps - warm)))
    for group in optimizer.param_groups:
        group["lr"] = settings.learning_rate * share


def _identity(
    config: TNTConfig,
    settings: TrainSettings,
    training: Windows,
    validation: Windows,
    start: Model | None,
    classes: tuple[str, ...],
) -> str:
    """All that decides the weights, as JSON: a checkpoint goes on only where it is the same."""
    data = zlib.crc32(training.recordings.offsets.tobytes())
    for windows in (training, validation):
        for column in (windows.recording, windows.start_us, windows.labels):
            data = zlib.crc32(column.tobytes(), data)
    for name in "txyp":
        data = zlib.crc32(np.ascontiguousarray(getattr(training.recordings, name)[::997]).tobytes(), data)
    return json.dumps(
        {
            "format": FORMAT,
            "config": config.to_dict(),
            # without what older runs had no name for, so that they go on
            "settings": {n: v for n, v in asdict(settings).items() if v or n not in ("balance", "patience")},
            "training_windows": len(training),
            "validation_windows": len(validation),
            "data": data,
            "classes": zlib.crc32(json.dumps(classes).encode()) if classes != CLASSES else 0,
            "start": 0 if start is None else zlib.crc32(b"".join(w.tobytes() for w in start.weights.values())),
        }
    )


def check_run(run_folder: Path, config: Mapping[str, Any], settings: Mapping[str, Any]) -> bool:
    """Whether the folder holds a run already; refuses one of others than these, before any data is read.

    Parameters
    ----------
    config, settings : fields of `TNTConfig` and `TrainSettings` and their values; not all need be known yet.

    Raises
    ------
    ValueError : the run's differ; names them. Or its checkpoint is damaged.
    """
    state = _read_checkpoint(run_folder / CHECKPOINT)
    if state is None:
        return False
    found = json.loads(state["identity"])
    wanted = json.loads(json.dumps({"config": dict(config), "settings": dict(settings)}))
    differ = sorted(
        name
        for part, values in wanted.items()
        for name, value in values.items()
        if (found[part].get(name) or None)
        != (value or None)  # older runs lack names whose value was then False or None
    )
    if differ:
        raise other_run(run_folder, ", ".join(differ))
    return True


def _read_checkpoint(path: Path) -> dict[str, Any] | None:
    if not path.exists():
        return None
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
        json.loads(state["identity"])
        return state
    except Exception as error:  # a damaged archive surfaces as any of a dozen types
        kind = type(error).__name__  # not its text: torch's advises loading the file unsafely
        raise ValueError(f"{path} is not a readable checkpoint ({kind}); remove it to start anew") from error


def _load_checkpoint(path: Path, identity: str) -> dict[str, Any] | None:
    state = _read_checkpoint(path)
    if state is None:
        return None
    found = json.loads(state["identity"])
    wanted = json.loads(identity)
    differ = sorted(
        name
        for part in ("config", "settings")
        for name in {**found[part], **wanted[part]}
        if found[part].get(name) != wanted[part].get(name)
    )
    differ += [
        name
        for name in ("format", "training_windows", "validation_windows", "data", "classes", "start")
        if found.get(name, 0) != wanted[name]
    ]
    if differ:
        raise other_run(path.parent, ", ".join(differ))
    return state
