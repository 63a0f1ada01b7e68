"""Other settings of the closed form, on recordings that training held out of Train."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from async_tnt import load_model, open_recording
from async_tnt.networks.teaching.closed_form import MARGIN, RIDGE, TAUGHT_SHARE, row_of
from async_tnt.networks.teaching.moments import Moments
from async_tnt.networks.teaching.statistics import Statistics
from experiments.lessons.place import N_DRAWS, Place, train
from experiments.lessons.readings import read_files, reader_of
from experiments.speed.timing import machine


@dataclass(frozen=True)
class Setting:
    """What is varied, one at a time.

    Parameters
    ----------
    ridge, share, margin : see `closed_form`.
    components : the first so many components are used.
    """

    ridge: float = RIDGE
    share: float = TAUGHT_SHARE
    margin: float = MARGIN
    components: int = 256


SETTINGS = (
    Setting(),
    Setting(ridge=0.003),
    Setting(ridge=0.3),
    Setting(share=0.1),
    Setting(share=0.5),
    Setting(margin=4.0),
    Setting(margin=16.0),
    Setting(components=64),
    Setting(components=128),
)
"""The settings that are compared; the first one is used."""


def setting_numbers(place: Place, name: str) -> dict[str, Any]:
    """Scores of the settings. Only recordings of Train are read."""
    model = load_model(train(place, name, {}))
    statistics = model.statistics
    assert statistics is not None
    reader = reader_of(model)
    order = [*model.classes, name]
    part = read_files(reader, {one: place.held_out(one) for one in order}, order)
    held_out = statistics.readings(part.readings.features, part.readings.logits)
    lessons = {
        (k, draw): statistics.readings(features, logits)
        for k in place.per_class
        for draw in range(N_DRAWS)
        for features, logits in [_lesson(reader, place.drawn(name, k, draw))]
    }
    rows = []
    for setting in SETTINGS:
        kept = [*range(min(setting.components, statistics.n_components)), -1]
        others = list(_others(statistics, kept))
        scores: dict[str, list[dict[str, float]]] = {}
        for (k, _), vectors in lessons.items():
            row = row_of(
                Moments.of(vectors[:, kept]),
                others,
                share=setting.share,
                ridge=setting.ridge,
            ).at(setting.margin)
            new = held_out[:, kept[:-1]] @ row[:-1] + row[-1]
            logits = np.hstack([part.readings.logits.astype(np.float64), new[:, None]])
            scores.setdefault(str(k), []).append(part.score(logits, len(model.classes)))
        means = {
            k: {key: float(np.mean([one[key] for one in found])) for key in found[0]}
            for k, found in scores.items()
        }
        rows.append({**vars(setting), "scores": means})
    return {"digit": name, "rows": rows, "machine": machine("torch")}


def _lesson(reader: Any, files: Any) -> tuple[np.ndarray, np.ndarray]:
    """Features and logits of recordings of a class."""
    parts = [reader.of_events(open_recording(file).read()) for file in files]
    features = np.concatenate([one.features for one in parts])
    return features, np.concatenate([one.logits for one in parts])


def _others(statistics: Statistics, kept: list[int]) -> Iterator[Moments]:
    """The moments of all classes and of nothing, of some numbers of the vectors u."""
    entries = [*statistics.moments.values()]
    if statistics.nothing is not None:
        entries.append(statistics.nothing)
    size = statistics.n_components + 1
    rows, columns = np.tril_indices(size)
    wanted = np.arange(size)[kept]
    is_kept = np.isin(rows, wanted) & np.isin(columns, wanted)
    for moments in entries:
        yield Moments(moments.count, moments.mean[kept], moments.scatter[is_kept])
