"""Pictures of the eight kinds of drawn objects, as a user would have them: PNG files in folders.

Each picture shows another object of its kind, in one grey, on a transparent ground, turned by up to
15 degrees. The objects of
the scenes that test (`objects/scenes.py`) are drawn from other random numbers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments.objects.kinds import KINDS, outline

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


def write_drawn(folder: Path, n: int, seed: int = PICTURES_SEED) -> Path:
    """Write `n` pictures of each kind as `folder/<kind>/<number>.png`, and return the folder."""
    from PIL import Image, ImageDraw

    for label, (kind, _) in enumerate(KINDS.items()):
        (folder / kind).mkdir(parents=True, exist_ok=True)
        for i in range(n):
            rng = np.random.default_rng((seed, label, i))
            angle = rng.uniform(-POSTURE, POSTURE)
            turned = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            around, *holes = [line @ turned for line in outline(kind, rng)]
            cover = Image.new("L", (FINE * SIDE, FINE * SIDE), 0)
            canvas = ImageDraw.Draw(cover)
            for line, opaque in [(around, 255), *((hole, 0) for hole in holes)]:
                points = FINE * SIDE * (0.5 + OBJECT * line)
                canvas.polygon([(x, y) for x, y in points.tolist()], fill=opaque)
            alpha = cover.resize((SIDE, SIDE), Image.Resampling.BOX)
            grey = Image.new("L", (SIDE, SIDE), int(rng.integers(20, 236)))
            Image.merge("LA", (grey, alpha)).save(folder / kind / f"{i:03}.png")
    return folder
