"""The NIR paper's spiking network for N-MNIST, event by event, beside simulators of time steps.

    python -m experiments.spiking [--nmnist N-MNIST] [--nir GRAPH] [--parts PART ...] [--quick]
                                  [--json FILE] [--picture FILE] [--from FILE]

The graph is paper/02_cnn/cnn_sinabs.nir of neuromorphs/NIR on GitHub (commit 7232ada,
BSD-3-Clause). N-MNIST is a folder with Test/<digit>/<name>.bin. With --quick, a graph of the same
layers with random weights is run on one recording of each digit.

accuracy    Recordings that are right: each event goes through the network at its own time, a
            recording is one window, and neurons are never reset in it.
agreement   Spike for spike beside sinabs, one event in each time step, on 100 recordings. Graphs
            with random weights, whose neurons are reset to a value or leak, are run beside Norse
            and snnTorch, on 10 recordings.
cost        Times of an event, beside the network of ReLUs of the same layers (--ann, see
            examples/nir_cnn.py) and beside simulators on this processor.
bins        Accuracy of sinabs in time steps of several widths. Its reader of NIR graphs keeps
            membranes at -1 at least, which the graph does not say; so both are measured.
conversion  Accuracy of the network of ReLUs, and of the spiking networks that `spiking_from_rates`
            makes of it. Train/<digit>/<name>.bin says how large its activations are.

FILE keeps the parts that this run does not measure. Simulators that are not installed are left out
and named. `pip install '.[spiking]'` installs snnTorch (MIT) and Norse (LGPL-3.0). sinabs
(Apache-2.0) needs an older nir than this package, and samna, a driver of chips without a stated
licence, which is not used here; it is installed without both:

    pip install --no-deps sinabs==3.1.3 pbr==7.1.3
"""

from __future__ import annotations

import argparse
import os
import runpy
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

if __name__ == "__main__":  # libraries read these variables when they are imported
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np
import torch

from async_tnt import Model, TNTConfig
from async_tnt.base.progress import progress
from async_tnt.networks.models.spiking_network import SpikingNetwork
from experiments.digit_data.recordings import CLASSES
from experiments.records.run import ROOT
from experiments.scripts.options import (
    add_folder,
    data_folder,
    earlier_parts,
    exit_with,
    run_script,
    script_parser,
    write_part,
)
from experiments.speed.moments import windows_of
from experiments.speed.timing import machine, one_thread
from experiments.speed.touched import bench_touched
from experiments.spiking_networks.agreement import compare
from experiments.spiking_networks.bins import binned_accuracy
from experiments.spiking_networks.conversion import conversion_accuracy
from experiments.spiking_networks.cost import times
from experiments.spiking_networks.drawing import draw_bins
from experiments.spiking_networks.graphs import (
    SENSOR,
    random_paper_graph,
    random_small_graph,
    stages_of,
)
from experiments.spiking_networks.published import PUBLISHED
from experiments.spiking_networks.recordings import (
    WINDOW_US,
    Recording,
    accuracy_event_by_event,
    read_recordings,
)
from experiments.spiking_networks.simulators import (
    NORSE,
    SINABS,
    SNNTORCH,
    NorseNeurons,
    SinabsNeurons,
    SnnTorchNeurons,
    SteppedNetwork,
    missing_simulators,
)

PARTS = ("accuracy", "agreement", "cost", "bins", "conversion")
"""Parts of the report."""

PACKAGES = ("torch", "sinabs", "norse", "snntorch", "nir")
"""Packages whose versions the report has."""

STEP_S = 1e-4
"""Time between the events of the graphs with random weights, in seconds: a simulator's step."""

FLOORS = {"no floor": None, "floor": -1.0}
"""Row of bins -> the least value of membranes."""

SEED = 0
"""Seed of random weights."""


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    per_digit: int | None = None
    """Recordings of each digit; None for all."""
    compared: int = 10
    """Recordings of each digit that are compared with sinabs."""
    others: int = 1
    """Recordings of each digit on which graphs with random weights are compared."""
    events: int | None = None
    """Events of each recording that are compared; None for all."""
    bins_ms: tuple[float | None, ...] = (100, 30, 10, 3, 1, 0.1, None)
    """Widths of bins, in milliseconds; None: one event in each step."""
    rounds: int = 40
    """Rounds of timing."""
    moments: int = 400
    """Moments at which the multiplications of the network of ReLUs are counted."""
    calibration: int = 20
    """Recordings of each digit whose windows say how large activations of ReLUs are."""


QUICK = Sizes(1, 1, 1, 200, (100, 10, 3), 2, 40, 1)
"""The same for --quick."""


@dataclass(frozen=True)
class Subject:
    """The graph that is measured, our model of it, and the recordings.

    Parameters
    ----------
    calibration : recordings of the training set, by which activations of ReLUs are measured.
    ann : file of the weights of the network of ReLUs; None for random weights.
    """

    graph: Any
    model: Model
    recordings: list[Recording]
    calibration: list[Recording]
    sizes: Sizes
    ann: Path | None

    def first(self, per_digit: int) -> list[Recording]:
        """The first recordings of each digit."""
        seen = [0] * len(CLASSES)
        chosen = []
        for recording in self.recordings:
            seen[recording.digit] += 1
            if seen[recording.digit] <= per_digit:
                chosen.append(recording)
        return chosen


def of_graph(graph: Any, reset: Any, window_us: int = WINDOW_US) -> Model:
    """Our model of a graph."""
    return Model.from_nir(graph, classes=CLASSES, window_us=window_us, reset=reset, dt=STEP_S)


def sinabs_network(graph: Any, dtype: torch.dtype, lowest: float | None, records: str) -> Any:
    """sinabs' network of a graph.

    records : layers whose membranes are recorded: "all", "last" or "none".
    """
    stages = stages_of(graph, dtype)
    recorded = {"all": stages, "last": stages[-1:], "none": []}[records]
    nodes = [stage.neurons for stage in recorded]

    def neurons(node: Any) -> SinabsNeurons:
        is_recorded = any(node is other for other in nodes)
        return SinabsNeurons(node, dtype, lowest=lowest, records=is_recorded)

    return SteppedNetwork(stages, neurons)


# -- parts -----------------------------------------------------------------------------------------


def accuracy(subject: Subject) -> Iterator[dict[str, Any]]:
    """Our accuracy, event by event, beside the published ones."""
    numbers = accuracy_event_by_event(SpikingNetwork(subject.model), subject.recordings)
    yield {**numbers, "published": PUBLISHED}


def agreement(subject: Subject) -> Iterator[dict[str, Any]]:
    """Spikes beside those of simulators."""
    missing = missing_simulators()
    sizes = subject.sizes
    rows = {}
    if SINABS not in missing:
        packets = [recording.events[: sizes.events] for recording in subject.first(sizes.compared)]
        network = sinabs_network(subject.graph, torch.float64, None, "all")
        stages = stages_of(subject.graph, torch.float64)
        rows["the paper's graph: sinabs, threshold subtracted"] = compare(
            subject.model, network, packets, stages
        )
    rng = np.random.default_rng(SEED)
    packets = [
        _evenly(recording.events[: sizes.events]) for recording in subject.first(sizes.others)
    ]
    window_us = max(int(events["t"][-1]) for events in packets) + 1
    for name, simulator, kind, reset, neurons in _others():
        graph = random_small_graph(kind, STEP_S, rng)
        if simulator not in missing:
            stages = stages_of(graph, torch.float64)
            network = SteppedNetwork(stages, neurons)
            rows[name] = compare(of_graph(graph, reset, window_us), network, packets, stages)
    yield {"rows": rows, "left_out": missing}


def _others() -> list[tuple[str, str, Any, str, Callable[[Any], Any]]]:
    """Name, simulator, type of neurons, reset and neurons of graphs with random weights."""

    def norse(node: Any) -> NorseNeurons:
        return NorseNeurons(node, torch.float64, records=True)

    def snntorch(reset: str) -> Callable[[Any], SnnTorchNeurons]:
        return lambda node: SnnTorchNeurons(
            node, torch.float64, step_s=STEP_S, reset=reset, records=True
        )

    return [
        ("IF: Norse, reset to a value", NORSE, "IF", "value", norse),
        ("LIF: snnTorch, reset to 0", SNNTORCH, "LIF", "value", snntorch("zero")),
        ("LIF: snnTorch, threshold subtracted", SNNTORCH, "LIF", "subtract", snntorch("subtract")),
    ]


def _evenly(events: np.ndarray) -> np.ndarray:
    """The same events, one in each step of time."""
    moved = events.copy()
    moved["t"] = np.round(1e6 * STEP_S * np.arange(len(events)))
    return moved


def cost(subject: Subject) -> Iterator[dict[str, Any]]:
    """Times of an event, a time step and a recording."""
    missing = missing_simulators()
    stages = stages_of(subject.graph, torch.float32)
    simulators: dict[str, SteppedNetwork] = {}
    if SINABS not in missing:
        simulators["sinabs"] = sinabs_network(subject.graph, torch.float32, None, "none")
    if SNNTORCH not in missing:
        simulators["snnTorch"] = SteppedNetwork(
            stages,
            lambda node: SnnTorchNeurons(
                node, torch.float32, step_s=STEP_S, reset="subtract", records=False
            ),
        )
    if NORSE not in missing:
        simulators["Norse"] = SteppedNetwork(
            stages, lambda node: NorseNeurons(node, torch.float32, records=False)
        )
    recordings = subject.recordings[::7]
    others = {}
    relus = {}
    if subject.ann is not None:
        model = others["ReLUs"] = _network_of_relus(subject)
        windows = [
            window
            for recording in recordings[:30]
            for window in windows_of(recording.events, model.config.window_us)
        ]
        touched = bench_touched(model, windows, moments=subject.sizes.moments)
        relus = {name: touched[name]["multiplications"] for name in ("1", "whole")}
    numbers = times(subject.model, others, simulators, recordings, subject.sizes.rounds)
    yield {**numbers, "relu_multiplications": relus, "left_out": missing}


def _network_of_relus(subject: Subject) -> Model:
    """The network that the spiking one was made of; in a quick run with random weights."""
    example = runpy.run_path(str(ROOT / "examples" / "nir_cnn.py"))
    if subject.ann is not None:
        model: Model = example["convert"](subject.ann)[0]
        return model
    torch.manual_seed(SEED)
    config = TNTConfig(representation="count", polarity="split")
    return Model.from_torch(example["paper_network"](), config, classes=CLASSES)


def conversion(subject: Subject) -> Iterator[dict[str, Any]]:
    """Accuracy of the network of ReLUs, and of spiking ones that are made of it."""
    yield conversion_accuracy(_network_of_relus(subject), subject.calibration, subject.recordings)


def bins(subject: Subject) -> Iterator[dict[str, Any]]:
    """Accuracy of sinabs in bins."""
    missing = missing_simulators()
    if SINABS in missing:
        yield {"accuracy": {}, "left_out": {SINABS: missing[SINABS]}}
        return
    networks = {
        name: sinabs_network(subject.graph, torch.float32, lowest, "last")
        for name, lowest in FLOORS.items()
    }
    rows: dict[str, dict[str, Any]] = {name: {} for name in networks}
    for ms in subject.sizes.bins_ms:
        width_us = None if ms is None else round(1e3 * ms)
        key = "event" if ms is None else f"{ms:g}"
        for name, network in networks.items():
            rows[name][key] = binned_accuracy(network, subject.recordings, width_us, SENSOR)
        yield {"accuracy": rows, "left_out": {}}


MEASURE: dict[str, Callable[[Subject], Iterator[dict[str, Any]]]] = {
    "accuracy": accuracy,
    "agreement": agreement,
    "cost": cost,
    "bins": bins,
    "conversion": conversion,
}
"""Part of the report -> what measures it. It yields the part's numbers each time there are more."""


# -- the command -----------------------------------------------------------------------------------


def subject_of(args: argparse.Namespace, quick: bool) -> Subject:
    """What the options ask for."""
    folder = data_folder(args.nmnist, "nmnist", "--nmnist")
    sizes = QUICK if quick else Sizes()
    recordings = read_recordings(folder / "Test", sizes.per_digit)
    calibration = []
    if "conversion" in args.parts:
        calibration = read_recordings(folder / "Train", sizes.calibration)
    if quick:
        graph = random_paper_graph(np.random.default_rng(SEED))
        model = of_graph(graph, "subtract")
        return Subject(graph, model, recordings, calibration, sizes, None)
    import nir

    root = Path(os.environ.get("TNT_DATA", "")) / "nir"
    path = args.nir or root / "cnn_sinabs.nir"
    ann = args.ann or root / "pretrained_ann_weights.pth"
    for file, option in ((path, "--nir"), (ann, "--ann")):
        if not file.is_file():
            raise FileNotFoundError(f"no file {file}; give {option} FILE, or set TNT_DATA")
    model = of_graph(path, "subtract")
    return Subject(nir.read(path), model, recordings, calibration, sizes, ann)


def measure(args: argparse.Namespace, quick: bool) -> dict[str, Any]:
    """The report. What is measured of a part is written at once."""
    subject = subject_of(args, quick)
    report = earlier_parts(args)
    with one_thread(True), warnings.catch_warnings(), progress(len(args.parts), "parts") as bar:
        # of libraries that call parts of torch that will go
        warnings.simplefilter("ignore", DeprecationWarning)
        for name in args.parts:
            for numbers in MEASURE[name](subject):
                report[name] = {**numbers, "quick": quick, "machine": machine(*PACKAGES)}
                write_part(args, name, report[name])
            bar.update()
    return report


def main(argv: list[str] | None = None) -> int:
    """Measure the report or read it, print its tables, and draw the picture if asked."""
    parser = script_parser("spiking", __doc__, "few recordings, random weights", draws=True)
    add_folder(parser, "--nmnist", "with Test/<digit>/*.bin (default: $TNT_DATA/nmnist)")
    for option, name in (("--nir", "cnn_sinabs.nir"), ("--ann", "pretrained_ann_weights.pth")):
        text = f"the paper's file (default: $TNT_DATA/nir/{name})"
        parser.add_argument(option, type=Path, metavar="FILE", help=text)
    parser.add_argument(
        "--parts",
        nargs="+",
        choices=PARTS,
        default=list(PARTS),
        metavar="PART",
        help="default: all",
    )
    args = parser.parse_args(argv)

    def measured(quick: bool) -> dict[str, Any]:
        return measure(args, quick)

    return run_script(parser, argv, measured, "spiking", draw_bins, is_written=True)


if __name__ == "__main__":
    exit_with(main)
