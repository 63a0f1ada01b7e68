"""How much time four networks save by computing only what has changed.

Our engine computes only what has changed. It is compared with onnxruntime, OpenVINO and torch.

    python -m experiments.incremental [--quick] [--json FILE] [--picture FILE]

All backends run in one process with one thread each, and take turns as in `experiments.decisions`.
They see the bundled recordings, whose 34 x 34 pixels are mapped onto each network's grid. Weights
are random, because times do not depend on them if about half of the ReLUs are open. Before anything
is timed, all backends must give the same logits within 1e-4.

Packages that are not installed are left out. To install all: `pip install torch==2.13.0 onnx
onnxruntime openvino`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if __name__ == "__main__":  # libraries read these variables when they are imported
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")

import torch
from torch import nn

from async_tnt import CompiledClassifier, Model, TNTConfig, warmup
from async_tnt.base.progress import progress
from async_tnt.training.networks import conv4, residual, thesis
from async_tnt.views.figure_style import LARGE, SMALL, TEXT, axes_at, headline, new_figure, write_at
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed import backends
from experiments.speed.drawing import NETWORKS as LOOKS
from experiments.speed.drawing import draw_lines, lay_axis
from experiments.speed.every_event import bench_every_event
from experiments.speed.moments import NEW_EVENTS, bench_recordings, windows_of
from experiments.speed.networks import bench_network
from experiments.speed.timing import machine, one_thread
from experiments.speed.touched import bench_touched

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FULL = {"blocks": 30, "decisions_a_block": 40, "rounds": 5, "moments": 400}
"""How much is measured."""

QUICK = {"blocks": 2, "decisions_a_block": 10, "rounds": 1, "moments": 40}
"""How much is measured with --quick."""

PACKAGES = ("torch", "onnx", "onnxruntime", "openvino")
"""Packages whose versions the report names."""

NOT_DRAWN = "onnxruntime_run"
"""Row that the picture leaves out, because `onnxruntime_binding` is as fast or faster."""


def gesture(channels: int, grid: tuple[int, int], n_classes: int) -> nn.Module:
    """A network of a kind that is common for recordings of gestures.

    It has a 2x2 convolution of stride 2, 3x3 convolutions, average pools and two dense layers.
    """
    layers: list[nn.Module] = [nn.Conv2d(channels, 16, 2, 2), nn.ReLU()]
    for n_inputs, n_filters in ((16, 16), (16, 32), (32, 32), (32, 64)):
        layers += [nn.Conv2d(n_inputs, n_filters, 3, padding=1), nn.ReLU(), nn.AvgPool2d(2)]
    places = (grid[0] // 32) * (grid[1] // 32)
    return nn.Sequential(
        *layers, nn.Flatten(), nn.Linear(64 * places, 256), nn.ReLU(), nn.Linear(256, n_classes)
    )


NETWORKS: dict[str, tuple[Callable[..., nn.Module], TNTConfig, int]] = {
    "thesis": (thesis, TNTConfig(landmark="running", t_max=2.0), 10),
    "conv4": (
        conv4,
        TNTConfig(grid=(60, 50), bins=5, polarity="split", transform="none", landmark="center"),
        2,
    ),
    "residual": (
        residual,
        TNTConfig(grid=(64, 64), bins=5, polarity="split", transform="none", landmark="center"),
        10,
    ),
    "gesture": (gesture, TNTConfig(grid=(128, 128), representation="count", polarity="split"), 11),
}
"""Name -> the function that builds the network, the settings of its volume, its number of
classes."""


def made_model(name: str) -> Model:
    """A model with torch's initial weights.

    Its batch norms get random statistics, chosen so that the features of no layer vanish.
    """
    build, config, n_classes = NETWORKS[name]
    with torch.random.fork_rng():
        torch.manual_seed(0)
        module = build(config.channels, config.grid, n_classes)
        for part in module.modules():
            if isinstance(part, nn.BatchNorm2d):
                nn.init.uniform_(part.get_buffer("running_mean"), -0.1, 0.1)
                nn.init.uniform_(part.get_buffer("running_var"), 0.05, 0.2)
    return Model.from_torch(module, config, [str(k) for k in range(n_classes)])


def measure(settings: dict[str, int], quick: bool) -> dict[str, Any]:
    """The report of all measurements, as one JSON object.

    Raises
    ------
    WorkDiffers : backends do not give the same results. Then there is no report.
    """
    rows = {}
    with progress(len(NETWORKS) * (len(NEW_EVENTS) + 2), "compiling") as bar, one_thread(True):
        for name in NETWORKS:
            model = made_model(name)
            warmup(model)
            networks = backends.dense_networks(model)
            recordings = bench_recordings(model.config)
            windows = []
            for events in recordings:
                windows += windows_of(events, model.config.window_us)
            counts = {"blocks": settings["blocks"], "size": settings["decisions_a_block"]}
            times = {}
            for n_new in NEW_EVENTS:
                bar.update(title=f"{name}, new events: {n_new}")
                times[str(n_new)] = bench_network(model, networks, windows, n_new, **counts)
            bar.update(title=f"{name}, a decision after every event")
            others = {other: networks[other] for other in backends.ONNXRUNTIME if other in networks}
            rates = bench_every_event(
                model, others, recordings, rounds=settings["rounds"], n_events=500
            )
            bar.update(title=f"{name}, what new events touch")
            arrays = CompiledClassifier(model).network
            rows[name] = {
                "volume": model.config.shape,
                "network": times,
                "every_event": rates,
                "touched": bench_touched(model, windows, moments=settings["moments"]),
                "bytes": {
                    part: getattr(arrays, part).nbytes
                    for part in ("weights", "maps", "places", "program")
                },
            }
    return {
        "machine": machine(*PACKAGES),
        "settings": {"quick": quick, "threads": 1, **settings},
        "networks": rows,
        "left_out": backends.left_out(),
    }


def draw_incremental(report: dict[str, Any]) -> Figure:
    """Draw medians and quartiles of times in blocks, and as hollow marks medians call by call."""
    figure = new_figure(4.4)
    looks = {name: look for name, look in LOOKS.items() if name != NOT_DRAWN}
    for k, (name, row) in enumerate(report["networks"].items()):
        axes = axes_at(figure, 0.62 + 2.12 * k, 0.95, 1.72, 2.6)
        draw_lines(axes, row["network"], looks)
        lay_axis(axes)
        axes.set_xlabel("new events", fontsize=SMALL)
        axes.set_title(f"{name}, {' x '.join(map(str, row['volume']))}", loc="left", fontsize=LARGE)
        if k == 0:
            axes.set_ylabel("microseconds per decision")
    headline(figure, "Time per decision, four networks")
    x = 0.62
    for name, (label, colour) in looks.items():
        if name in report["networks"]["thesis"]["network"]["1"]["in_blocks"]["us"]:
            words = label.replace("\n", " ")
            write_at(figure, x, 4.28, words, fontsize=SMALL, color=colour, va="bottom")
            x += 1.75
    machine_words = f"{report['machine']['cpu']}, one thread"
    write_at(figure, 6.9, 4.28, machine_words, fontsize=SMALL, color=TEXT, va="bottom")
    return figure


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write JSON and the picture if asked.

    Returns 1 if backends do not give the same results.
    """
    parser = script_parser("incremental", __doc__, "a few decisions of each", draws=True)

    def measure_report(quick: bool) -> dict[str, Any]:
        return measure(QUICK if quick else FULL, quick)

    return run_script(parser, argv, measure_report, "incremental", draw_incremental)


if __name__ == "__main__":
    exit_with(main)
