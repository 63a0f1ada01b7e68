"""Sequences to validate and to test with, and events of them at which flow is compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from async_tnt import Model, Output, Processor
from examples.optical_flow.network import WINDOW_US
from examples.optical_flow.plane_fit import PlaneFit, PlaneSettings
from examples.optical_flow.scenes import Kinds, Scene, random_scene

SENSOR = (128, 96)
"""Width and height of a sequence, in pixels."""

DURATION_US = 120_000
"""How long a sequence is, in microseconds."""

FIRST_US = 30_000
"""Flow is compared from this time on, in microseconds. Before, no way has seen a whole window."""

VALIDATION = 1
"""Part of the seed of sequences by which settings are chosen. The training has 0."""

TEST = 2
"""Part of the seed of sequences that choose nothing."""


class KnownSequence(NamedTuple):
    """Events, and the true flow at some of them."""

    sensor: tuple[int, int]
    """Width and height, in pixels."""
    events: np.ndarray
    """All events, in order."""
    compared: np.ndarray
    """int64, (n,): numbers of the events at which flow is compared, in order."""
    true: np.ndarray
    """float64, (n, 2): the true flow at these events, in pixels per second."""


Way = Callable[[KnownSequence], np.ndarray]
"""A way to flow: sequence -> float64, (n, 2), the flow right after each event that is compared."""


def sequences(
    part: int, kinds: Kinds, n: int, n_compared: int, seed: int
) -> Iterator[KnownSequence]:
    """Make `n` sequences.

    Parameters
    ----------
    part : `VALIDATION` or `TEST`.
    kinds : what they show.
    n_compared : number of events at which flow is compared.
    seed : of everything.
    """
    for k in range(n):
        rng = np.random.default_rng([part, seed, k])
        scene = random_scene(SENSOR, 1e-6 * DURATION_US, kinds, rng)
        events = scene.events(DURATION_US, rng)
        yield known_sequence(scene, events, n_compared, rng)


def known_sequence(
    scene: Scene, events: np.ndarray, n_compared: int, rng: np.random.Generator
) -> KnownSequence:
    """Draw the events at which flow is compared, from all since `FIRST_US`."""
    first = int(np.searchsorted(events["t"], FIRST_US))
    n = min(n_compared, len(events) - first)
    compared = np.sort(first + rng.choice(len(events) - first, n, replace=False))
    true = [scene.flow(1e-6 * t)[:, y, x] for t, x, y, _ in events[compared].tolist()]
    return KnownSequence(scene.sensor, events, compared, np.array(true, np.float64).reshape(-1, 2))


def zero_flow(sequence: KnownSequence) -> np.ndarray:
    """No flow anywhere."""
    return np.zeros_like(sequence.true)


def network_way(model: Model, hop_us: int | None) -> Way:
    """The network's flow at an event, after this event.

    hop_us : distance between the starts of windows; None: windows do not overlap.
    """
    processors: dict[tuple[int, int], Processor[Output]] = {}

    def way(sequence: KnownSequence) -> np.ndarray:
        sensor = sequence.sensor
        if sensor not in processors:
            own = model.for_sensor(sensor)
            processors[sensor] = Processor[Output](own, hop_us=hop_us, start_us=0)
        processor = processors[sensor]
        processor.reset()
        flow = np.empty_like(sequence.true)
        done = 0
        for k, event in enumerate(sequence.compared):
            processor.push(sequence.events[done : event + 1])
            done = event + 1
            x, y = sequence.events[["x", "y"]][event]
            flow[k] = processor.fire().arrays[0][:, y, x]
        return flow

    return way


def plane_way(settings: PlaneSettings) -> Way:
    """The plane fit's normal flow, nan where it finds none."""

    def way(sequence: KnownSequence) -> np.ndarray:
        return _by_plane(sequence, settings, lambda fit, t, x, y, p: fit.flow(t, x, y, p))

    return way


def pooled_way(settings: PlaneSettings) -> Way:
    """The flow from several normal flows."""

    def way(sequence: KnownSequence) -> np.ndarray:
        return _by_plane(sequence, settings, lambda fit, t, x, y, p: fit.pooled(t, x, y))

    return way


def _by_plane(
    sequence: KnownSequence, settings: PlaneSettings, answer: Callable[..., np.ndarray]
) -> np.ndarray:
    fit = PlaneFit(sequence.sensor, settings)
    flow = np.empty_like(sequence.true)
    done = 0
    for k, event in enumerate(sequence.compared):
        fit.update(sequence.events[done : event + 1])
        done = event + 1
        flow[k] = answer(fit, *sequence.events[event].item())
    return flow


def ages_us(sequence: KnownSequence, hop_us: int | None) -> np.ndarray:
    """The age of the window that answers at each event that is compared: int64, (n,).

    The answer is that of the oldest open window, and all windows begin at multiples of their
    distance.
    """
    t = sequence.events["t"][sequence.compared].astype(np.int64)
    hop = hop_us or WINDOW_US
    oldest_start = (t - WINDOW_US) // hop * hop + hop
    return t - oldest_start


def endpoint_errors(flow: np.ndarray, true: np.ndarray) -> np.ndarray:
    """The distances from a flow to the true flow, (n,). Flow that was not found counts as zero.

    flow, true : (n, 2), in pixels per second.
    """
    return np.hypot(*(np.nan_to_num(flow) - true).T)
