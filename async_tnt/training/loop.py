"""The training loop: the same settings, data and machine give the same weights, interrupted or not."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F

from async_tnt.config import TNTConfig
from async_tnt.evaluation.scores import share_right
from async_tnt.files import locked_folder
from async_tnt.networks.model import Model
from async_tnt.progress import Bar, no_progress
from async_tnt.training.augment import Draws
from async_tnt.training.evaluation import class_probabilities, confusion_by_recording
from async_tnt.training.moved_windows import Motions
from async_tnt.training.pipeline import Pipeline, export, new_pipeline, pipeline_before_export
from async_tnt.training.run_folder import identity_of, load_checkpoint, save_checkpoint
from async_tnt.training.settings import TrainSettings
from async_tnt.training.windows import CLASSES, Windows


@dataclass(frozen=True)
class TrainResult:
    """The models after the last and after the best epoch, and one dict per epoch (loss, accuracies)."""

    last: Model
    """After the last epoch."""
    best: Model
    """After the best epoch."""
    best_epoch: int
    """Its number, from 1."""
    history: list[dict[str, float]]
    """One row per epoch."""


def train(
    config: TNTConfig,
    training: Windows,
    validation: Windows,
    settings: TrainSettings,
    run_folder: Path,
    *,
    classes: tuple[str, ...] = CLASSES,
    start: Model | None = None,
    motions: Motions | None = None,
    sources: Mapping[str, Any] | None = None,
    progress: Callable[..., Bar] = no_progress,
    report: Callable[[dict[str, float]], None] = lambda row: None,
    device: str | None = None,
) -> TrainResult:
    """Train a classifier.

    After each epoch a checkpoint goes into the run folder. A run that finds one there resumes from it and ends with
    the same weights as if it had never stopped: all randomness is drawn from (seed, epoch).

    Parameters
    ----------
    config : how events become volumes.
    training : windows to learn from.
    validation : windows that choose the best epoch (the later of equals). May be empty: then the last epoch is the
        best, and patience has no effect.
    settings : how long to train, and how.
    run_folder : for checkpoint and history; made if missing.
    classes : names, one for each label from 0 on.
    start : a model to continue from; None starts with random weights.
    motions : other motions of the training windows, shown among these; then held-out windows under other motions
        choose the best epoch.
    sources : kept in the checkpoint, so that `check_run` can compare it before any data is read.
    progress : makes the progress bar, which counts optimizer steps.
    report : called with the history's new row after each epoch, when its checkpoint is written.
    device : of torch; by default a GPU where torch finds one, else the CPU.

    Raises
    ------
    ValueError : no training windows, `start` has another configuration or other classes, or the run folder
        holds a run with other settings or data.
    BlockingIOError : another process is training there.
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
    pipeline = (
        new_pipeline(config, len(classes), settings.seed, training, settings.network)
        if start is None
        else pipeline_before_export(start, training)
    ).to(device)
    placed: Any = pipeline  # the stubs of `to` know no memory_format
    placed.to(memory_format=torch.channels_last)  # a third faster
    optimizer = _optimizer(pipeline, settings)
    identity = identity_of(config, settings, training, validation, start, classes, motions and motions.settings)
    state = load_checkpoint(run_folder, identity)
    history: list[dict[str, float]] = []
    best: dict[str, torch.Tensor] = {}
    best_epoch = 0
    if state is not None:
        pipeline.load_state_dict(state["pipeline"])
        optimizer.load_state_dict(state["optimizer"])
        history, best, best_epoch = state["history"], state["best"], state["best_epoch"]

    steps = settings.n_steps(len(training))
    n_iterations = settings.n_iterations(len(training))
    n_epochs = settings.n_epochs(len(training))
    with (
        locked_folder(run_folder, "training.lock"),
        torch.random.fork_rng(devices=[]),
        progress(n_iterations, "training", done=len(history) * steps) as bar,
    ):
        for epoch in range(len(history), n_epochs):
            if settings.patience is not None and epochs_since_best(history) >= settings.patience:
                break
            pipeline.train()
            torch.manual_seed(np.random.SeedSequence((settings.seed, epoch)).generate_state(1)[0])  # of dropout
            total_loss, n_right, n_of_a_class, n_seen = 0.0, 0, 0, 0
            n_steps = min(steps, n_iterations - epoch * steps)
            batches = batches_of(config, training, settings, epoch, motions)
            for step, (windows, draws) in enumerate(islice(batches, n_steps)):
                _set_rate(optimizer, settings, epoch * steps + step, n_iterations)
                target = _targets(windows.labels, draws, len(classes)).to(device)
                with torch.autocast(device, torch.bfloat16, enabled=settings.precision == "bfloat16"):
                    logits = pipeline(windows, draws)
                loss = F.cross_entropy(logits, target, label_smoothing=settings.label_smoothing)
                optimizer.zero_grad(set_to_none=True)
                loss.backward()
                optimizer.step()
                total_loss += loss.item() * len(windows)
                of_a_class = target.amax(1) == 1.0
                n_right += int((logits.argmax(1) == target.argmax(1))[of_a_class].sum())
                n_of_a_class += int(of_a_class.sum())
                n_seen += len(windows)
                bar.update(title=f"epoch {epoch + 1}/{n_epochs}")
            del windows, draws, batches  # the events of an epoch, before those of the next are read
            history.append(
                {
                    "epoch": epoch + 1,
                    "iterations": epoch * steps + n_steps,
                    "loss": total_loss / n_seen,
                    "training": n_right / max(1, n_of_a_class),
                    **_validate(pipeline, validation, settings),
                }
            )
            if motions is not None:
                moved = _validate(pipeline, motions.validation, settings)
                history[-1] |= {f"motions_{name}": moved[name] for name in moved if name != "per_recording"}
            if _is_best(history, by_loss=settings.patience is not None):
                best_epoch = epoch + 1
                best = {name: w.detach().clone() for name, w in pipeline.state_dict().items()}
            checkpoint = {
                "identity": identity,
                "sources": dict(sources or {}),
                "pipeline": pipeline.state_dict(),
                "optimizer": optimizer.state_dict(),
                "history": history,
                "best": best,
                "best_epoch": best_epoch,
            }
            save_checkpoint(run_folder, checkpoint)
            bar.clear()
            report(history[-1])

    last = export(pipeline, classes, {})
    pipeline.load_state_dict(best)
    return TrainResult(last, export(pipeline, classes, {}), best_epoch, history)


def batches_of(
    config: TNTConfig, windows: Windows, settings: TrainSettings, epoch: int, motions: Motions | None = None
) -> Iterator[tuple[Windows, Draws | None]]:
    """The batches of one epoch, and how each is augmented."""
    rng = np.random.default_rng((settings.seed, epoch))
    order = balanced_order(windows.labels, rng) if settings.balance else rng.permutation(len(windows))
    shown = windows[order] if motions is None else motions.show(epoch, order, rng)
    for first in range(0, len(shown), settings.batch):
        some = shown[first : first + settings.batch]
        augmentation = settings.augmentation
        yield some, None if augmentation is None else augmentation.draw(len(some), config, rng)


def balanced_order(labels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """As many indices as there are labels, every class equally often (within one), in random order.

    A class with fewer windows than its share is repeated, each time in another order; of a class with more, each epoch
    shows a different part. We sample rather than weight the loss: a rare class in every batch gives steadier steps than
    one that is seldom shown with a large weight, and augmentation makes each repetition different.

    Examples
    --------
    >>> labels = np.array([0, 0, 0, 0, 0, 0, 0, 1])
    >>> np.bincount(labels[balanced_order(labels, np.random.default_rng(0))])
    array([4, 4])
    """
    members = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    shares = np.diff(np.linspace(0, len(labels), len(members) + 1).astype(np.int64))
    rng.shuffle(shares)  # which class gets one more
    chosen = []
    for places, share in zip(members, shares, strict=True):
        rounds = -(-int(share) // len(places))
        chosen.append(np.concatenate([rng.permutation(places) for _ in range(rounds)])[:share])
    return rng.permutation(np.concatenate(chosen))


def epochs_since_best(history: list[dict[str, float]]) -> int:
    """Epochs since the validation loss, under other motions if there are any, was lowest (the later of equals); 0
    without validation."""
    losses = [row.get("motions_validation_loss", row["validation_loss"]) for row in history if "validation_loss" in row]
    return losses[::-1].index(min(losses)) if losses else 0


def _is_best(history: list[dict[str, float]], *, by_loss: bool) -> bool:
    """Whether the newest epoch is the best."""
    if by_loss:
        return epochs_since_best(history) == 0
    right = [row.get("motions_per_window", row.get("per_window", 0.0)) for row in history]
    return right[-1] >= max(right)


def _targets(labels: np.ndarray, draws: Draws | None, n_classes: int) -> torch.Tensor:
    """(N, n_classes): all on the class; the same on all classes where nothing is shown (Hendrycks, Mazeika, Dietterich
    2019, arXiv:1812.04606), so that no class is decided with confidence."""
    targets = np.eye(n_classes, dtype=np.float32)[labels]
    if draws is not None:
        targets[draws.scatter] = 1.0 / n_classes
    return torch.from_numpy(targets)


def _validate(pipeline: Pipeline, windows: Windows, settings: TrainSettings) -> dict[str, float]:
    """Accuracy at the windows' ends. The loss, and the share that is right at any moment, are those at the ends and,
    for as many windows as in training, at a tenth of each; with `balance`, means over classes."""
    if len(windows) == 0:
        return {}
    probabilities = class_probabilities(pipeline, windows)
    loss = _loss(probabilities, windows.labels, balance=settings.balance)
    right = probabilities.argmax(1) == windows.labels
    per_moment = _mean(right, windows.labels, balance=settings.balance)
    partial = 0.0 if settings.augmentation is None else settings.augmentation.partial
    if partial:
        until_us = (1 + np.arange(len(windows)) % 10) * pipeline.config.window_us // 10
        early = class_probabilities(pipeline, windows, until_us=until_us)
        loss += partial * (_loss(early, windows.labels, balance=settings.balance) - loss)
        right_early = _mean(early.argmax(1) == windows.labels, windows.labels, balance=settings.balance)
        per_moment += partial * (right_early - per_moment)
    return {
        "per_window": float(right.mean()),
        "per_recording": share_right(confusion_by_recording(probabilities, windows)),
        "per_moment": per_moment,
        "validation_loss": loss,
    }


def _loss(probabilities: np.ndarray, labels: np.ndarray, *, balance: bool) -> float:
    return -_mean(np.log(probabilities[np.arange(len(labels)), labels] + 1e-12), labels, balance=balance)


def _mean(values: np.ndarray, labels: np.ndarray, *, balance: bool) -> float:
    if balance:  # with 95 windows of one class and 5 of another, the 5 would hardly count
        return float(np.mean([values[labels == label].mean() for label in np.unique(labels)]))
    return float(values.mean())


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
