"""Features and logits in the windows of a recording, as a stream has them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import ceil, prod
from typing import Any, NamedTuple

import numpy as np

from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.network.heatmap import centroid
from async_tnt.kernels.network.program import OUTPUT_DY
from async_tnt.networks.layers.graph import CLASSIFIER, REGRESSOR, Network
from async_tnt.networks.layers.layer import Shape
from async_tnt.networks.layers.program import VolumeInput, make_program
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.events import LARGER_CAMERA, EventDecoder
from async_tnt.volume.regressor import Regressor
from async_tnt.volume.volume import TNTVolume

MOMENTS = (0.25, 0.5, 1.0)
"""When a window is read, as shares of its length: a stream is decided before a window's end, too.
In a pilot on held-out N-MNIST, complete windows alone gave 1 % fewer right quarters of windows."""


class Readings(NamedTuple):
    """What a network computes inside, at N moments of a recording."""

    features: np.ndarray
    """float32, (N, D)."""
    logits: np.ndarray
    """float32, (N, number of logits)."""
    is_end: np.ndarray
    """bool, (N,): whether a moment is the last one of its window."""


class WindowReader:
    """Reads two layers of a network in the windows of recordings.

    Parameters
    ----------
    config : how events become volumes.
    network, weights : see `Model`.
    shapes : layer -> the shape of its output.
    layer, logits : the layer of the features, and that of the logits.
    """

    def __init__(
        self,
        config: TNTConfig,
        network: Network,
        weights: Mapping[str, np.ndarray],
        shapes: Mapping[str, Shape],
        layer: str,
        logits: str,
    ) -> None:
        self._config = config
        self._decoder = EventDecoder(config.sensor, "accept", LARGER_CAMERA)
        self._input = VolumeInput(config.shape)
        outputs = (layer, logits)
        self._program = make_program(network[CLASSIFIER], config.shape, weights, outputs=outputs)
        self._program.prepare()
        self._views = [self._program.view(k, shapes[name]) for k, name in enumerate(outputs)]
        regressor = None
        if config.needs_regressor:
            regressor = _regressor(config, network, weights)
        self._volume = TNTVolume(config, regressor=regressor)

    def of_events(self, events: Any, start_us: int | None = None) -> Readings:
        """The readings of one recording.

        Parameters
        ----------
        events : events in any accepted form, see `volume.event_forms`.
        start_us : where the first window begins; by default at the first event.

        Raises
        ------
        ValueError, TypeError : the events are invalid.
        """
        columns = self._decoder.decode(events)
        n = columns.n
        parts = [np.array(column[:n]) for column in columns[:4]]
        self._volume.reset()
        if start_us is not None:
            self._volume.open(start_us)
        first = 0
        rows = []
        ends = []
        for stop, is_end in edges(parts[0], self._config, start_us):
            self._volume.update(tuple(column[first:stop] for column in parts))
            rows.append(self.of_volume(self._volume.array))
            ends.append(is_end)
            first = stop
        return self._gathered(rows, ends)

    def of_volume(self, volume: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Features (D,) and logits of one volume (C, H, W), new arrays."""
        self._program.run(self._input(volume))
        features, logits = (view.reshape(-1).copy() for view in self._views)
        return features, logits

    def _gathered(self, rows: list[tuple[np.ndarray, np.ndarray]], ends: list[bool]) -> Readings:
        if not rows:
            sizes = [prod(view.shape) for view in self._views]
            features, logits = (np.empty((0, size), np.float32) for size in sizes)
        else:
            features, logits = (np.stack(part) for part in zip(*rows, strict=True))
        return Readings(features, logits, np.array(ends, bool))


def edges(
    t: np.ndarray, config: TNTConfig, start_us: int | None = None
) -> Iterator[tuple[int, bool]]:
    """Yield the moments of a recording at which its windows are read.

    A moment at which a window has no new event is left out.

    Parameters
    ----------
    t : times of the recording's events, in microseconds, in the order of their arrival.
    config : says how long windows are.
    start_us : where the first window begins; by default at the first event. None of the events is
        earlier.

    Yields
    ------
    stop, is_end : the number of events up to the moment, and whether it is the window's last.

    Examples
    --------
    >>> t = np.array([5, 20, 30, 80, 110])
    >>> list(edges(t, TNTConfig(window_us=100)))
    [(2, False), (3, False), (4, True), (5, True)]
    """
    first = 0
    for stops in _stops(t, config, start_us):
        new = [stop for stop in dict.fromkeys(stops) if stop > first]
        for stop in new:
            yield stop, stop == new[-1]
            first = stop


def _stops(t: np.ndarray, config: TNTConfig, start_us: int | None) -> Iterator[list[int]]:
    """Yield, for each window, the numbers of events up to its moments."""
    length = config.window_events or config.last_events
    if length is not None:
        for start in range(0, len(t), length):
            yield [min(len(t), start + ceil(share * length)) for share in MOMENTS]
        return
    if not len(t):
        return
    first_us = int(t[0]) if start_us is None else start_us
    # an event that comes late is in the window that is open then
    reached = np.maximum.accumulate(t)
    for number in np.unique((reached - first_us) // config.window_us).tolist():
        from_us = first_us + number * config.window_us
        ends_us = [from_us + ceil(share * config.window_us) for share in MOMENTS]
        yield np.searchsorted(reached, ends_us, side="left").tolist()


def _regressor(config: TNTConfig, network: Network, weights: Mapping[str, np.ndarray]) -> Regressor:
    """The landmark network as a function from a raw volume to a landmark in grid pixels."""
    program = make_program(network[REGRESSOR], config.shape, weights)
    program.prepare()
    prepare(centroid)
    read = VolumeInput(config.shape)
    _, height, width = config.shape

    def landmark(volume: np.ndarray) -> tuple[float, float]:
        exponent = program.run(read(volume))
        x, y = centroid.call(exponent, int(program.arrays.program[OUTPUT_DY]), width, height)
        return x, y

    return landmark
