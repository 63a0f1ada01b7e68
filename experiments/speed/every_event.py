"""How many decisions a second are made, with a decision after every event."""

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
"""Number of events of a packet, as `open_recording` makes packets."""


def bench_every_event(
    model: Model,
    networks: Mapping[str, Network],
    recordings: list[np.ndarray],
    *,
    rounds: int,
    n_events: int | None = None,
) -> dict[str, Any]:
    """Times of `Processor(model, every_events=1)` with its own network and with other networks.

    The recordings are pushed in packets.

    Parameters
    ----------
    networks : dense networks, by name.
    recordings : recordings. In round k, all backends get recording k.
    n_events : number of first events of each recording that are used; None for all.

    Returns
    -------
    dict : backend -> `us`, `a_second` and `ratio`. `us` is the processor time of a decision in
        microseconds. It includes the time of the event and of the ends of windows. `a_second` is
        the number of decisions a second. `ratio` is `us` divided by the `us` of `ours`.

    Raises
    ------
    WorkDiffers : the backends do not make the same decisions in the first recording.
    """
    used_events = [events[:n_events] for events in recordings]
    packets = [
        [events[first : first + PACKET].copy() for first in range(0, len(events), PACKET)]
        for events in used_events
    ]
    processors = {"ours": Processor(model, every_events=1, start_us=0)}
    for name, network in networks.items():
        processors[name] = Processor(model, classifier=in_full(network), every_events=1, start_us=0)
    _check_same({name: _decisions(processor, packets[0]) for name, processor in processors.items()})
    us_by_backend = interleave(
        {name: _through(processor, packets) for name, processor in processors.items()}, rounds
    )
    report: dict[str, dict[str, Any]] = {}
    for name, values in us_by_backend.items():
        report[name] = {"us": spread(values), "a_second": 1e6 / float(np.median(values))}
        if name != "ours":
            report[name]["ratio"] = spread(values / us_by_backend["ours"])
    return report


def _decisions(processor: Processor, packets: list[np.ndarray]) -> list[Decision]:
    """All decisions on the packets of a recording."""
    decisions: list[Decision] = []
    for packet in packets:
        decisions += processor.push(packet)
    return decisions + processor.finish()


def in_full(network: Network) -> Network:
    """The network as a plain function, which computes everything at each call.

    A Processor would let a CompiledClassifier compute only what has changed.
    """
    return (lambda volume: network(volume)) if isinstance(network, CompiledClassifier) else network


def _through(processor: Processor, packets: list[list[np.ndarray]]) -> Callable[[], float]:
    """A function that pushes a recording through the processor, and at each call the next one."""
    rounds = count()

    def run() -> float:
        """Microseconds of a decision."""
        recording_packets = packets[next(rounds) % len(packets)]
        processor.reset()
        n = 0
        started = work_clock()
        for packet in recording_packets:
            n += len(processor.push(packet))
        n += len(processor.finish())
        return 1e6 * (work_clock() - started) / n

    return run


def _check_same(decisions_by_backend: dict[str, list[Decision]]) -> None:
    """Check that all backends make the same decisions."""
    n_decisions = {name: len(decisions) for name, decisions in decisions_by_backend.items()}
    if len(set(n_decisions.values())) > 1:
        raise WorkDiffers(f"all must make the same number of decisions, got {n_decisions}")
    for k, our_decision in enumerate(decisions_by_backend["ours"]):
        logits = {name: decisions[k].logits for name, decisions in decisions_by_backend.items()}
        check_logits(
            logits,
            f"event {our_decision.events} of the window at {our_decision.window_start_us} us",
        )
