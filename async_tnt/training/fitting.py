"""Make a finished model from windows.

The model is trained. Then a classifier is calibrated on held-out windows, see `temperature`. The
model's record says how it was made.
"""

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
from async_tnt.training.class_statistics import can_have_statistics, with_class_statistics
from async_tnt.training.evaluation import evaluate
from async_tnt.training.loop import TrainResult, train
from async_tnt.training.moved_windows import MIN_MOVED, Motions
from async_tnt.training.objectives import SceneScores
from async_tnt.training.pipeline import pipeline_of
from async_tnt.training.settings import TrainSettings
from async_tnt.training.temperature import calibrated
from async_tnt.training.training_data import TrainingData

STARTED_FROM = ("command", "data", "epochs", "seed", "validation", "test", "started_from")
"""Entries that a continued training copies from the record of the model it starts from."""


@dataclass(frozen=True)
class Fitted:
    """A trained model.

    Parameters
    ----------
    model : the model; a classifier is calibrated if windows are held out. The model's record says
        what it was trained on, how it was trained, and how accurate it is on the held-out windows.
    scores : the scores of the held-out recordings, see `scores_of`. None if nothing is held out,
        and None for a map model.
    history : one dict per epoch, see `train`.
    """

    model: Model
    scores: dict[str, Any] | None
    history: list[dict[str, float]]

    def with_record(self, **entries: Any) -> Fitted:
        """The same model with more entries in its record."""
        return replace(self, model=replace(self.model, record={**self.model.record, **entries}))

    def tested(self, data: TrainingData) -> Fitted:
        """The same model with the accuracy on `data.tests` in its record. This may take long."""
        pipeline = pipeline_of(self.model)
        is_map_model = self.model.places is not None
        entries = {}
        for name, (windows, further_values) in data.tests.items():
            if is_map_model:
                scores = SceneScores(data.config, self.model, windows, data.scenes).evaluate(
                    pipeline
                )
            else:
                scores = evaluate(pipeline, windows, times_ms=moments_ms(self.model)).to_dict()
            entries[name] = {**scores, **further_values}
        return self.with_record(**entries)


def fit(
    data: TrainingData,
    settings: TrainSettings,
    run_folder: Path,
    *,
    start: Model | None = None,
    motions: Motions | None = None,
    teachers: Sequence[Model] = (),
    statistics: bool = True,
    progress: Callable[..., Bar] = Bar,
    report: Callable[[dict[str, float]], None] = lambda row: None,
) -> Fitted:
    """Train a model on `data.training`, and measure its accuracy on `data.validation`.

    A classifier is also calibrated on `data.validation`. A map model is not.

    Parameters
    ----------
    data, settings, run_folder, start, motions, teachers, progress, report : see `loop.train`.
    statistics : whether a classifier gets statistics of its classes, at most 3 MB, so that more
        can be taught, see `Model.with_class`. It gets none if its network has no layer of at most
        4,096 numbers, or if a class has no window to learn from.

    Raises
    ------
    ValueError, OSError : as `loop.train`.
    """
    result = train(
        data,
        settings,
        run_folder,
        start=start,
        motions=motions,
        teachers=teachers,
        progress=progress,
        report=report,
    )
    model = result.model
    record = _record(data, settings, result, start, motions)
    scores = None
    has_validation = len(data.validation) > 0
    is_map_model = settings.everywhere
    if has_validation and is_map_model:
        scorer = SceneScores(data.config, model, data.validation, data.scenes)
        record["validation"] = scorer.evaluate(pipeline_of(model))
    elif has_validation:
        evaluation = evaluate(pipeline_of(model), data.validation, times_ms=moments_ms(model))
        model, temperature = calibrated(model, evaluation.temperature)
        evaluation = evaluation.at_temperature(temperature)
        record["validation"] = evaluation.to_dict()
        record["temperature"] = round(temperature, 5)
        scores = scores_of(data.classes, evaluation.recording_confusion, evaluation.confusion)
    if motions is not None and len(motions.validation) >= MIN_MOVED:
        record["validation_motions"] = _scores_in_motions(model, motions)
    if statistics and not is_map_model and can_have_statistics(model, data.training):
        model = with_class_statistics(model, data.training, progress)
    return Fitted(replace(model, record=record), scores, result.history)


def _record(
    data: TrainingData,
    settings: TrainSettings,
    result: TrainResult,
    start: Model | None,
    motions: Motions | None,
) -> dict[str, Any]:
    """The part of a model's record that says how it was trained."""
    network = "that of the model it started from"
    if start is None:
        network = Path(settings.network).name
    versions = {"python": platform.python_version()}
    for package in ("numpy", "numba", "torch"):
        versions[package] = version(package)
    record: dict[str, Any] = {
        "data": data.record,
        "network": network,
        "multiplications": result.model.multiplications,
        "seed": settings.seed,
        "epochs": len(result.history),
        "iterations": int(result.history[-1]["iterations"]),
        "versions": versions,
    }
    if motions is not None:
        record["motions"] = motions.record
    if start is not None:
        names = [name for name in STARTED_FROM if name in start.record]
        record["started_from"] = {name: start.record[name] for name in names}
    return record


def _scores_in_motions(model: Model, motions: Motions) -> dict[str, Any]:
    """The accuracy on held-out windows under other motions, for the record."""
    scores = evaluate(pipeline_of(model), motions.validation, times_ms=moments_ms(model)).to_dict()
    # Each of these windows is a recording of its own. So the scores by recording would repeat the
    # scores by window.
    return {name: value for name, value in scores.items() if "recording" not in name}


def moments_ms(model: Model) -> tuple[float, ...]:
    """The moments, in milliseconds, at which the accuracy against time is measured.

    They divide a window into ten equal parts. The window's end is not among them. A window that
    slides has no such moments: held-out windows end at several of them, see `windows_of`.
    """
    if model.config.slides:
        return ()
    # 1e4: ten parts, and 1000 microseconds in a millisecond
    return tuple(model.config.window_us * k / 1e4 for k in range(1, 10))
