"""Outlines of eight kinds of drawn objects. Each object of a kind has other proportions.

The kinds are arrow, cross, cup, fish, heart, house, key and star. An outline has one line around
the object, and further lines around its holes. Its longer side is 1 long, and its middle is at
(0, 0); y points down.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Line = np.ndarray
"""Corners (x, y) of a closed line, float64, (n, 2)."""

Outline = list[Line]
"""The line around an object, and then those around its holes."""


def _circle(x: float, y: float, radius_x: float, radius_y: float, n: int = 28) -> Line:
    angles = np.arange(n) * 2 * np.pi / n
    return np.stack([x + radius_x * np.cos(angles), y + radius_y * np.sin(angles)], axis=1)


def _arrow(rng: np.random.Generator) -> Outline:
    shaft = rng.uniform(0.13, 0.2)
    wing = rng.uniform(0.45, 0.6)
    neck = rng.uniform(-0.1, 0.15)
    right = [(0, -1), (wing, neck), (shaft, neck), (shaft, 1)]
    return [_mirrored(right)]


def _cross(rng: np.random.Generator) -> Outline:
    thick = rng.uniform(0.17, 0.26)
    wide = rng.uniform(0.75, 1.0)
    corners = [(thick, -1), (thick, -thick), (wide, -thick)]
    corners += [(wide, thick), (thick, thick), (thick, 1)]
    return [_mirrored(corners)]


def _cup(rng: np.random.Generator) -> Outline:
    taper = rng.uniform(0.0, 0.15)
    wide = rng.uniform(0.5, 0.62)
    tall = rng.uniform(0.7, 0.85)
    out = wide + rng.uniform(0.38, 0.48)
    thick = rng.uniform(0.12, 0.17)
    top, bottom = -0.7 * tall, 0.55 * tall
    body = [(-wide, -tall), (wide, -tall), (wide, top)]
    handle = [(out - 0.1, top), (out, top + 0.1), (out, bottom - 0.15), (out - 0.15, bottom)]
    rest = [(wide - taper, bottom), (wide - taper, tall), (-wide + taper, tall)]
    left = wide + 0.06
    hole = [(left, top + thick), (out - thick, top + thick)]
    hole += [(out - thick, bottom - thick), (left - taper / 2, bottom - thick)]
    return [np.array([*body, *handle, *rest], float), np.array(hole, float)]


def _fish(rng: np.random.Generator) -> Outline:
    tall = rng.uniform(0.38, 0.5)
    tail = rng.uniform(0.32, 0.45)
    angles = np.radians(np.linspace(160, -160, 27))
    body = np.stack([-0.25 + 0.75 * np.cos(angles), tall * np.sin(angles)], axis=1)
    # the body's lines cross behind it, and end at the fin of the tail
    fin = [(-1.35, -tail), (-1.2, 0.0), (-1.35, tail)]
    return [np.concatenate([body, np.array(fin, float)])]


def _heart(rng: np.random.Generator) -> Outline:
    deep = rng.uniform(4.0, 6.0)
    angles = np.arange(36) * 2 * np.pi / 36
    x = 16 * np.sin(angles) ** 3
    y = -(13 * np.cos(angles) - deep * np.cos(2 * angles) - 2 * np.cos(3 * angles))
    return [np.stack([x, y], axis=1)]


def _house(rng: np.random.Generator) -> Outline:
    eaves = rng.uniform(0.1, 0.2)
    roof = rng.uniform(-0.25, 0.0)
    wall = rng.uniform(0.55, 0.7)
    low = rng.uniform(0.75, 0.95)
    door = rng.uniform(0.14, 0.2)
    top = rng.uniform(0.2, 0.35)
    walls = [(0, -0.95), (wall + eaves, roof), (wall, roof), (wall, low)]
    doorway = [(-door, top), (door, top), (door, low - 0.02), (-door, low - 0.02)]
    return [_mirrored(walls), np.array(doorway, float)]


def _key(rng: np.random.Generator) -> Outline:
    ring = rng.uniform(0.36, 0.44)
    hole = ring * rng.uniform(0.42, 0.55)
    thick = rng.uniform(0.09, 0.12)
    tooth = rng.uniform(0.28, 0.36)
    # the ring is open where the shaft begins
    angles = np.radians(np.linspace(90 + 16, 450 - 16, 25))
    head = np.stack([ring * np.cos(angles), -0.55 + ring * np.sin(angles)], axis=1)
    shaft = [(thick, 0.35), (tooth, 0.35), (tooth, 0.55), (thick, 0.55), (thick, 0.72)]
    shaft += [(tooth, 0.72), (tooth, 0.95), (-thick, 0.95)]
    return [np.concatenate([head, np.array(shaft, float)]), _circle(0, -0.55, hole, hole, 16)]


def _star(rng: np.random.Generator) -> Outline:
    inner = rng.uniform(0.36, 0.46)
    angles = np.pi / 5 * np.arange(10) - np.pi / 2
    radii = np.where(np.arange(10) % 2 == 0, 1.0, inner)
    return [np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)]


KINDS: dict[str, Callable[[np.random.Generator], Outline]] = {
    "arrow": _arrow,
    "cross": _cross,
    "cup": _cup,
    "fish": _fish,
    "heart": _heart,
    "house": _house,
    "key": _key,
    "star": _star,
}
"""Kind of objects -> function that draws the outline of one of them."""

STRETCH = 0.12
"""Largest change of the logarithm of an outline's width."""


def _mirrored(right: list[tuple[float, float]]) -> Line:
    """A line through corners on the right from top to bottom, and through their mirror images."""
    corners = np.array(right, float)
    left = corners[::-1] * (-1, 1)
    # a corner on the axis is its own mirror image
    return np.concatenate([corners, left[left[:, 0] != 0]])


def outline(kind: str, rng: np.random.Generator) -> Outline:
    """The outline of one object of a kind, with proportions that `rng` draws."""
    lines = KINDS[kind](rng)
    stretch = np.exp(rng.uniform(-STRETCH, STRETCH))
    lines = [line * (stretch, 1) for line in lines]
    low = lines[0].min(axis=0)
    high = lines[0].max(axis=0)
    return [(line - (low + high) / 2) / (high - low).max() for line in lines]


def distances(lines: Outline, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The distance from an outline at places (x, y), negative inside the object."""
    nearest = np.full(x.shape, np.inf)
    is_inside = np.zeros(x.shape, bool)
    for line in lines:
        for (x0, y0), (x1, y1) in zip(line, np.roll(line, -1, axis=0), strict=True):
            across = x1 - x0
            down = y1 - y0
            # the nearest point of this side is at this share of the way to (x1, y1)
            along = ((x - x0) * across + (y - y0) * down) / (across**2 + down**2)
            share = np.clip(along, 0, 1)
            nearest = np.minimum(nearest, np.hypot(x - x0 - share * across, y - y0 - share * down))
            # A ray to the right from an inner place crosses the lines an odd number of times.
            is_level = (y0 > y) != (y1 > y)
            if down != 0:
                is_inside ^= is_level & (x < x0 + (y - y0) * across / down)
    return np.where(is_inside, -nearest, nearest)
