"""A decision after every event: how many a second, and how long each of a hundred thousand takes."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from itertools import count
from typing import Any

import numpy as np

from async_tnt import CompiledClassifier, Decision, Model, Processor
from async_tnt.checking.backends import Network
from async_tnt.checking.interleaved import LOGIT_TOLERANCE, WorkDiffers
from async_tnt.checking.timing import interleave, spread, work_clock

PACKET = 1000  # events, as `open_recording` makes packets
STRETCH = 2000  # single decisions with, then as many without the collector


def bench_every_event(
    model: Model,
    networks: Mapping[str, Network],
    recordings: list[np.ndarray],
    *,
    rounds: int,
    n_events: int | None = None,
) -> dict[str, Any]:
    """Time `Processor(model, every_events=1)` on recordings in packets, with its own network and with others as its
    classifier.

    Parameters
    ----------
    networks : whole ones, by name.
    recordings : round k takes number k, and so do all contenders in that round.
    n_events : of each recording, the first ones; None for all.

    Returns
    -------
    dict : contender -> `us`, processor time of a decision, the event's own and the windows' ends included; `a_second`,
        decisions; `ratio` over `ours`.

    Raises
    ------
    WorkDiffers : they do not make the same decisions.
    """
    packets = [_packets(events[:n_events]) for events in recordings]
    processors = {"ours": Processor(model, every_events=1, start_us=0)}
    for name, network in networks.items():
        processors[name] = Processor(model, classifier=_as_callable(network), every_events=1, start_us=0)
    _check_same({name: _decide_all(processor, packets[0][:1]) for name, processor in processors.items()})
    cases = {name: _through(processor, packets) for name, processor in processors.items()}
    us = interleave(cases, rounds)
    return {
        name: {
            "us": spread(values),
            "a_second": 1e6 / float(np.median(values)),
            **({} if name == "ours" else {"ratio": spread(values / us["ours"])}),
        }
        for name, values in us.items()
    }


def bench_singles(model: Model, recordings: list[np.ndarray], *, n_decisions: int) -> dict[str, Any]:
    """Time single decisions, `push_one` of event after event with `every_events=1`, by the wall clock.

    Each way has a Processor of its own, and in stretches of STRETCH they take turns: `collector`, with Python's garbage
    collector as users have it; `no_collector`, without; and `machine`, a loop of Python's own additions that takes
    about as long as a decision and knows nothing of us: what lies far from its median is the machine's doing.

    Returns
    -------
    dict : way -> median, quartiles, p99, p99.9 (`p999`), max, in microseconds, and `p99_over_median`.
    """
    ways = {"collector": _singles(model, recordings), "no_collector": _singles(model, recordings)}
    typical_us = float(np.median([ways["collector"]() for _ in range(STRETCH)]))
    for _ in range(STRETCH):
        ways["no_collector"]()
    ways["machine"] = _additions(typical_us)
    us: dict[str, list[float]] = {name: [] for name in ways}
    was_enabled = gc.isenabled()
    try:
        for first in range(0, n_decisions, STRETCH):
            for name, decide in ways.items():
                if name == "collector":
                    gc.enable()
                else:
                    gc.disable()
                us[name] += [decide() for _ in range(min(STRETCH, n_decisions - first))]
    finally:
        if was_enabled:
            gc.enable()
        else:
            gc.disable()
    return {name: _tail(np.array(values)) for name, values in us.items()}


def _as_callable(network: Network) -> Network:
    """Of any network a mere callable: a Processor knows a CompiledClassifier, and computes what changed only."""
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


def _singles(model: Model, recordings: list[np.ndarray]) -> Callable[[], float]:
    """Each call takes the next event, lap after lap, and returns the microseconds to its decision."""
    processor = Processor(model, every_events=1, start_us=0)
    lap_us = (1 + max(int(events["t"].max()) for events in recordings) // model.config.window_us) * (
        model.config.window_us
    )

    def rows() -> Any:
        for k in count():
            events = recordings[k % len(recordings)].copy()
            events["t"] += k * lap_us
            yield from events.tolist()

    stream = rows()

    def decide() -> float:
        t, x, y, p = next(stream)
        started = time.perf_counter()
        decisions = processor.push_one(t, x, y, p)
        taken = time.perf_counter() - started
        if not decisions:
            raise RuntimeError(f"every event must give a decision, got none for {t, x, y, p}")
        return 1e6 * taken

    return decide


def _additions(us: float) -> Callable[[], float]:
    """A fixed number of additions that take about so many microseconds."""

    def add(n: int) -> float:
        started = time.perf_counter()
        total = 0
        for k in range(n):
            total += k
        return 1e6 * (time.perf_counter() - started)

    n = 1000
    for _ in range(5):
        n = max(1, round(n * us / float(np.median([add(n) for _ in range(200)]))))
    return lambda: add(n)


def _packets(events: np.ndarray) -> list[np.ndarray]:
    return [events[first : first + PACKET].copy() for first in range(0, len(events), PACKET)]


def _decide_all(processor: Processor, packets: list[np.ndarray]) -> list[Decision]:
    processor.reset()
    return [decision for packet in packets for decision in processor.push(packet)] + processor.finish()


def _check_same(found: dict[str, list[Decision]]) -> None:
    expected = found["ours"]
    for name, decisions in found.items():
        if len(decisions) != len(expected):
            raise WorkDiffers(f"{name} must make {len(expected)} decisions as ours, got {len(decisions)}")
        for ours, theirs in zip(expected, decisions, strict=True):
            scale = max(1.0, float(np.abs(ours.logits).max()))
            apart = float(np.abs(ours.logits - theirs.logits).max()) / scale
            if not apart <= LOGIT_TOLERANCE:
                raise WorkDiffers(
                    f"all must give the same logits within {LOGIT_TOLERANCE}, got ours and {name} {apart:.1e} apart "
                    f"after {ours.events} events"
                )


def _tail(us: np.ndarray) -> dict[str, float]:
    median, q1, q3, p99, p999 = np.percentile(us, [50, 25, 75, 99, 99.9])
    return {
        "median": float(median),
        "q1": float(q1),
        "q3": float(q3),
        "p99": float(p99),
        "p999": float(p999),
        "max": float(us.max()),
        "n": len(us),
        "p99_over_median": float(p99 / median),
    }
