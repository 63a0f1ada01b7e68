"""Pictures of the eight kinds of drawn objects, as a user would have them: PNG files in folders.

A ninth folder has pictures of other things, so that what is none of the kinds need not look like
one of them: polygons with random corners, rounded shapes, and lines.

Each picture shows another object of its kind, in one grey, on a transparent ground, turned by up to
15 degrees. The objects of
the scenes that test (`objects/scenes.py`) are drawn from other random numbers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments.objects.kinds import KINDS, Outline, outline

PICTURES_SEED = 0
"""Seed of the pictures to train on."""

SIDE = 160
"""Width and height of a picture, in pixels."""

OBJECT = 0.75
"""Longer side of an object that is not turned, as a share of the picture's side."""

POSTURE = np.radians(15.0)
"""Largest angle by which an object is turned, in radians."""

FINE = 4
"""Number of points along each side of a pixel at which a picture is drawn."""


OTHER = "other"
"""The class of things that are none of the kinds."""

CORNERS = (3, 7)
"""Least and largest number of corners of a polygon of other things."""


def _other(rng: np.random.Generator) -> Outline:
    """The outline of a random thing, with a longer side of 1."""
    n = int(rng.integers(CORNERS[0], CORNERS[1] + 1))
    angles = np.sort(rng.uniform(0, 2 * np.pi, n))
    radii = rng.uniform(0.35, 1.0, n)
    corners = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)
    sort = rng.integers(3)
    if sort == 1:  # rounded: each corner is cut off again and again
        for _ in range(3):
            following = np.roll(corners, -1, axis=0)
            cut = [0.75 * corners + 0.25 * following, 0.25 * corners + 0.75 * following]
            corners = np.stack(cut, axis=1).reshape(-1, 2)
    if sort == 2:  # a line of some width
        half = rng.uniform(0.01, 0.12)
        corners = np.array([(-1, -half), (1, -half), (1, half), (-1, half)])
        angle = rng.uniform(0, np.pi)
        turned = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        corners = corners @ turned
    low = corners.min(axis=0)
    high = corners.max(axis=0)
    return [(corners - (low + high) / 2) / (high - low).max()]


def write_drawn(folder: Path, n: int, seed: int = PICTURES_SEED) -> Path:
    """Write `n` pictures of each kind, and twice as many of other things.

    They are `folder/<kind>/<number>.png`. Returns the folder.
    """
    from PIL import Image, ImageDraw

    for label, kind in enumerate([*KINDS, OTHER]):
        (folder / kind).mkdir(parents=True, exist_ok=True)
        for i in range(2 * n if kind == OTHER else n):
            rng = np.random.default_rng((seed, label, i))
            angle = rng.uniform(-POSTURE, POSTURE)
            turned = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            lines = _other(rng) if kind == OTHER else outline(kind, rng)
            around, *holes = [line @ turned for line in lines]
            cover = Image.new("L", (FINE * SIDE, FINE * SIDE), 0)
            canvas = ImageDraw.Draw(cover)
            for line, opaque in [(around, 255), *((hole, 0) for hole in holes)]:
                points = FINE * SIDE * (0.5 + OBJECT * line)
                canvas.polygon([(x, y) for x, y in points.tolist()], fill=opaque)
            alpha = cover.resize((SIDE, SIDE), Image.Resampling.BOX)
            grey = Image.new("L", (SIDE, SIDE), int(rng.integers(20, 236)))
            Image.merge("LA", (grey, alpha)).save(folder / kind / f"{i:03}.png")
    return folder
