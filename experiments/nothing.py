"""How often a model is confident where none of its classes is there.

It sees noise, hot pixels, patches, edges and objects.

    python -m experiments.nothing [--model NAME|FILE] [--poker POKER-DVS] [--characters FOLDER]
                                  [--cars N-CARS] [--json FILE] [--quick]

Windows have the times of the bundled recordings' events, which stand somewhere else. `train` shows
noise, events of one polarity, hot pixels, rectangular patches and straight edges to its networks;
discs and corners, and other objects, only this command does. Here they are made by code of their
own. Shares are of windows whose class has .9 at their ends, and of those in which one has .9 or .99
at some moment, asked after every event. Of other objects, those in folders that are named as a
class of the model are left out.
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
"""Confidence at which a window counts as decided."""

SURER = 0.99
"""Higher confidence that is asked for, too."""

Place = tuple[np.ndarray, np.ndarray, np.ndarray]
"""x, y, p of each event; x and y may lie off the sensor."""


def noise(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    n = len(share)
    return rng.uniform(0, side, n), rng.uniform(0, side, n), rng.random(n) < 0.5


def one_polarity(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    x, y, p = noise(share, side, rng)
    return x, y, np.full(len(p), rng.random() < 0.5)


def pairs(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    """Each event is followed by one of the other sign at its pixel."""
    x, y, p = noise(share[::2], side, rng)
    n = len(share)
    return x.repeat(2)[:n], y.repeat(2)[:n], np.stack([p, ~p], 1).ravel()[:n]


def hot_pixels(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    n = len(share)
    places = rng.integers(0, side, (3, 2))[rng.integers(0, 3, n)]
    return places[:, 0], places[:, 1], rng.random(n) < rng.random()


def patch(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    n = len(share)
    width, height = rng.uniform(0.15 * side, 0.45 * side, 2)
    x = rng.uniform(0, side - width) + width * rng.random(n)
    y = rng.uniform(0, side - height) + height * rng.random(n)
    return x, y, rng.random(n) < rng.random()


def disc(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
    """Events all over a disc that flickers: ON and OFF take turns."""
    n = len(share)
    radius = rng.uniform(0.1, 0.25) * side
    far = radius * np.sqrt(rng.random(n))
    angle = rng.uniform(0, 2 * np.pi, n)
    x, y = rng.uniform(radius, side - radius, 2)
    return (
        x + far * np.cos(angle),
        y + far * np.sin(angle),
        np.sin(2 * np.pi * share * rng.integers(2, 8)) > 0,
    )


def edge(share: np.ndarray, side: int, rng: np.random.Generator) -> Place:
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
    """Two sides of a dark rectangle that moves: one is ON, the other OFF."""
    n = len(share)
    turn = rng.uniform(0, np.pi / 2)
    along = rng.uniform(0, side, n)
    first = rng.random(n) < 0.5
    moved = rng.uniform(0.2, 0.6) * side * (share - 0.5)
    u = np.where(first, along, 0) + moved
    v = np.where(first, 0, along) + moved * rng.choice([-1, 1])
    x = np.cos(turn) * u - np.sin(turn) * v
    y = np.sin(turn) * u + np.cos(turn) * v
    return side / 2 + x, side / 2 + y, first


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
"""What stands in a window -> what makes its events."""


def measure(model: str, folders: dict[str, Path], n_windows: int) -> dict[str, Any]:
    """Share of windows decided with confidence, by what is in them."""
    processor = Processor(load_model(model), start_us=0, every_events=1)
    config = processor.config
    rows = {}
    samples = [open_recording(path).read() for path in sample_recordings().values()]
    for name, kind in KINDS.items():
        rng = np.random.default_rng(len(name))
        windows = (
            _of_kind(kind, samples[k % len(samples)], config.sensor[0], config.window_us, rng)
            for k in range(n_windows)
        )
        rows[name] = _share(processor, windows)
    known = processor.classes or ()
    for name, folder in folders.items():
        files = [path for path in recordings_under(folder) if path.parent.name not in known]
        objects = _objects(files, config.sensor[0], config.window_us, n_windows)
        rows[f"{name} (tested only)"] = _share(processor, objects)
    return {"machine": machine(), "model": Path(model).name, "sure": SURE, "rows": rows}


def _of_kind(
    kind: Any, events: np.ndarray, side: int, window_us: int, rng: np.random.Generator
) -> np.ndarray:
    """The first window of a recording, with its events at the places that `kind` makes."""
    t = events["t"] - events["t"][0]
    t = t[t < window_us]
    x, y, p = kind(t / window_us, side, rng)
    return on_sensor(t, x, y, p, (side, side))


def _objects(files: list[Path], side: int, window_us: int, most: int) -> Iterator[np.ndarray]:
    """The first window of other recordings, scaled down to the sensor where they are larger."""
    for file in files[:: max(1, len(files) // most)][:most]:
        events = open_recording(file).read()
        t = events["t"] - events["t"][0]
        scale = max(1.0, (max(int(events["x"].max()), int(events["y"].max())) + 1) / side)
        in_window = t < window_us
        window = events[in_window]
        yield on_sensor(
            t[in_window], window["x"] / scale, window["y"] / scale, window["p"] > 0, (side, side)
        )


def _share(processor: Processor, windows: Iterator[np.ndarray]) -> dict[str, Any]:
    last = []
    highest = []
    for events in windows:
        processor.reset()
        probabilities = [
            decision.probability for decision in [*processor.push(events), processor.fire()]
        ]
        last.append(probabilities[-1])
        highest.append(max(probabilities))
    at_some_moment = {
        f"{level:g}": float(np.mean(np.array(highest) >= level)) for level in (SURE, SURER)
    }
    decided = float(np.mean(np.array(last) >= SURE))
    return {"windows": len(last), "decided": decided, "at_some_moment": at_some_moment}


def main(argv: list[str] | None = None) -> int:
    """Measure, print and write."""
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

    def measured(quick: bool) -> dict[str, Any]:
        return measure(args.model, folders, 10 if quick else 500)

    return run_script(parser, argv, measured, "nothing")


if __name__ == "__main__":
    exit_with(main)
