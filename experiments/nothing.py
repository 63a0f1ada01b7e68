"""How often a model is confident where none of its classes is there.

The model sees windows of noise, hot pixels, patches, edges and other objects.

    python -m experiments.nothing [--model NAME|FILE] [--poker POKER-DVS] [--characters FOLDER]
                                  [--cars N-CARS] [--json FILE] [--quick]

The events of windows have the times of bundled recordings, and other places. `train` shows noise,
events of one polarity, hot pixels, rectangular patches and straight edges to its networks, too.
Discs, corners and other objects are shown by this command alone. The windows are made by code of
their own, which `train` does not share. Recordings of other objects are left out if their folder
has the name of a class of the model.

The report has the share of windows that end with a class of probability .9. It also has the shares
of windows in which a class has .9 or .99 at some moment; the model decides after every event.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt import Processor, load_model
from async_tnt.sources import open_recording, sample_recordings
from async_tnt.sources.files.labelled_recordings import recordings_under
from experiments.objects.no_objects import KINDS, of_kind
from experiments.scripts.options import add_folder, exit_with, run_script, script_parser
from experiments.speed.moments import on_sensor
from experiments.speed.timing import machine

SURE = 0.9
"""Probability at which a window counts as decided."""

SURER = 0.99
"""Higher probability, whose share of windows is reported, too."""


def measure(model: str, folders: dict[str, Path], n_windows: int) -> dict[str, Any]:
    """The report: shares of windows that are decided with confidence, for each kind of window."""
    processor = Processor(load_model(model), start_us=0, every_events=1)
    config = processor.config
    rows = {}
    samples = [open_recording(path).read() for path in sample_recordings().values()]
    for name, kind in KINDS.items():
        rng = np.random.default_rng(len(name))
        windows = (
            of_kind(kind, samples[k % len(samples)], config.sensor[0], config.window_us, rng)
            for k in range(n_windows)
        )
        rows[name] = _share(processor, windows)
    own_classes = processor.classes or ()
    for name, folder in folders.items():
        files = [path for path in recordings_under(folder) if path.parent.name not in own_classes]
        objects = _objects(files, config.sensor[0], config.window_us, n_windows)
        rows[f"{name} (tested only)"] = _share(processor, objects)
    return {"machine": machine(), "model": Path(model).name, "sure": SURE, "rows": rows}


def _objects(files: list[Path], side: int, window_us: int, most: int) -> Iterator[np.ndarray]:
    """The first windows of at most `most` recordings of other objects, spread over `files`.

    Recordings that are larger than the sensor are scaled down.
    """
    step = max(1, len(files) // most)
    for file in files[::step][:most]:
        events = open_recording(file).read()
        t = events["t"] - events["t"][0]
        size = max(int(events["x"].max()), int(events["y"].max())) + 1
        scale = max(1.0, size / side)
        in_window = t < window_us
        window = events[in_window]
        yield on_sensor(
            t[in_window], window["x"] / scale, window["y"] / scale, window["p"] > 0, (side, side)
        )


def _share(processor: Processor, windows: Iterator[np.ndarray]) -> dict[str, Any]:
    """Shares of windows with a confident decision, at the end and at some moment."""
    last_probabilities = []
    highest_probabilities = []
    for events in windows:
        processor.reset()
        probabilities = [
            decision.probability for decision in [*processor.push(events), processor.fire()]
        ]
        last_probabilities.append(probabilities[-1])
        highest_probabilities.append(max(probabilities))
    at_some_moment = {
        f"{level:g}": float(np.mean(np.array(highest_probabilities) >= level))
        for level in (SURE, SURER)
    }
    decided = float(np.mean(np.array(last_probabilities) >= SURE))
    return {
        "windows": len(last_probabilities),
        "decided": decided,
        "at_some_moment": at_some_moment,
    }


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write the files that are asked for."""
    parser = script_parser("nothing", __doc__, "ten windows of each kind")
    parser.add_argument(
        "--model", default="digits", metavar="NAME|FILE", help="a model (default: digits)"
    )
    for name in ("poker", "characters", "cars"):
        add_folder(parser, f"--{name}", f"recordings of {name}, which are objects of other kinds")
    args = parser.parse_args(argv)
    folders = {
        name: getattr(args, name)
        for name in ("poker", "characters", "cars")
        if getattr(args, name) is not None
    }

    def measure_report(quick: bool) -> dict[str, Any]:
        return measure(args.model, folders, 10 if quick else 500)

    return run_script(parser, argv, measure_report, "nothing")


if __name__ == "__main__":
    exit_with(main)
