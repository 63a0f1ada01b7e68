"""The training loop.

The same settings, data and machine give the same weights, even if the training was interrupted and
resumed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.optim.swa_utils import AveragedModel

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.files import locked_folder
from async_tnt.base.progress import Bar
from async_tnt.networks.models.model import Model
from async_tnt.training.augment import Draws
from async_tnt.training.early_end import COOLING, settled_at, share_while_cooling
from async_tnt.training.moved_windows import MIN_MOVED, Motions
from async_tnt.training.objectives import BatchLoss, ClassOfWindows, ObjectsInScenes
from async_tnt.training.pipeline import (
    Pipeline,
    export,
    new_pipeline,
    pipeline_before_export,
)
from async_tnt.training.run_folder import identity_of, load_checkpoint, save_checkpoint
from async_tnt.training.settings import TrainSettings
from async_tnt.training.training_data import TrainingData
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig


@dataclass(frozen=True)
class TrainResult:
    """The model after the last epoch, and the history: a dict of loss and accuracies per epoch."""

    model: Model
    history: list[dict[str, float]]


def train(
    data: TrainingData,
    settings: TrainSettings,
    run_folder: Path,
    *,
    start: Model | None = None,
    motions: Motions | None = None,
    teachers: Sequence[Model] = (),
    progress: Callable[..., Bar] = Bar,
    report: Callable[[dict[str, float]], None] = lambda row: None,
) -> TrainResult:
    """Train a classifier, or a map model.

    After each epoch a checkpoint is written into the run folder. A training that finds a checkpoint
    there resumes from it. It ends with the same weights as if it had never stopped, because all
    randomness is drawn from (seed, epoch). The model has the weights of the last epoch, even if the
    accuracy was higher after an earlier epoch.

    Parameters
    ----------
    data : windows to learn from, and held-out windows, on which the accuracy is measured after each
        epoch. With `settings.ends_early` the held-out windows decide which epoch is the last. They
        decide nothing else.
    settings : how to train.
    run_folder : the folder for checkpoint and history; made if missing.
    start : a model to continue from; None starts with random weights.
    motions : the training windows under other motions, see `moved_windows`. Each epoch shows some
        windows as recorded, and all other windows under another motion.
    teachers : models that the trained model imitates. The mean of their probabilities makes up half
        of the target (Hinton, Vinyals, Dean 2015, arXiv:1503.02531).
    progress : makes the progress bar, which counts optimizer steps.
    report : called after each epoch, when its checkpoint is written, with the history's new row.

    Raises
    ------
    ValueError : there are no training windows, `start` has another configuration or other classes,
        or the run folder holds a run with other settings or data.
    BlockingIOError : another process is training in this run folder.
    """
    _check(data, settings, start, motions, teachers)
    run = _Run(data, settings, run_folder, start, motions, teachers)
    with (
        locked_folder(run_folder, "training.lock"),
        torch.random.fork_rng(devices=[]),
        progress(run.n_iterations, "training", done=len(run.history) * run.n_steps) as bar,
    ):
        for epoch in range(len(run.history), run.n_epochs):
            settled = settled_at(run.history) if settings.ends_early else None
            if settled is not None and epoch >= settled + COOLING:
                break
            run.history.append(run.train_epoch(epoch, settled, bar))
            run.save()
            bar.clear()
            report(run.history[-1])
    return TrainResult(run.model(), run.history)


def _check(
    data: TrainingData,
    settings: TrainSettings,
    start: Model | None,
    motions: Motions | None,
    teachers: Sequence[Model],
) -> None:
    """Refuse arguments of `train` that do not fit each other."""
    config = data.config
    classes = data.classes
    if len(data.training) == 0:
        raise ParameterValueError("training", "must hold at least one window", "none")
    for windows in (data.training, data.validation):
        labels = windows.labels
        is_wrong = (labels < 0) | (labels >= len(classes))
        if is_wrong.any():
            raise ValueError(
                f"labels must be in [0, {len(classes)}), one for each class, got "
                f"{labels[is_wrong][0]}"
            )
    if start is not None and (start.config, start.classes) != (config, classes):
        raise ParameterValueError(
            "start",
            "must have the configuration and classes of this training (classes "
            f"{', '.join(classes)})",
            f"{start.config} and classes {', '.join(start.classes)}",
        )
    for teacher in teachers:
        if (teacher.config.sensor, teacher.classes) != (config.sensor, classes):
            raise ValueError(
                f"each `teacher` must have the sensor {config.sensor} and the classes "
                f"{', '.join(classes)}, got {teacher.config.sensor} and classes "
                f"{', '.join(teacher.classes)}"
            )
    if data.training.recordings.boxes is not None and not settings.everywhere:
        raise ParameterValueError(
            "everywhere", "must be True for windows whose boxes are known", "False"
        )
    if settings.everywhere and (start is not None or motions is not None or teachers):
        raise ValueError(
            "`start`, `motions` and `teachers` are for classes of windows; `everywhere` trains on "
            "scenes"
        )


class _Run:
    """The state of a training between two epochs: networks, optimizer and history.

    A checkpoint holds this state. If the run folder has one, it is loaded. The arguments are those
    of `train`.

    Attributes
    ----------
    history : one dict per finished epoch.
    n_steps : number of steps of an epoch. The last epoch may have fewer.
    n_iterations : number of steps of all epochs.
    n_epochs : number of epochs, unless the training ends early.
    """

    def __init__(
        self,
        data: TrainingData,
        settings: TrainSettings,
        run_folder: Path,
        start: Model | None,
        motions: Motions | None,
        teachers: Sequence[Model],
    ) -> None:
        self._data = data
        self._settings = settings
        self._run_folder = run_folder
        self._motions = motions
        self.n_steps = settings.n_steps(len(data.training))
        self.n_iterations = settings.n_iterations(len(data.training))
        self.n_epochs = settings.n_epochs(len(data.training))

        n_classes = len(data.classes)
        self._window_objective = ClassOfWindows(
            data.config, data.validation, settings, n_classes, teachers
        )
        self._objective: ClassOfWindows | ObjectsInScenes = self._window_objective
        if settings.everywhere:  # a map model
            self._objective = ObjectsInScenes(
                data.config, data.validation, settings, data.classes, data.scenes
            )

        self._device = "cuda" if torch.cuda.is_available() else "cpu"
        self._pipeline = self._first_pipeline(start).to(self._device)
        untyped: Any = self._pipeline  # torch's type stubs of `to` lack `memory_format`
        untyped.to(memory_format=torch.channels_last)  # makes a step a third faster
        average = partial(_average, settings.averaging)
        self._averaged = AveragedModel(self._pipeline, avg_fn=average, use_buffers=True)
        self._optimizer = _optimizer(self._pipeline, settings)
        is_fast = settings.precision == "auto" and _is_fast_at_bfloat16(self._device)
        self._in_16_bits = is_fast or settings.precision == "bfloat16"

        motion_settings = None if motions is None else motions.settings
        self._identity = identity_of(data, settings, start, motion_settings, teachers)
        self.history: list[dict[str, float]] = []
        state = load_checkpoint(run_folder, self._identity)
        if state is not None:
            self._pipeline.load_state_dict(state["pipeline"])
            self._averaged.load_state_dict(state["averaged"])
            self._optimizer.load_state_dict(state["optimizer"])
            self.history = state["history"]

    def _first_pipeline(self, start: Model | None) -> Pipeline:
        """The pipeline at the beginning of the training: with random weights, or with `start`'s."""
        data = self._data
        settings = self._settings
        if start is not None:
            return pipeline_before_export(start, data.training)
        return new_pipeline(
            data.config,
            len(data.classes),
            settings.seed,
            data.training,
            settings.network,
            logarithm=settings.logarithm,
            grid=self._objective.config.grid,
        )

    @property
    def _final_pipeline(self) -> Pipeline:
        """The pipeline whose weights the model gets: averaged, or those of the last step."""
        if not self._settings.averaging:
            return self._pipeline
        averaged: Any = self._averaged.module
        pipeline: Pipeline = averaged
        return pipeline

    def train_epoch(self, epoch: int, settled: int | None, bar: Bar) -> dict[str, float]:
        """Train one epoch. Returns its row of the history.

        epoch : number of the epoch, from 0 on.
        settled : number of epochs after which the training settled, see `settled_at`; None: it has
            not settled yet.
        """
        settings = self._settings
        self._pipeline.train()
        # dropout draws from torch's global generator
        torch.manual_seed(np.random.SeedSequence((settings.seed, epoch)).generate_state(1)[0])
        first_step = epoch * self.n_steps
        n_steps = min(self.n_steps, self.n_iterations - first_step)
        cooling = None
        if settled is not None:
            cooling = settled * self.n_steps, (settled + COOLING) * self.n_steps
        total_loss = 0.0
        n_right = 0
        n_counted = 0
        n_windows = 0
        batches = batches_of(self._data.config, self._data.training, settings, epoch, self._motions)
        for step, (windows, draws) in enumerate(islice(batches, n_steps), first_step):
            _set_rate(self._optimizer, settings, step, self.n_iterations, cooling)
            batch = self._step(windows, draws)
            total_loss += batch.loss.item() * len(windows)
            n_right += batch.n_right
            n_counted += batch.n
            n_windows += len(windows)
            bar.update(title=f"epoch {epoch + 1}/{self.n_epochs}")
        if not math.isfinite(total_loss):
            raise ValueError(
                f"the loss of epoch {epoch + 1} is not finite: the network's numbers grow too large"
            )
        return {
            "epoch": epoch + 1,
            "iterations": first_step + n_steps,
            "loss": total_loss / n_windows,
            "training": n_right / max(1, n_counted),
            **self._objective.validate(self._final_pipeline),
            **self._validate_motions(),
        }

    def _step(self, windows: Windows, draws: Draws | None) -> BatchLoss:
        """Take one step of the optimizer. Returns the loss of the batch."""
        with torch.autocast(self._device, torch.bfloat16, enabled=self._in_16_bits):
            batch = self._objective.loss(self._pipeline, windows, draws)
        self._optimizer.zero_grad(set_to_none=True)
        batch.loss.backward()
        self._optimizer.step()
        if self._settings.averaging:
            self._averaged.update_parameters(self._pipeline)
        return batch

    def _validate_motions(self) -> dict[str, float]:
        """Accuracy and loss on held-out windows under other motions; empty if they are too few."""
        if self._motions is None or len(self._motions.validation) < MIN_MOVED:
            return {}
        scores = self._window_objective.scores(self._final_pipeline, self._motions.validation)
        # each of these windows is a recording of its own
        return {
            f"motions_{name}": value for name, value in scores.items() if name != "per_recording"
        }

    def save(self) -> None:
        """Write the checkpoint and the history."""
        checkpoint = {
            "identity": self._identity,
            "pipeline": self._pipeline.state_dict(),
            "averaged": self._averaged.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "history": self.history,
        }
        save_checkpoint(self._run_folder, checkpoint)

    def model(self) -> Model:
        """The model with the weights as they are now."""
        model = export(self._final_pipeline, self._data.classes, self._objective.config)
        return replace(model, by_share=self._data.scenes is not None)


def batches_of(
    config: TNTConfig,
    windows: Windows,
    settings: TrainSettings,
    epoch: int,
    motions: Motions | None = None,
) -> Iterator[tuple[Windows, Draws | None]]:
    """Yield the batches of one epoch: windows, and how they are augmented."""
    rng = np.random.default_rng((settings.seed, epoch))
    orders = []
    for _ in range(settings.passes):
        if settings.balance:
            orders.append(balanced_order(windows.labels, rng))
        else:
            orders.append(rng.permutation(len(windows)))
    order = np.concatenate(orders)
    shown = windows[order] if motions is None else motions.show(epoch, order, rng)
    if config.slides:
        shown = shown.slid(config.window_us, rng)
    for first in range(0, len(shown), settings.batch):
        batch = shown[first : first + settings.batch]
        draws = None
        if settings.augmentation is not None:
            draws = settings.augmentation.draw(batch, config, rng)
        yield batch, draws


def balanced_order(labels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A random order of window indices in which all classes have equally many indices, or one more.

    The length of the order is the number of labels. If a class has too few windows, they are
    repeated, each time in another order. If a class has too many windows, each epoch shows a
    different part of them.

    The alternative is to show rare classes seldom, but with a large weight in the loss. It is
    worse, because steps are steadier if each batch has windows of a rare class. And augmentation
    makes each repetition different.

    Examples
    --------
    >>> labels = np.array([0, 0, 0, 0, 0, 0, 0, 1])
    >>> np.bincount(labels[balanced_order(labels, np.random.default_rng(0))])
    array([4, 4])
    """
    members = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    counts = np.diff(np.linspace(0, len(labels), len(members) + 1).astype(np.int64))
    # The classes that get one index more are drawn at random.
    rng.shuffle(counts)
    chosen = []
    for indices, count in zip(members, counts, strict=True):
        n_rounds = -(-int(count) // len(indices))  # rounded up
        rounds = [rng.permutation(indices) for _ in range(n_rounds)]
        chosen.append(np.concatenate(rounds)[:count])
    return rng.permutation(np.concatenate(chosen))


def _is_fast_at_bfloat16(device: str) -> bool:
    """Whether the hardware multiplies in 16 bits. For a processor only Linux can tell it."""
    if device.startswith("cuda"):
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    try:
        words = Path("/proc/cpuinfo").read_text(encoding="utf-8").split()
    except OSError:  # a system without this file
        return False
    return not {"amx_bf16", "avx512_bf16", "bf16"}.isdisjoint(words)


def _average(
    share: float, before: torch.Tensor, now: torch.Tensor, n: int | torch.Tensor
) -> torch.Tensor:
    """The moving average of a weight after step n + 1.

    A step keeps `share` of the average before it, but the first steps keep less. Otherwise the
    initial weights would count as much as the weights of hundreds of steps.

    Parameters
    ----------
    share : see `TrainSettings.averaging`.
    before : the average before the step.
    now : the weight after the step.
    n : number of steps in the average so far.
    """
    kept_share = min(share, (1 + int(n)) / (10 + int(n)))
    return before * kept_share + now * (1 - kept_share)


def _optimizer(pipeline: torch.nn.Module, settings: TrainSettings) -> torch.optim.Optimizer:
    """The optimizer AdamW. Its weight decay does not act on biases and other vectors."""
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

    Parameters
    ----------
    optimizer : gets the rate.
    settings : how to train.
    step : number of the step, from 0 on.
    n_steps : number of steps of the whole training, if it does not end early.
    cooling : if the training ends early, the step at which the rate begins to fall, and the step at
        which it would be 0. None: the training has not settled.
    """
    if cooling is None:
        share = _share_of_rate(settings, step, n_steps)
    else:
        # the rate falls from where it was when the training settled
        share = _share_of_rate(settings, cooling[0], n_steps)
        share *= share_while_cooling(step, *cooling)
    for group in optimizer.param_groups:
        group["lr"] = settings.learning_rate * share


def _share_of_rate(settings: TrainSettings, step: int, n_steps: int) -> float:
    """The share of the highest learning rate, at a step of a training that does not end early."""
    n_warm = max(1, int(settings.warm_up * n_steps))
    if step < n_warm:
        return (step + 1) / n_warm
    return 0.5 * (1.0 + math.cos(math.pi * (step - n_warm) / max(1, n_steps - n_warm)))
