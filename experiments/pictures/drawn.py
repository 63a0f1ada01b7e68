"""Pictures of the eight kinds of drawn objects, as a user would have them: PNG files in folders.

A ninth folder has pictures of other things, so that what is none of the kinds need not look like
one of them: polygons with random corners, rounded shapes, and lines.

Each picture shows another object of its kind, in one grey, on a transparent ground, turned by up to
15 degrees. The objects are put together from ellipses and polygons. This module shares no code with
`objects/kinds.py`, which draws the objects of the scenes that test: a heart here is two circles
and a wedge, and there a curve.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from PIL.Image import Image

PICTURES_SEED = 0
"""Seed of the pictures to train on."""

SIDE = 160
"""Width and height of a picture, in pixels."""

OBJECT = 0.75
"""Longer side of an object that is not turned, as a share of the picture's side."""

POSTURE = 15.0
"""Largest angle by which an object is turned, in degrees."""

STRETCH = 0.15
"""Largest change of the logarithm of an object's width."""

FINE = 4
"""Number of points along each side of a pixel at which a picture is drawn."""

REACH = 1.5
"""Reach of the sheet from its middle, in the lengths in which objects are drawn."""

SHEET = 960
"""Width and height of the sheet on which an object is drawn, in points."""

GREYS = (20, 236)
"""Least grey of an object, and the end of its range."""


class Sheet:
    """A square sheet from -`REACH` to `REACH`, y pointing down. What is filled is the object."""

    def __init__(self) -> None:
        from PIL import Image, ImageDraw

        self.image: Image.Image = Image.new("L", (SHEET, SHEET), 0)
        self._canvas = ImageDraw.Draw(self.image)

    def polygon(self, corners: list[tuple[float, float]] | np.ndarray, filled: bool = True) -> None:
        """Fill a polygon, or cut it out."""
        points = [(self._at(x), self._at(y)) for x, y in corners]
        self._canvas.polygon(points, fill=255 if filled else 0)

    def box(self, x0: float, y0: float, x1: float, y1: float, filled: bool = True) -> None:
        """Fill a rectangle, or cut it out."""
        self.polygon([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], filled)

    def ellipse(
        self, x: float, y: float, radius_x: float, radius_y: float, filled: bool = True
    ) -> None:
        """Fill an ellipse about (x, y), or cut it out."""
        low = (self._at(x - radius_x), self._at(y - radius_y))
        high = (self._at(x + radius_x), self._at(y + radius_y))
        self._canvas.ellipse([low, high], fill=255 if filled else 0)

    @staticmethod
    def _at(length: float) -> float:
        return SHEET * (0.5 + length / (2 * REACH))


def _arrow(sheet: Sheet, rng: np.random.Generator) -> None:
    shaft = rng.uniform(0.1, 0.22)
    wing = rng.uniform(0.4, 0.65)
    neck = rng.uniform(-0.35, 0.2)
    barb = rng.uniform(0.0, 0.15)
    sheet.polygon([(0, -1), (wing, neck + barb), (0, neck), (-wing, neck + barb)])
    sheet.box(-shaft, neck - 0.1, shaft, 1)


def _cross(sheet: Sheet, rng: np.random.Generator) -> None:
    upright = rng.uniform(0.15, 0.28)
    level = rng.uniform(0.15, 0.28)
    wide = rng.uniform(0.7, 1.0)
    middle = rng.uniform(-0.1, 0.1)
    sheet.box(-upright, -1, upright, 1)
    sheet.box(-wide, middle - level, wide, middle + level)


def _cup(sheet: Sheet, rng: np.random.Generator) -> None:
    top = rng.uniform(0.5, 0.65)
    bottom = top * rng.uniform(0.65, 1.0)
    tall = rng.uniform(0.65, 0.9)
    thick = rng.uniform(0.1, 0.18)
    reach = rng.uniform(0.35, 0.5)
    handle = tall * rng.uniform(0.5, 0.75)
    high = rng.uniform(-0.15, 0.05)
    sheet.ellipse(bottom, high, top - bottom + reach, handle)
    inner = max(top - bottom + reach - thick, 0.1)
    sheet.ellipse(bottom, high, inner, handle - thick, filled=False)
    sheet.polygon([(-top, -tall), (top, -tall), (bottom, tall), (-bottom, tall)])


def _fish(sheet: Sheet, rng: np.random.Generator) -> None:
    tall = rng.uniform(0.34, 0.52)
    tail = rng.uniform(0.28, 0.48)
    back = rng.uniform(-1.25, -1.05)
    notch = rng.uniform(0.0, 0.2)
    sheet.ellipse(0, 0, 0.8, tall)
    sheet.polygon([(-0.55, 0), (back, -tail), (back + notch, 0), (back, tail)])
    if rng.random() < 0.3:
        sheet.polygon([(-0.3, -0.7 * tall), (0.0, -1.25 * tall), (0.25, -0.7 * tall)])


def _heart(sheet: Sheet, rng: np.random.Generator) -> None:
    apart = rng.uniform(0.4, 0.5)
    radius = rng.uniform(0.48, 0.56)
    tip = rng.uniform(0.9, 1.15)
    for side in (-1, 1):
        sheet.ellipse(side * apart, -0.35, radius, radius)
    # from the tip a straight line touches each circle
    away = np.hypot(apart, tip + 0.35)
    turned = np.arctan2(apart, tip + 0.35) + np.arcsin(radius / away)
    length = np.sqrt(away**2 - radius**2)
    touch_x = length * np.sin(turned)
    touch_y = tip - length * np.cos(turned)
    sheet.polygon([(0, tip), (touch_x, touch_y), (0, -0.35), (-touch_x, touch_y)])


def _house(sheet: Sheet, rng: np.random.Generator) -> None:
    wall = rng.uniform(0.5, 0.75)
    eaves = rng.uniform(0.05, 0.22)
    roof = rng.uniform(-0.35, 0.05)
    low = rng.uniform(0.7, 0.95)
    top = rng.uniform(-1.0, -0.8)
    door = rng.uniform(0.12, 0.2)
    lintel = rng.uniform(0.15, 0.4)
    if rng.random() < 0.25:
        sheet.box(0.5 * wall, 0.7 * top, 0.5 * wall + 0.16, roof)
    sheet.polygon([(0, top), (wall + eaves, roof), (-wall - eaves, roof)])
    sheet.box(-wall, roof, wall, low)
    side = rng.uniform(-0.1, 0.1)
    sheet.box(side - door, lintel, side + door, low, filled=rng.random() < 0.1)


def _key(sheet: Sheet, rng: np.random.Generator) -> None:
    ring = rng.uniform(0.33, 0.46)
    flat = rng.uniform(0.85, 1.1)
    hole = ring * rng.uniform(0.4, 0.6)
    thick = rng.uniform(0.08, 0.13)
    sheet.ellipse(0, -0.55, ring, flat * ring)
    sheet.ellipse(0, -0.55, hole, flat * hole, filled=False)
    end = rng.uniform(0.85, 1.0)
    sheet.box(-thick, -0.55 + flat * ring - 0.05, thick, end)
    tooth = rng.uniform(0.15, 0.22)
    for bottom in (end, end - tooth - rng.uniform(0.12, 0.22)):
        sheet.box(0, bottom - tooth, rng.uniform(0.25, 0.4), bottom)


def _star(sheet: Sheet, rng: np.random.Generator) -> None:
    inner = rng.uniform(0.34, 0.5)
    angles = np.pi / 5 * np.arange(10) - np.pi / 2
    radii = np.where(np.arange(10) % 2 == 0, rng.uniform(0.92, 1.0, 10), inner)
    sheet.polygon(np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1))


DRAWERS: dict[str, Callable[[Sheet, np.random.Generator], None]] = {
    "arrow": _arrow,
    "cross": _cross,
    "cup": _cup,
    "fish": _fish,
    "heart": _heart,
    "house": _house,
    "key": _key,
    "star": _star,
}
"""Kind of objects -> function that draws one of them on a sheet."""

OTHER = "other"
"""The class of things that are none of the kinds."""

CORNERS = (3, 7)
"""Least and largest number of corners of a polygon of other things."""


def _other(sheet: Sheet, rng: np.random.Generator) -> None:
    """Draw a random thing."""
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
    sheet.polygon(corners)


def _cover(draw: Callable[[Sheet, np.random.Generator], None], rng: np.random.Generator) -> Image:
    """What an object covers of a picture: one channel, `SIDE` x `SIDE`, 255 where it is opaque."""
    from PIL import Image

    sheet = Sheet()
    draw(sheet, rng)
    drawn = sheet.image.crop(sheet.image.getbbox())
    width = drawn.width * np.exp(rng.uniform(-STRETCH, STRETCH))
    scale = FINE * SIDE * OBJECT / max(width, drawn.height)
    size = (max(1, round(scale * width)), max(1, round(scale * drawn.height)))
    picture = Image.new("L", (FINE * SIDE, FINE * SIDE), 0)
    corner = ((FINE * SIDE - size[0]) // 2, (FINE * SIDE - size[1]) // 2)
    picture.paste(drawn.resize(size, Image.Resampling.BILINEAR), corner)
    turned = picture.rotate(rng.uniform(-POSTURE, POSTURE), Image.Resampling.BILINEAR)
    return turned.resize((SIDE, SIDE), Image.Resampling.BOX)


def write_drawn(folder: Path, n: int, seed: int = PICTURES_SEED) -> Path:
    """Write `n` pictures of each kind, and twice as many of other things.

    They are `folder/<kind>/<number>.png`. Returns the folder.
    """
    from PIL import Image

    for label, (kind, draw) in enumerate([*DRAWERS.items(), (OTHER, _other)]):
        (folder / kind).mkdir(parents=True, exist_ok=True)
        for i in range(2 * n if kind == OTHER else n):
            rng = np.random.default_rng((seed, label, i))
            cover = _cover(draw, rng)
            grey = Image.new("L", (SIDE, SIDE), int(rng.integers(*GREYS)))
            Image.merge("LA", (grey, cover)).save(folder / kind / f"{i:03}.png")
    return folder
