"""The training loop: the same settings, data and machine give the same weights, interrupted or not."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F

from async_tnt.config import TNTConfig
from async_tnt.networks.model import Model
from async_tnt.training.checkpoint import identity_of, load_checkpoint, save_checkpoint
from async_tnt.training.epoch import batches_of
from async_tnt.training.evaluate import accuracy_by_recording, class_probabilities
from async_tnt.training.networks import export, pipeline_before_export
from async_tnt.training.pipelines import Pipeline, new_pipeline
from async_tnt.training.settings import TrainSettings
from async_tnt.training.windows import CLASSES, Progress, Windows, no_progress


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
    identity = identity_of(config, settings, training, validation, start, classes)
    state = load_checkpoint(run_folder, identity)
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
        batches = islice(batches_of(config, training, settings, epoch), here)
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
            "epoch": epoch + 1,
            "iterations": epoch * steps + here,
            "loss": total_loss / seen,
            "training": right / seen,
        }
        row.update(_validate(pipeline, validation, balance=settings.balance))
        history.append(row)
        if _is_best(history, by_loss=settings.patience is not None):
            best_epoch = epoch + 1
            best = {name: w.detach().clone() for name, w in pipeline.state_dict().items()}
        checkpoint = {
            "identity": identity,
            "pipeline": pipeline.state_dict(),
            "optimizer": optimizer.state_dict(),
            "history": history,
            "best": best,
            "best_epoch": best_epoch,
        }
        save_checkpoint(run_folder, checkpoint)
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
