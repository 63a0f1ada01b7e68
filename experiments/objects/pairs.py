"""Made recordings of two grey objects that move together over a small sensor.

This module renders and simulates on its own. It shares no code with the augmentation that is
measured on its recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

SENSOR = (64, 48)
"""Width and height of the sensor, in pixels."""

WINDOW_US = 50_000
"""Length of a recording, in microseconds."""

SHAPES = ("cross", "disc", "square", "triangle")
"""The shapes, of which two move together."""

CLASSES = tuple("-".join(pair) for pair in combinations(SHAPES, 2))
"""The classes. Each is a pair of shapes."""

STEPS = 60
"""Number of steps between the pictures that the pixels see during a recording."""

SUBPIXELS = 2
"""Number of points along each side of a pixel at which a picture is drawn."""


@dataclass(frozen=True)
class Session:
    """What may differ from one day of recording to the next.

    threshold : mean threshold of the pixels, in log luminance.
    mismatch : standard deviation of the logarithm of the pixels' thresholds.
    noise_hz : events of noise a second, of each pixel.
    size : factor of the objects' size.
    place : place (x, y) of the objects from the middle of the sensor, in pixels.
    """

    threshold: float = 0.2
    mismatch: float = 0.1
    noise_hz: float = 0.5
    size: float = 1.0
    place: tuple[float, float] = (0.0, 0.0)


def inside(shape: str, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Whether points (x, y) lie in a shape of radius about 1, whose middle is at (0, 0)."""
    if shape == "disc":
        return np.asarray(np.hypot(x, y) < 0.9)
    if shape == "square":
        return np.asarray(np.maximum(abs(x), abs(y)) < 0.8)
    if shape == "cross":
        return np.asarray((np.minimum(abs(x), abs(y)) < 0.3) & (np.maximum(abs(x), abs(y)) < 1.0))
    return np.asarray((y > -0.6) & (np.sqrt(3) * abs(x) < 1.1 - y))


def record(
    name: str, direction: float, rng: np.random.Generator, session: Session = Session()
) -> dict[str, np.ndarray]:
    """Columns t, x, y, p of one recording of the class `name`.

    direction : direction of the motion, in radians.
    """
    width, height = SENSOR
    objects = []
    for shape, side in zip(rng.permutation(name.split("-")), (-1, 1), strict=True):
        place = np.array([side * rng.uniform(8.5, 10.5), rng.uniform(-5, 5)])
        grey = -rng.uniform(0.4, 1.4)
        size = session.size * rng.uniform(6, 8)
        objects.append((shape, session.size * place, size, rng.uniform(-0.4, 0.4), grey))
    slope = rng.uniform(-0.004, 0.004, 2)
    length = rng.uniform(8, 14)
    speed_up = rng.uniform(-0.5, 0.5)
    fine_y, fine_x = np.mgrid[: height * SUBPIXELS, : width * SUBPIXELS] / SUBPIXELS
    origin = np.array([width, height]) / 2 + session.place + rng.uniform(-2, 2, 2)
    threshold = session.threshold * np.exp(session.mismatch * rng.standard_normal((height, width)))

    def pictures() -> Iterator[np.ndarray]:
        for u in np.arange(STEPS + 1) / STEPS:
            distance = length * (u + speed_up * u * (1 - u) - 0.5)
            x = fine_x - origin[0] - distance * np.cos(direction)
            y = fine_y - origin[1] - distance * np.sin(direction)
            light = np.exp(slope[0] * x + slope[1] * y)
            for shape, place, size, turn, grey in objects:
                a = (x - place[0]) / size
                b = (y - place[1]) / size
                own_x = np.cos(turn) * a + np.sin(turn) * b
                own_y = np.cos(turn) * b - np.sin(turn) * a
                is_inside = inside(shape, own_x, own_y)
                light = np.where(is_inside, light * np.exp(grey), light)
            yield np.log(light.reshape(height, SUBPIXELS, width, SUBPIXELS).mean((1, 3)))

    return in_order(*pixel_events(pictures(), threshold, session.noise_hz, WINDOW_US, STEPS, rng))


def pixel_events(
    pictures: Iterable[np.ndarray],
    threshold: np.ndarray,
    noise_hz: float,
    window_us: int,
    steps: int,
    rng: np.random.Generator,
) -> list[np.ndarray]:
    """Columns t, x, y, p of the events of pixels, and of noise.

    The events are not in order, and their times are float.

    pictures : `steps` + 1 pictures of log luminance, (H, W), one after the other.
    threshold : threshold of each pixel in log luminance, (H, W).
    noise_hz : events of noise a second, of each pixel.
    """
    level = None  # the log luminance at each pixel's last event
    parts = []
    for step, light in enumerate(pictures):
        if level is None:
            level = light + threshold * rng.uniform(-1, 1, light.shape)
            continue
        # a pixel has as many events as there are thresholds between its light and its level
        n_thresholds = np.trunc((light - level) / threshold).astype(int)
        level = level + n_thresholds * threshold
        rows, columns = np.nonzero(n_thresholds)
        n_events = abs(n_thresholds[rows, columns])
        t = (step - 1 + rng.random(n_events.sum())) * window_us / steps
        is_on = n_thresholds[rows, columns] > 0
        parts.append((t, columns.repeat(n_events), rows.repeat(n_events), is_on.repeat(n_events)))

    height, width = threshold.shape
    n_noise = rng.poisson(noise_hz * width * height * window_us * 1e-6)
    x = rng.integers(0, width, n_noise)
    y = rng.integers(0, height, n_noise)
    parts.append((window_us * rng.random(n_noise), x, y, rng.random(n_noise) < 0.5))
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def in_order(t: np.ndarray, x: np.ndarray, y: np.ndarray, p: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of events in order of time, with times in whole microseconds."""
    order = np.argsort(t)
    return {"t": t[order].astype(np.int64), "x": x[order], "y": y[order], "p": p[order]}


def write(
    folder: Path, n: int, directions: tuple[float, ...], seed: int, session: Session = Session()
) -> Path:
    """Write `n` recordings of each class as `folder/<class>/<number>.npz`.

    The recordings of a class take the `directions` in turn.
    """

    def recorded(name: str, i: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
        return record(name, directions[i % len(directions)], rng, session)

    return write_classes(folder, CLASSES, n, seed, recorded)


def write_classes(
    folder: Path,
    classes: Iterable[str],
    n: int,
    seed: int,
    record: Callable[[str, int, np.random.Generator], dict[str, np.ndarray]],
) -> Path:
    """Write `n` recordings of each class as `folder/<class>/<number>.npz`.

    record : called with a class, a number and a random generator of its own; returns the columns of
        a recording.
    """
    for label, name in enumerate(classes):
        (folder / name).mkdir(parents=True, exist_ok=True)
        for i in range(n):
            columns: dict[str, Any] = record(name, i, np.random.default_rng((seed, label, i)))
            np.savez(folder / name / f"{i:03}.npz", **columns)
    return folder
