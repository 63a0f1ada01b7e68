"""Windows that show no object, made by code that training does not share.

The events of a window have the times of a recording, and other places.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from experiments.speed.moments import on_sensor

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


def of_kind(
    kind: Any, events: np.ndarray, side: int, window_us: int, rng: np.random.Generator
) -> np.ndarray:
    """The first window of a recording, with its events moved to the places that `kind` makes."""
    t = events["t"] - events["t"][0]
    t = t[t < window_us]
    x, y, p = kind(t / window_us, side, rng)
    return on_sensor(t, x, y, p, (side, side))
