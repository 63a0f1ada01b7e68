"""Times of an event, of a time step and of a recording, in several programs that take turns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Any

import numpy as np
import torch

from async_tnt import Model, Processor
from async_tnt.networks.models.spiking_network import SpikingNetwork
from experiments.speed.timing import interleave, spread, work_clock
from experiments.spiking_networks.bins import step_of_events
from experiments.spiking_networks.graphs import SENSOR
from experiments.spiking_networks.recordings import Recording, volume_after
from experiments.spiking_networks.simulators import SteppedNetwork

STEPS_A_ROUND = 50
"""Number of time steps with one event that a simulator takes in a round."""

BIN_US = 1_000
"""Width of the bins of a recording, in microseconds."""

PACKET = 1_000
"""Number of events of a packet."""


def times(
    spiking: Model,
    others: Mapping[str, Model],
    simulators: Mapping[str, SteppedNetwork],
    recordings: Sequence[Recording],
    rounds: int,
) -> dict[str, Any]:
    """Name of a case -> `spread` of its times: of an event, and of a recording.

    Parameters
    ----------
    spiking : our spiking model.
    others : name -> model of a network without spikes, which decides after every event.
    simulators : name -> the same spiking network in float32.
    recordings : round k takes recording k.
    """
    packets = [recording.events for recording in recordings]
    network = SpikingNetwork(spiking)
    models = {"spiking": spiking, **others}
    an_event: dict[str, Callable[[], float]] = {"spiking, no decisions": _volume(network, packets)}
    for name, model in models.items():
        an_event[f"{name}, a decision after each"] = _decisions(model, packets)
    for name, simulator in simulators.items():
        an_event[f"{name}, a time step"] = _time_steps(simulator, packets)
    a_recording = {"spiking, event by event": _whole(network, packets)}
    for name, simulator in simulators.items():
        a_recording[f"{name}, bins of {BIN_US // 1_000} ms"] = _binned(simulator, packets)
    return {
        "event_us": _spreads(interleave(an_event, rounds)),
        "recording_ms": _spreads(interleave(a_recording, rounds)),
        "events": float(np.mean([len(events) for events in packets[:rounds]])),
    }


def _spreads(measured: Mapping[str, np.ndarray]) -> dict[str, Any]:
    return {name: spread(values) for name, values in measured.items()}


def _in_turn(packets: Sequence[np.ndarray]) -> Callable[[], np.ndarray]:
    """A function that returns the next recording at each call."""
    calls = count()
    return lambda: packets[next(calls) % len(packets)]


def _volume(network: SpikingNetwork, packets: Sequence[np.ndarray]) -> Callable[[], float]:
    """Microseconds of an event that goes through our network."""
    turn = _in_turn(packets)

    def run() -> float:
        events = turn()
        started = work_clock()
        volume_after(network, events)
        return 1e6 * (work_clock() - started) / len(events)

    return run


def _whole(network: SpikingNetwork, packets: Sequence[np.ndarray]) -> Callable[[], float]:
    """Milliseconds of a recording that goes through our network."""
    turn = _in_turn(packets)

    def run() -> float:
        events = turn()
        started = work_clock()
        volume_after(network, events)
        return 1e3 * (work_clock() - started)

    return run


def _decisions(model: Model, packets: Sequence[np.ndarray]) -> Callable[[], float]:
    """Microseconds of an event with a decision after it."""
    turn = _in_turn(packets)
    processor = Processor(model, every_events=1, start_us=0)

    def run() -> float:
        events = turn()
        processor.reset()
        started = work_clock()
        for first in range(0, len(events), PACKET):
            processor.push(events[first : first + PACKET])
        processor.finish()
        return 1e6 * (work_clock() - started) / len(events)

    return run


def _time_steps(simulator: SteppedNetwork, packets: Sequence[np.ndarray]) -> Callable[[], float]:
    """Microseconds of a time step with one event, in calls of one step each."""
    turn = _in_turn(packets)
    width, height = SENSOR

    def run() -> float:
        events = turn()[:STEPS_A_ROUND]
        steps = torch.zeros((len(events), 1, 1, 2, height, width))
        p, y, x = (events[name].astype(np.int64) for name in "pyx")
        steps[np.arange(len(events)), 0, 0, p, y, x] = 1
        simulator.reset()
        started = work_clock()
        for step in steps:
            simulator.step(step)
        return 1e6 * (work_clock() - started) / len(events)

    return run


def _binned(simulator: SteppedNetwork, packets: Sequence[np.ndarray]) -> Callable[[], float]:
    """Milliseconds of a recording in bins, whose steps are one call."""
    turn = _in_turn(packets)
    width, height = SENSOR

    def run() -> float:
        events = turn()
        step = step_of_events(events, BIN_US)
        inputs = np.zeros((1, int(step[-1]) + 1, 2, height, width), np.float32)
        p, y, x = (events[name].astype(np.int64) for name in "pyx")
        np.add.at(inputs[0], (step, p, y, x), 1)
        simulator.reset()
        started = work_clock()
        simulator.step(torch.from_numpy(inputs))
        return 1e3 * (work_clock() - started)

    return run
