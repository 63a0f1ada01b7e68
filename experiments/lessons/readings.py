"""Readings of many recordings, and how often they are decided right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from async_tnt import Model, open_recording
from async_tnt.base.progress import progress
from async_tnt.evaluation.scores import calibration_of
from async_tnt.networks.teaching.closed_form import weights_of
from async_tnt.networks.teaching.statistics import Statistics
from async_tnt.networks.teaching.teach import TrainedNetwork, joined
from async_tnt.networks.teaching.window_readings import Readings, WindowReader
from experiments.objects.no_objects import KINDS, of_kind

SURE = 0.9
"""Probability from which on a decision is sure."""


@dataclass(frozen=True)
class Part:
    """Readings of many recordings, with their labels.

    Parameters
    ----------
    readings : of all windows of all recordings.
    labels : the index of the true class of each reading.
    recording : the number of each reading's recording.
    """

    readings: Readings
    labels: np.ndarray
    recording: np.ndarray

    def score(self, logits: np.ndarray, new: int) -> dict[str, float]:
        """Shares that are right: of the new class, of the others, and the mean over classes.

        logits : (N, n_classes), in the order of the labels.
        new : label of the new class.
        """
        decided = logits.argmax(1)
        ends = self.readings.is_end
        right = decided == self.labels
        probabilities = _softmax(logits[ends])
        numbers, index = np.unique(self.recording[ends], return_inverse=True)
        sums = np.zeros((len(numbers), logits.shape[1]))
        np.add.at(sums, index, probabilities)
        truth = np.zeros(len(numbers), np.int64)
        truth[index] = self.labels[ends]
        of_recordings = sums.argmax(1) == truth
        labels = self.labels[ends]
        is_old = labels != new
        return {
            "new": _share(right[ends], labels == new),
            "old": _share(right[ends], is_old),
            "mean": _mean_of_classes(right[ends], labels),
            "new_recordings": _share(of_recordings, truth == new),
            "old_recordings": _share(of_recordings, truth != new),
            "mean_recordings": _mean_of_classes(of_recordings, truth),
            "new_early": _share(right[~ends], self.labels[~ends] == new),
            "old_early": _share(right[~ends], self.labels[~ends] != new),
            "taken": _share(decided[ends] == new, is_old),
            "calibration_error": calibration_of(
                probabilities.max(1), decided[ends] == self.labels[ends]
            )[1],
        }


def _share(values: np.ndarray, where: np.ndarray) -> float:
    return float(values[where].mean()) if where.any() else 1.0


def _mean_of_classes(right: np.ndarray, labels: np.ndarray) -> float:
    return float(np.mean([right[labels == label].mean() for label in np.unique(labels)]))


def _softmax(logits: np.ndarray) -> np.ndarray:
    powers = np.exp(logits - logits.max(1, keepdims=True))
    shares: np.ndarray = powers / powers.sum(1, keepdims=True)
    return shares


def read_files(reader: WindowReader, files: Mapping[str, Sequence[Path]], order: list[str]) -> Part:
    """The readings of recordings.

    files : class -> its recordings.
    order : the classes in the order of the labels.
    """
    parts = []
    labels = []
    numbers = []
    with progress(sum(map(len, files.values())), "reading") as bar:
        for name, paths in files.items():
            for path in paths:
                readings = reader.of_events(open_recording(path).read())
                parts.append(readings)
                labels += [order.index(name)] * len(readings.is_end)
                numbers += [len(parts)] * len(readings.is_end)
                bar.update()
    return Part(joined(parts), np.array(labels), np.array(numbers))


def read_nothing(reader: WindowReader, model: Model, sample: Sequence[Path], n: int) -> Readings:
    """Readings of windows that show no digit, n of each kind of `experiments.nothing`."""
    side = model.config.sensor[0]
    recordings = [open_recording(path).read() for path in sample]
    parts = []
    for name, kind in KINDS.items():
        rng = np.random.default_rng(len(name))
        for i in range(n):
            events = recordings[i % len(recordings)]
            window = of_kind(kind, events, side, model.config.window_us, rng)
            if len(window):
                parts.append(reader.of_events(window, start_us=0))
    return joined(parts)


def reader_of(model: Model) -> WindowReader:
    """A reader of the features and logits of a trained model with statistics."""
    assert model.statistics is not None
    return TrainedNetwork(model.config, model.network, model.weights).reader(model.statistics.layer)


def logits_of(readings: Readings, statistics: Statistics) -> np.ndarray:
    """The logits of trained classes, and then those of taught ones: float64."""
    weight, bias = weights_of(statistics)
    new = readings.features.astype(np.float64) @ weight.T.astype(np.float64) + bias
    return np.hstack([readings.logits.astype(np.float64), new])


def chosen(readings: Readings, where: np.ndarray) -> Readings:
    """Some of the readings."""
    return Readings(*(array[where] for array in readings))


def sure_share(nothing: Readings, logits: np.ndarray) -> float:
    """The share of windows of nothing that end with a sure decision."""
    return float((_softmax(logits[nothing.is_end]).max(1) >= SURE).mean())
