"""Statistics of a trained model's classes, from the windows that it learned from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from async_tnt.base.progress import Bar
from async_tnt.networks.models.model import Model
from async_tnt.networks.teaching.moments import Moments
from async_tnt.networks.teaching.taught_network import features_layer
from async_tnt.networks.teaching.teach import (
    StatisticsMaker,
    TrainedNetwork,
    joined,
    spread_order,
)
from async_tnt.networks.teaching.window_readings import MOMENTS, Readings, WindowReader
from async_tnt.training.augment import KINDS, showing_nothing, unchanged
from async_tnt.training.batches import BatchVolumes
from async_tnt.training.windows import Windows

N_OF_NOTHING = 500
"""The most windows that are shown without a class."""


def can_have_statistics(model: Model, windows: Windows) -> bool:
    """Whether a layer of a classifier is small enough, and each class has windows."""
    trained = TrainedNetwork(model.config, model.network, model.weights)
    has_all = len(np.unique(windows.labels)) == len(model.classes)
    return has_all and features_layer(model.layers, trained.shapes) is not None


def with_class_statistics(
    model: Model, windows: Windows, progress: Callable[..., Bar] = Bar
) -> Model:
    """The model with statistics, so that classes can be taught to it.

    The statistics are of the windows as they were recorded, and of windows that show nothing
    instead, see `augment`. If a class has many windows, only some of them are read. They are spread
    over all.

    Parameters
    ----------
    model : a trained classifier of windows.
    windows : the windows that it learned from.
    progress : makes the progress bar, which counts classes.

    Raises
    ------
    ValueError : no layer of the network has few enough numbers.
    """
    trained = TrainedNetwork(model.config, model.network, model.weights)
    maker = StatisticsMaker(trained, model.classes)
    readings = {}
    with progress(len(model.classes), "statistics") as bar:
        for label, name in enumerate(model.classes):
            of_class = windows[np.flatnonzero(windows.labels == label)]
            readings[name] = _read(maker.reader, of_class, model.config.window_us, maker.most)
            bar.update()
    return with_nothing(replace(model, statistics=maker.make(readings)), windows)


def with_nothing(model: Model, windows: Windows) -> Model:
    """The model whose statistics are also of windows that show no class, see `augment`.

    Models whose landmark is regressed and those of `window_events` stay as they are: no such
    windows are made for them.

    Parameters
    ----------
    model : a classifier of windows, with statistics of its trained classes.
    windows : some windows of its classes.
    """
    statistics = model.statistics
    assert statistics is not None
    config = model.config
    # the landmark network would be needed
    if config.needs_regressor or config.window_events is not None:
        return model
    trained = TrainedNetwork(config, model.network, model.weights)
    found = _read_nothing(trained.reader(statistics.layer), windows, model)
    nothing = Moments.of(statistics.readings(found.features, found.logits))
    return replace(model, statistics=replace(statistics, nothing=nothing))


def _read(reader: WindowReader, windows: Windows, window_us: int, most: int) -> Readings:
    """Readings of windows of one class, until there are `most` of them."""
    parts = []
    n = 0
    for i in spread_order(len(windows)).tolist():
        parts.append(reader.of_events(windows.events(i, window_us), start_us=0))
        n += len(parts[-1].is_end)
        if n >= most:
            break
    return joined(parts, most)


def _read_nothing(reader: WindowReader, windows: Windows, model: Model) -> Readings:
    """Readings of windows that show each kind of nothing equally often."""
    volumes = BatchVolumes(model.config)
    kinds = list(KINDS.values())
    chosen = spread_order(len(windows))[:N_OF_NOTHING]
    rows = []
    ends = []
    for i, index in enumerate(chosen.tolist()):
        window = windows[index : index + 1]
        content = np.array([kinds[i % len(kinds)]], np.int64)
        draws = showing_nothing(
            unchanged(1, model.config), content, np.random.default_rng((index, i))
        )
        for share in MOMENTS:
            until_us = np.array([int(share * model.config.window_us)])
            (volume,) = volumes(window, replace(draws, until_us=until_us))
            rows.append(reader.of_volume(volume))
            ends.append(share == MOMENTS[-1])
    features, logits = (np.stack(part) for part in zip(*rows, strict=True))
    return Readings(features, logits, np.array(ends))
