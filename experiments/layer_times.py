"""Where the time of a decision goes: layer by layer, beside what the core can do at most.

    python -m experiments.layer_times [--quick] [--json FILE]

The bundled models decide 1, 10, 100 and 1,300 events after the decision before. Their networks, cut
behind each layer with weights, take turns in blocks, see `speed.interleaved`. What a part takes is
the time of the network that ends behind it, less that of the network that ends before it. Each
moment is timed several times, and its least time counts: this is where time goes, not how long a
decision takes on a busy machine. The first row is a call after which nothing is computed.

Multiplications are those of all places that are computed. Those with an input of 0 count, too,
although kernels leave many of them out, so a part can be above the core's peak. The peak is
measured with all numbers in registers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

if __name__ == "__main__":  # libraries read these variables when they are imported
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np

from async_tnt import CompiledNetwork, Model, load_model
from async_tnt.base.progress import progress
from async_tnt.kernels.target import LANES
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed.interleaved import timed
from experiments.speed.moments import NEW_EVENTS, Moment, Moments, bench_recordings, windows_of
from experiments.speed.networks import Feed
from experiments.speed.peak import most_multiplications
from experiments.speed.timing import machine
from experiments.speed.work import work_of

FULL = {"laps": 4, "blocks": 20, "decisions_a_block": 50}
"""How much is measured."""

QUICK = {"laps": 1, "blocks": 2, "decisions_a_block": 5}
"""How much is measured with --quick."""

MODELS = ("digits", "digits-everywhere")
"""The models that decide."""

CALL = "call, nothing is new"
"""Name of the row of a network whose volume does not change."""


class UpTo:
    """The network up to a layer, as a backend that is timed; counts its multiplications."""

    def __init__(self, model: Model, layer: str) -> None:
        self._feed = Feed(model)
        self._network = CompiledNetwork(model.features(layer))
        self.n_multiplications: list[int] = []

    def prepare(self, moment: Moment) -> None:
        self._feed.go(moment)

    def decide(self) -> None:
        self._network.refresh(self._feed.volume)

    def count(self) -> None:
        """Count the multiplications of the last decision."""
        work = work_of(self._network)
        self.n_multiplications.append(sum(n * step.products for step, n in work))


class Unchanged(UpTo):
    """The network up to a layer, for a volume that stays empty."""

    def prepare(self, moment: Moment) -> None:
        if not self._feed.volume.is_open:
            self._feed.volume.open(moment.start_us)

    def count(self) -> None:
        self.n_multiplications.append(0)


def parts_of(model: Model) -> dict[str, str]:
    """The parts of a chain of layers: the name of each -> its last layer.

    A part has one layer with weights, after which it is named, and those between this layer and the
    next one with weights: batch norms, functions such as ReLU, and pools. The first part also has
    what comes before its layer.
    """
    names = [layer["name"] for layer in model.layers if layer["op"] != "flatten"]
    work = work_of(CompiledNetwork(model.features(names[-1])))
    with_weights = dict.fromkeys(step.layer for step, _ in work if step.products)
    starts = [names.index(name) for name in with_weights]
    ends = [*starts[1:], len(names)]
    return {names[k]: names[end - 1] for k, end in zip(starts, ends, strict=True)}


def measure_model(
    model: Model, settings: Mapping[str, int], tick: Callable[[], None]
) -> dict[str, Any]:
    """Number of new events -> a row for each part, see `_rows`.

    tick : called before each number of new events.
    """
    windows = []
    for events in bench_recordings(model.config):
        windows += windows_of(events, model.config.window_us)
    parts = parts_of(model)
    first = next(iter(parts.values()))

    def backends() -> dict[str, UpTo]:
        ends = {part: UpTo(model, last) for part, last in parts.items()}
        return {CALL: Unchanged(model, first), **ends}

    rows: dict[str, Any] = {}
    for n_new in NEW_EVENTS:
        tick()
        moments = Moments(windows, model.config.window_us, n_new)
        laps = [
            timed(
                backends(), moments.blocks(settings["blocks"], settings["decisions_a_block"]), False
            )
            for _ in range(1 + settings["laps"])
        ]
        # the first lap is to warm up
        us = {part: np.min([lap.us[part] for lap in laps[1:]], axis=0) for part in laps[0].us}
        counting = backends()
        for block in moments.blocks(settings["blocks"], settings["decisions_a_block"]):
            for backend in counting.values():
                _count(backend, block)
        rows[str(n_new)] = _rows(us, counting)
    return rows


def _count(backend: UpTo, block: list[Moment]) -> None:
    """Count the multiplications of a backend at each moment of a block."""
    for moment in block:
        if not moment.follows:
            backend.prepare(moment.before)
            backend.decide()
        backend.prepare(moment)
        backend.decide()
        backend.count()


def _rows(us: Mapping[str, np.ndarray], backends: Mapping[str, UpTo]) -> list[dict[str, Any]]:
    """A row for each part: what a decision takes more than without it, as means of all moments.

    us : backend -> microseconds, float64, (blocks, decisions of a block).
    """
    rows = []
    before_us = 0.0
    before_n = 0.0
    for name, backend in backends.items():
        total_us = float(us[name].mean())
        total_n = float(np.mean(backend.n_multiplications))
        rows.append(
            {"part": name, "us": total_us - before_us, "multiplications": total_n - before_n}
        )
        before_us = total_us
        before_n = total_n
    return rows


def measure(quick: bool) -> dict[str, Any]:
    """The report: the peak, and the rows of each bundled model."""
    settings = QUICK if quick else FULL
    report = {}
    with progress(len(MODELS) * len(NEW_EVENTS), "decisions") as bar:
        for name in MODELS:
            report[name] = measure_model(load_model(name), settings, bar.update)
    return {
        "settings": {"quick": quick, "lanes": LANES, **settings},
        "peak": most_multiplications(),
        "models": report,
        "machine": machine(),
    }


def main(argv: list[str] | None = None) -> int:
    """Measure the report, and print its tables."""
    parser = script_parser("layer_times", __doc__, "some decisions")
    return run_script(parser, argv, measure, "layer_times")


if __name__ == "__main__":
    exit_with(main)
