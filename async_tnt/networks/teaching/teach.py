"""Statistics from recordings of a model's classes, and moments of a new class."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.networks.layers.graph import CLASSIFIER, Network, layer_shapes
from async_tnt.networks.layers.layer import Shape
from async_tnt.networks.teaching.closed_form import choose_margin, others_of, row_of, taken
from async_tnt.networks.teaching.moments import Moments
from async_tnt.networks.teaching.statistics import (
    Statistics,
    n_components_for,
    principal_components,
)
from async_tnt.networks.teaching.taught_network import features_layer
from async_tnt.networks.teaching.window_readings import Readings, WindowReader
from async_tnt.volume.config import TNTConfig

MOST_READINGS = 3_000
"""The most readings of a class from which its statistics are made."""

MOST_BYTES = 1 << 29
"""The most bytes of the features of all classes together, while statistics are made."""

GOLDEN = (5**0.5 - 1) / 2
"""Multiples of this number, without their whole parts, are spread evenly however many there are."""


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A network as it was trained: its layers end with the logits of the trained classes."""

    config: TNTConfig
    network: Network
    weights: Mapping[str, np.ndarray]

    @property
    def shapes(self) -> dict[str, Shape]:
        """Layer -> the shape of its output."""
        tensors = {name: w.shape for name, w in self.weights.items()}
        return layer_shapes(self.network[CLASSIFIER], self.config.shape, tensors)

    def reader(self, layer: str) -> WindowReader:
        """A reader of a layer's numbers and of the logits."""
        logits = self.network[CLASSIFIER][-1]["name"]
        shapes = self.shapes
        return WindowReader(self.config, self.network, self.weights, shapes, layer, logits)


# -- statistics ------------------------------------------------------------------------------------


class StatisticsMaker:
    """Makes the statistics of a trained network's classes from readings of their windows.

    Parameters
    ----------
    trained : the network.
    classes : its classes, in the order of its logits.

    Attributes
    ----------
    reader : reads windows.
    most : the most readings of a class that are kept.

    Raises
    ------
    ValueError : no layer of the network has few enough numbers.
    """

    def __init__(self, trained: TrainedNetwork, classes: Sequence[str]) -> None:
        layers = trained.network[CLASSIFIER]
        shapes = trained.shapes
        layer = features_layer(layers, shapes)
        if layer is None:
            raise ValueError("no layer of the network has few enough numbers for features")
        self._layer = layer
        self._logits = layers[-1]["name"]
        self._classes = tuple(classes)
        self.reader = trained.reader(layer)
        n_features = int(np.prod(shapes[layer]))
        n_bytes_each = 4 * n_features * (len(classes) + 1)
        self.most = max(1, min(MOST_READINGS, MOST_BYTES // n_bytes_each))

    def make(self, readings: Mapping[str, Readings], nothing: Readings | None = None) -> Statistics:
        """The statistics.

        Parameters
        ----------
        readings : class -> readings of its windows, at least one.
        nothing : readings of windows that show no class.
        """
        features = [Moments.of(readings[name].features) for name in self._classes]
        n_readings = sum(moments.count for moments in features)
        n = n_components_for(features[0].size, len(self._classes), n_readings)
        center, projection = principal_components(features, n)
        empty = Statistics(self._layer, self._logits, self._classes, center, projection, {})

        def moments_of(one: Readings) -> Moments:
            return Moments.of(empty.readings(one.features, one.logits))

        return Statistics(
            self._layer,
            self._logits,
            self._classes,
            center,
            projection,
            {name: moments_of(readings[name]) for name in self._classes},
            None if nothing is None else moments_of(nothing),
        )


def spread_order(n: int) -> np.ndarray:
    """The numbers 0 to n - 1 in an order in which the first few are spread over all of them.

    Examples
    --------
    >>> spread_order(8).tolist()
    [0, 5, 2, 7, 4, 1, 6, 3]
    """
    return np.argsort(np.arange(n) * GOLDEN % 1.0, kind="stable")


def read_class(
    reader: WindowReader, recordings: Sequence[Any], most: int | None = None
) -> list[Readings]:
    """The readings of each recording that has events.

    Parameters
    ----------
    recordings : recordings of one class: events in any accepted form, or objects with `read()`.
    most : no more recordings are read after so many readings.
    """
    found = []
    n = 0
    for recording in recordings:
        events = recording.read() if hasattr(recording, "read") else recording
        readings = reader.of_events(events)
        if len(readings.is_end):
            found.append(readings)
            n += len(readings.is_end)
        if most is not None and n >= most:
            break
    return found


def joined(parts: Sequence[Readings], most: int | None = None) -> Readings:
    """All readings together, of which the first `most` are kept."""
    arrays = (np.concatenate(arrays)[:most] for arrays in zip(*parts, strict=True))
    return Readings(*arrays)


def statistics_of(
    trained: TrainedNetwork,
    classes: Sequence[str],
    recordings: Mapping[str, Sequence[Any]],
    nothing: Sequence[Any] = (),
) -> Statistics:
    """The statistics of a model's classes, see `Model.with_statistics`."""
    if set(recordings) != set(classes):
        raise ParameterValueError(
            "recordings",
            f"must be of the classes {', '.join(classes)}",
            ", ".join(map(str, recordings)) or "none",
        )
    maker = StatisticsMaker(trained, classes)
    readings = {}
    for name in classes:
        of_class = recordings[name]
        spread = [of_class[k] for k in spread_order(len(of_class)).tolist()]
        parts = read_class(maker.reader, spread, maker.most)
        if not parts:
            rule = "must have events of every class"
            raise ParameterValueError("recordings", rule, f"none of {name}")
        readings[name] = joined(parts, maker.most)
    parts = read_class(maker.reader, nothing, maker.most)
    return maker.make(readings, joined(parts, maker.most) if parts else None)


# -- a new class -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Lesson:
    """What a class was taught from, and what it does to the other classes.

    Parameters
    ----------
    statistics : the statistics with the class.
    record : for the model's record.
    """

    statistics: Statistics
    record: dict[str, Any]


def teach(
    trained: TrainedNetwork, statistics: Statistics, name: str, recordings: Iterable[Any]
) -> Lesson:
    """Statistics with one more class, see `Model.with_class`."""
    reader = trained.reader(statistics.layer)
    recordings = list(recordings)
    found = read_class(reader, recordings)
    if not found:
        rule = "must have events: there is nothing to learn the class from"
        raise ParameterValueError("recordings", rule, f"{len(recordings)} without events")
    vectors = [statistics.readings(one.features, one.logits) for one in found]
    others = others_of(statistics, name)
    choice = choose_margin(vectors, others)
    moments = Moments.of(np.concatenate(vectors))
    row = row_of(moments, list(others.values()))
    shares = {
        other: round(taken(row, choice.margin, of_other), 5) for other, of_other in others.items()
    }
    record = {
        "recordings": len(found),
        "windows": int(sum(one.is_end.sum() for one in found)),
        "margin": round(choice.margin, 3),
        "left_out_right": None if choice.held_out is None else round(choice.held_out, 5),
        "taken": {other: share for other, share in shares.items() if other is not None},
    }
    if None in shares:
        record["taken_of_nothing"] = shares[None]
    return Lesson(statistics.with_class(name, moments, choice.margin), record)
