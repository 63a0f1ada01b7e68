"""The training loop: the same settings, data and machine give the same weights, interrupted or
not."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.optim.swa_utils import AveragedModel

from async_tnt.base.files import locked_folder
from async_tnt.base.progress import Bar
from async_tnt.networks.models.model import Model
from async_tnt.training.augment import Draws
from async_tnt.training.early_end import COOLING, settled_at, share_while_cooling
from async_tnt.training.moved_windows import MIN_MOVED, Motions
from async_tnt.training.objectives import ClassOfWindows, ObjectsInScenes
from async_tnt.training.pipeline import export, new_pipeline, pipeline_before_export
from async_tnt.training.run_folder import identity_of, load_checkpoint, save_checkpoint
from async_tnt.training.settings import TrainSettings
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig


@dataclass(frozen=True)
class TrainResult:
    """The model after the last epoch, and one dict per epoch (loss, accuracies)."""

    model: Model
    history: list[dict[str, float]]


def train(
    config: TNTConfig,
    training: Windows,
    validation: Windows,
    settings: TrainSettings,
    run_folder: Path,
    *,
    classes: tuple[str, ...],
    start: Model | None = None,
    motions: Motions | None = None,
    teachers: Sequence[Model] = (),
    progress: Callable[..., Bar] = Bar,
    report: Callable[[dict[str, float]], None] = lambda row: None,
) -> TrainResult:
    """Train a classifier, or a map model.

    After each epoch a checkpoint goes into the run folder. A run that finds one there resumes from
    it and ends with the same weights as if it had never stopped: all randomness is drawn from
    (seed, epoch). The weights of the last epoch are kept, whatever its accuracy.

    Parameters
    ----------
    config : how events become volumes.
    training : windows to learn from.
    validation : windows whose accuracy each epoch tells. They choose nothing but, where
        `settings.ends_early`, the last epoch. May be empty.
    run_folder : for checkpoint and history; made if missing.
    classes : names, one for each label from 0 on.
    start : a model to continue from; None starts with random weights.
    motions : other motions of the training windows, shown among these.
    teachers : models whose mean probabilities are half of the target (Hinton, Vinyals, Dean 2015,
        arXiv:1503.02531).
    progress : makes the progress bar, which counts optimizer steps.
    report : called with the history's new row after each epoch, when its checkpoint is written.

    Raises
    ------
    ValueError : no training windows, `start` has another configuration or other classes, or the run
        folder holds a run with other settings or data.
    BlockingIOError : another process is training there.
    """
    _check(config, training, validation, classes, start, teachers)
    if settings.everywhere and (start is not None or motions is not None or teachers):
        raise ValueError(
            "`start`, `motions` and `teachers` are for classes of windows; `everywhere` trains on "
            "scenes"
        )
    windowed = ClassOfWindows(config, validation, settings, len(classes), teachers)
    objective = (
        ObjectsInScenes(config, validation, settings, classes) if settings.everywhere else windowed
    )
    device = "cuda" if torch.cuda.is_available() else "cpu"
    pipeline = (
        new_pipeline(
            config,
            len(classes),
            settings.seed,
            training,
            settings.network,
            logarithm=settings.logarithm,
            grid=objective.config.grid,
        )
        if start is None
        else pipeline_before_export(start, training)
    ).to(device)
    placed: Any = pipeline  # the stubs of `to` know no memory_format
    placed.to(memory_format=torch.channels_last)  # a third faster
    averaged = AveragedModel(
        pipeline, avg_fn=partial(_average, settings.averaging), use_buffers=True
    )
    final: Any = averaged.module if settings.averaging else pipeline
    optimizer = _optimizer(pipeline, settings)
    identity = identity_of(
        config,
        settings,
        training,
        validation,
        start,
        classes,
        motions and motions.settings,
        teachers,
    )
    state = load_checkpoint(run_folder, identity)
    history: list[dict[str, float]] = []
    if state is not None:
        pipeline.load_state_dict(state["pipeline"])
        averaged.load_state_dict(state["averaged"])
        optimizer.load_state_dict(state["optimizer"])
        history = state["history"]

    fast = settings.precision == "auto" and _is_fast_at_bfloat16(device)
    in_16_bits = fast or settings.precision == "bfloat16"
    steps = settings.n_steps(len(training))
    n_iterations = settings.n_iterations(len(training))
    n_epochs = settings.n_epochs(len(training))
    with (
        locked_folder(run_folder, "training.lock"),
        torch.random.fork_rng(devices=[]),
        progress(n_iterations, "training", done=len(history) * steps) as bar,
    ):
        for epoch in range(len(history), n_epochs):
            settled = settled_at(history) if settings.ends_early else None
            if settled is not None and epoch >= settled + COOLING:
                break
            cooling = None if settled is None else (settled * steps, (settled + COOLING) * steps)
            pipeline.train()
            # of dropout
            torch.manual_seed(np.random.SeedSequence((settings.seed, epoch)).generate_state(1)[0])
            total_loss, n_right, n_counted, n_seen = 0.0, 0, 0, 0
            n_steps = min(steps, n_iterations - epoch * steps)
            batches = batches_of(config, training, settings, epoch, motions)
            for step, (windows, draws) in enumerate(islice(batches, n_steps)):
                _set_rate(optimizer, settings, epoch * steps + step, n_iterations, cooling)
                with torch.autocast(device, torch.bfloat16, enabled=in_16_bits):
                    found = objective.loss(pipeline, windows, draws)
                optimizer.zero_grad(set_to_none=True)
                found.loss.backward()
                optimizer.step()
                if settings.averaging:
                    averaged.update_parameters(pipeline)
                total_loss += found.loss.item() * len(windows)
                n_right, n_counted = n_right + found.n_right, n_counted + found.n
                n_seen += len(windows)
                bar.update(title=f"epoch {epoch + 1}/{n_epochs}")
            if not math.isfinite(total_loss):
                raise ValueError(
                    f"the loss of epoch {epoch + 1} is not finite: the network's numbers grow too "
                    "large"
                )
            del windows, draws, batches  # the events of an epoch, before those of the next are read
            history.append(
                {
                    "epoch": epoch + 1,
                    "iterations": epoch * steps + n_steps,
                    "loss": total_loss / n_seen,
                    "training": n_right / max(1, n_counted),
                    **objective.validate(final),
                }
            )
            if motions is not None and len(motions.validation) >= MIN_MOVED:
                moved = windowed.of_windows(final, motions.validation)
                history[-1] |= {
                    f"motions_{name}": moved[name] for name in moved if name != "per_recording"
                }
            checkpoint = {
                "identity": identity,
                "pipeline": pipeline.state_dict(),
                "averaged": averaged.state_dict(),
                "optimizer": optimizer.state_dict(),
                "history": history,
            }
            save_checkpoint(run_folder, checkpoint)
            bar.clear()
            report(history[-1])

    return TrainResult(export(final, classes, objective.config), history)


def _check(
    config: TNTConfig,
    training: Windows,
    validation: Windows,
    classes: tuple[str, ...],
    start: Model | None,
    teachers: Sequence[Model],
) -> None:
    """Refuse arguments of `train` that do not fit each other."""
    if len(training) == 0:
        raise ValueError("`training` must hold at least one window, got none")
    for windows in (training, validation):
        if len(windows) and not 0 <= windows.labels.min() <= windows.labels.max() < len(classes):
            raise ValueError(
                f"labels must be in [0, {len(classes)}), one for each class, got "
                f"{windows.labels.max()}"
            )
    if start is not None and (start.config, start.classes) != (config, classes):
        raise ValueError(
            f"`start` must have the configuration and classes of this training (classes "
            f"{', '.join(classes)}), "
            f"got {start.config} and classes {', '.join(start.classes)}"
        )
    for teacher in teachers:
        if (teacher.config.sensor, teacher.classes) != (config.sensor, classes):
            raise ValueError(
                f"each `teacher` must have the sensor {config.sensor} and the classes "
                f"{', '.join(classes)}, got "
                f"{teacher.config.sensor} and classes {', '.join(teacher.classes)}"
            )


def batches_of(
    config: TNTConfig,
    windows: Windows,
    settings: TrainSettings,
    epoch: int,
    motions: Motions | None = None,
) -> Iterator[tuple[Windows, Draws | None]]:
    """The batches of one epoch, and how each is augmented."""
    rng = np.random.default_rng((settings.seed, epoch))
    order = np.concatenate(
        [
            balanced_order(windows.labels, rng)
            if settings.balance
            else rng.permutation(len(windows))
            for _ in range(settings.passes)
        ]
    )
    shown = windows[order] if motions is None else motions.show(epoch, order, rng)
    for first in range(0, len(shown), settings.batch):
        some = shown[first : first + settings.batch]
        augmentation = settings.augmentation
        yield some, None if augmentation is None else augmentation.draw(some, config, rng)


def balanced_order(labels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """As many indices as there are labels, every class equally often (within one), in random order.

    A class with fewer windows than its share is repeated, each time in another order; of a class
    with more, each epoch shows a different part. We sample rather than weight the loss: a rare
    class in every batch gives steadier steps than one that is seldom shown with a large weight, and
    augmentation makes each repetition different.

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


def _is_fast_at_bfloat16(device: str) -> bool:
    """Whether the hardware multiplies in 16 bits: on a processor, by what Linux says of it."""
    if device.startswith("cuda"):
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    try:
        words = Path("/proc/cpuinfo").read_text(encoding="utf-8").split()
    except OSError:  # not Linux
        return False
    return not {"amx_bf16", "avx512_bf16", "bf16"}.isdisjoint(words)


def _average(
    share: float, before: torch.Tensor, now: torch.Tensor, n: int | torch.Tensor
) -> torch.Tensor:
    """Of the weights after n + 1 steps. The first ones keep less than `share`, or they would count
    for hundreds."""
    kept = min(share, (1 + int(n)) / (10 + int(n)))
    return before * kept + now * (1 - kept)


def _optimizer(pipeline: torch.nn.Module, settings: TrainSettings) -> torch.optim.Optimizer:
    weights = [w for w in pipeline.parameters() if w.ndim > 1]
    biases = [w for w in pipeline.parameters() if w.ndim <= 1]
    groups: list[dict[str, Any]] = [{"params": weights}, {"params": biases, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, lr=settings.learning_rate, weight_decay=settings.weight_decay)


def _set_rate(
    optimizer: torch.optim.Optimizer,
    settings: TrainSettings,
    step: int,
    n_steps: int,
    cooling: tuple[int, int] | None = None,
) -> None:
    """Set the learning rate of a step.

    cooling : of a training that ends early: the first step in which the rate falls, and the step
        where it is 0.
    """
    share = _share_of_rate(settings, step if cooling is None else cooling[0], n_steps)
    if cooling is not None:
        share *= share_while_cooling(step, *cooling)
    for group in optimizer.param_groups:
        group["lr"] = settings.learning_rate * share


def _share_of_rate(settings: TrainSettings, step: int, n_steps: int) -> float:
    """The share of the highest rate, at a step of a training that does not end early."""
    warm = max(1, int(settings.warm_up * n_steps))
    if step < warm:
        return (step + 1) / warm
    return 0.5 * (1.0 + math.cos(math.pi * (step - warm) / max(1, n_steps - warm)))
