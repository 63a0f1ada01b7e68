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

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt import Processor, load_model
from async_tnt.sources import open_recording, sample_recordings
from async_tnt.sources.files.labelled_recordings import recordings_under
from experiments.scripts.options import add_folder, exit_with, run_script, script_parser
from experiments.speed.moments import on_sensor
from experiments.speed.timing import machine

SURE = 0.9
"""Probability at which a window counts as decided."""

SURER = 0.99
"""Higher probability, whose share of windows is reported, too."""

Place = tuple[np.ndarray, np.ndarray, np.ndarray]
"""x, y, p of each event; x and y may lie off the sensor."""


def noise(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    """Events anywhere on the sensor. The arguments are explained at `KINDS`."""
    n = len(share)
    return rng.uniform(0, side, n), rng.uniform(0, side, n), rng.random(n) < 0.5


def one_polarity(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    x, y, p = noise(share, side, rng)
    return x, y, np.full(len(p), rng.random() < 0.5)


def pairs(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    """Noise in which each event is followed by an event of the other sign at its pixel."""
    x, y, p = noise(share[::2], side, rng)
    n = len(share)
    return x.repeat(2)[:n], y.repeat(2)[:n], np.stack([p, ~p], 1).ravel()[:n]


def hot_pixels(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    """Events of three pixels."""
    n = len(share)
    places = rng.integers(0, side, (3, 2))[rng.integers(0, 3, n)]
    return places[:, 0], places[:, 1], rng.random(n) < rng.random()


def patch(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    """Events all over a rectangle."""
    n = len(share)
    width, height = rng.uniform(0.15 * side, 0.45 * side, 2)
    x = rng.uniform(0, side - width) + width * rng.random(n)
    y = rng.uniform(0, side - height) + height * rng.random(n)
    return x, y, rng.random(n) < rng.random()


def disc(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    """Events all over a disc that flickers: ON and OFF take turns."""
    n = len(share)
    radius = rng.uniform(0.1, 0.25) * side
    distance = radius * np.sqrt(rng.random(n))
    angle = rng.uniform(0, 2 * np.pi, n)
    x, y = rng.uniform(radius, side - radius, 2)
    return (
        x + distance * np.cos(angle),
        y + distance * np.sin(angle),
        np.sin(2 * np.pi * share * rng.integers(2, 8)) > 0,
    )


def edge(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    """Events of one polarity along a straight edge, which moves at right angles to itself."""
    n = len(share)
    angle = rng.uniform(0, 2 * np.pi)
    along = rng.uniform(-1, 1, n) * side
    across = rng.uniform(0.3, 1.0) * side * (share - 0.5) + rng.normal(0, 0.5, n)
    x = side / 2 + across * np.cos(angle) - along * np.sin(angle)
    return (
        x,
        side / 2 + across * np.sin(angle) + along * np.cos(angle),
        np.full(n, rng.random() < 0.5),
    )


def corner(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    """Events along two sides of a moving rectangle: ON along one side, OFF along the other."""
    n = len(share)
    turn = rng.uniform(0, np.pi / 2)
    along = rng.uniform(0, side, n)
    is_first_side = rng.random(n) < 0.5
    shift = rng.uniform(0.2, 0.6) * side * (share - 0.5)
    u = np.where(is_first_side, along, 0) + shift
    v = np.where(is_first_side, 0, along) + shift * rng.choice([-1, 1])
    x = np.cos(turn) * u - np.sin(turn) * v
    y = np.sin(turn) * u + np.cos(turn) * v
    return side / 2 + x, side / 2 + y, is_first_side


KINDS: dict[str, Callable[[np.ndarray, int, np.random.Generator], Place]] = {
    "noise": noise,
    "noise of one polarity": one_polarity,
    "pairs": pairs,
    "hot pixels": hot_pixels,
    "a patch": patch,
    "a straight edge": edge,
    "a flickering disc (tested only)": disc,
    "a corner (tested only)": corner,
}
"""What stands in a window -> function that makes the places of its events.

The function is called with the events' times as shares of the window, with the width of the sensor
in pixels, and with a random generator."""


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


def of_kind(
    kind: Any, events: np.ndarray, side: int, window_us: int, rng: np.random.Generator
) -> np.ndarray:
    """The first window of a recording, with its events moved to the places that `kind` makes."""
    t = events["t"] - events["t"][0]
    t = t[t < window_us]
    x, y, p = kind(t / window_us, side, rng)
    return on_sensor(t, x, y, p, (side, side))


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
