"""A decision after every event: how many a second."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import count
from typing import Any

import numpy as np

from async_tnt import CompiledClassifier, Decision, Model, Processor
from experiments.speed.backends import Network
from experiments.speed.interleaved import WorkDiffers, check_logits
from experiments.speed.timing import interleave, spread, work_clock

PACKET = 1000
"""Events of a packet, as `open_recording` makes them."""


def bench_every_event(
    model: Model,
    networks: Mapping[str, Network],
    recordings: list[np.ndarray],
    *,
    rounds: int,
    n_events: int | None = None,
) -> dict[str, Any]:
    """Time `Processor(model, every_events=1)` with its own network and with other classifiers.

    The recordings are pushed in packets.

    Parameters
    ----------
    networks : dense networks, by name.
    recordings : recordings; round k uses number k, for all backends.
    n_events : number of events that are used, the first ones of each recording; None for all.

    Returns
    -------
    dict : backend -> `us`, processor time of a decision, the event's own and the windows' ends
        included; `a_second`, decisions; `ratio` over `ours`.

    Raises
    ------
    WorkDiffers : they do not make the same decisions in the first recording.
    """
    cut = [events[:n_events] for events in recordings]
    packets = [
        [events[first : first + PACKET].copy() for first in range(0, len(events), PACKET)]
        for events in cut
    ]
    processors = {"ours": Processor(model, every_events=1, start_us=0)}
    for name, network in networks.items():
        processors[name] = Processor(model, classifier=in_full(network), every_events=1, start_us=0)
    _check_same({name: _decisions(processor, packets[0]) for name, processor in processors.items()})
    us = interleave(
        {name: _through(processor, packets) for name, processor in processors.items()}, rounds
    )
    return {
        name: {
            "us": spread(values),
            "a_second": 1e6 / float(np.median(values)),
            **({} if name == "ours" else {"ratio": spread(values / us["ours"])}),
        }
        for name, values in us.items()
    }


def _decisions(processor: Processor, packets: list[np.ndarray]) -> list[Decision]:
    return [
        decision for packet in packets for decision in processor.push(packet)
    ] + processor.finish()


def in_full(network: Network) -> Network:
    """The network as a plain callable.

    A Processor would let a CompiledClassifier compute only what has changed.
    """
    return (lambda volume: network(volume)) if isinstance(network, CompiledClassifier) else network


def _through(processor: Processor, packets: list[list[np.ndarray]]) -> Callable[[], float]:
    rounds = count()

    def run() -> float:
        """Microseconds a decision."""
        of_this_round = packets[next(rounds) % len(packets)]
        processor.reset()
        n = 0
        started = work_clock()
        for packet in of_this_round:
            n += len(processor.push(packet))
        n += len(processor.finish())
        return 1e6 * (work_clock() - started) / n

    return run


def _check_same(found: dict[str, list[Decision]]) -> None:
    n_decisions = {name: len(decisions) for name, decisions in found.items()}
    if len(set(n_decisions.values())) > 1:
        raise WorkDiffers(f"all must make the same number of decisions, got {n_decisions}")
    for k, ours in enumerate(found["ours"]):
        logits = {name: decisions[k].logits for name, decisions in found.items()}
        check_logits(logits, f"event {ours.events} of the window at {ours.window_start_us} us")
