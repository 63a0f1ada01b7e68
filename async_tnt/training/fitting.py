"""From windows to a finished model: trained, calibrated on what was held out, with a record of how
it was made."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from async_tnt.base.progress import Bar
from async_tnt.evaluation.scores import scores_of
from async_tnt.networks.models.model import Model
from async_tnt.training.data import TrainingData
from async_tnt.training.evaluation import evaluate
from async_tnt.training.loop import train
from async_tnt.training.moved_windows import MIN_MOVED, Motions
from async_tnt.training.objectives import SceneScores
from async_tnt.training.pipeline import pipeline_of
from async_tnt.training.settings import TrainSettings
from async_tnt.training.temperature import calibrated

STARTED_FROM = ("command", "data", "epochs", "seed", "validation", "test", "started_from")
"""What the new model's record keeps of the record of the model that its training continued."""


@dataclass(frozen=True)
class Fitted:
    """A trained model.

    Parameters
    ----------
    model : calibrated; its record says what it was trained on, how, and how accurate it is on what
        was held out.
    scores : of the held-out recordings, see `scores_of`; None where nothing is held out, and of a
        map model.
    history : one dict per epoch, see `train`.
    """

    model: Model
    scores: dict[str, Any] | None
    history: list[dict[str, float]]

    def tested(self, data: TrainingData) -> Fitted:
        """The same with the accuracy on `data.tests` in the record. This may take long."""
        pipeline, record = pipeline_of(self.model), dict(self.model.record)
        for name, (windows, more) in data.tests.items():
            if self.model.places is not None:
                found = SceneScores(data.config, self.model, windows).to_dict(pipeline)
            else:
                found = evaluate(pipeline, windows, times_ms=moments_ms(self.model)).to_dict()
            record[name] = {**found, **more}
        return replace(self, model=replace(self.model, record=record))


def fit(
    data: TrainingData,
    settings: TrainSettings,
    run_folder: Path,
    *,
    start: Model | None = None,
    motions: Motions | None = None,
    teachers: Sequence[Model] = (),
    record: dict[str, Any] | None = None,
    progress: Callable[..., Bar] = Bar,
    report: Callable[[dict[str, float]], None] = lambda row: None,
) -> Fitted:
    """Train on `data.training`; choose the temperature and measure the accuracy on
    `data.validation`.

    Parameters
    ----------
    record : more for the model's record.
    data, settings, run_folder, start, motions, teachers, progress, report : see `train`, whose
        errors pass through.
    """
    result = train(
        data.config,
        data.training,
        data.validation,
        settings,
        run_folder,
        classes=data.classes,
        start=start,
        motions=motions,
        teachers=teachers,
        progress=progress,
        report=report,
    )
    model, history = result.model, result.history
    summary: dict[str, Any] = {
        "data": data.record,
        **(record or {}),
        "network": Path(settings.network).name
        if start is None
        else "that of the model it started from",
        "multiplications": model.multiplications,
        "seed": settings.seed,
        "epochs": len(history),
        "iterations": int(history[-1]["iterations"]),
        "versions": {"python": platform.python_version()}
        | {name: version(name) for name in ("numpy", "numba", "torch")},
    }
    if motions is not None:
        summary["motions"] = motions.record
    if start is not None:
        summary["started_from"] = {
            name: start.record[name] for name in STARTED_FROM if name in start.record
        }
    scores = None
    if settings.everywhere and len(data.validation):
        summary["validation"] = SceneScores(data.config, model, data.validation).to_dict(
            pipeline_of(model)
        )
    elif len(data.validation):
        found = evaluate(pipeline_of(model), data.validation, times_ms=moments_ms(model))
        model, temperature = calibrated(model, found.temperature)
        found = found.at_temperature(temperature)
        summary |= {"validation": found.to_dict(), "temperature": round(temperature, 5)}
        scores = scores_of(data.classes, found.recording_confusion, found.confusion)
    if motions is not None and len(motions.validation) >= MIN_MOVED:
        moved = evaluate(
            pipeline_of(model), motions.validation, times_ms=moments_ms(model)
        ).to_dict()
        summary["validation_motions"] = {
            name: moved[name] for name in moved if "recording" not in name
        }
    return Fitted(replace(model, record=summary), scores, history)


def moments_ms(model: Model) -> tuple[float, ...]:
    """The moments at which accuracy is reported against time: each tenth of a window but its end,
    in milliseconds."""
    return tuple(model.config.window_us * k / 1e4 for k in range(1, 10))
