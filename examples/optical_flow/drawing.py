"""Pictures drawn by code: grounds with a texture, and objects.

A picture is an array of luminance from 0 to 1, with `FINENESS` places along a side of a pixel.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PIL import Image, ImageDraw, ImageFilter, ImageFont

FINENESS = 2
"""Number of places of a picture along a side of a sensor pixel."""

OVERSAMPLING = 2
"""Shapes are drawn this many times larger, and then made smaller. So their edges are smooth."""

BLURS_PX = (0.4, 0.9)
"""Range of the standard deviation of the lens' blur, in pixels."""

LETTERS = "ABCDEFGHJKLMNPRSTUVWXYZ23456789"
"""Characters that are drawn as objects."""


def texture(kind: str, side: int, rng: np.random.Generator) -> np.ndarray:
    """A ground of `side` times `side` places: float64, luminance from 0 to 1.

    kind : a key of `TEXTURES`.
    """
    return np.clip(TEXTURES[kind](side, rng), 0.0, 1.0)


def shape(kind: str, size: int, rng: np.random.Generator) -> np.ndarray:
    """The cover of an object, `size` times `size` places: 1 on it, 0 beside it.

    kind : a key of `SHAPES`.
    """
    canvas = Image.new("L", (OVERSAMPLING * size, OVERSAMPLING * size), 0)
    SHAPES[kind](canvas, rng)
    small = canvas.resize((size, size), Image.Resampling.BOX)
    return np.asarray(small, np.float64) / 255.0


def blurred(picture: np.ndarray, sigma_px: float) -> np.ndarray:
    """A picture as a lens shows it: float64, of the same shape."""
    image = Image.fromarray(np.asarray(255.0 * picture, np.float32))
    # Pillow blurs whole numbers only, so light is kept in steps of 1/255
    steps = image.convert("L").filter(ImageFilter.GaussianBlur(FINENESS * sigma_px))
    return np.asarray(steps, np.float64) / 255.0


# -- textures --------------------------------------------------------------------------------------


def _noise(side: int, rng: np.random.Generator) -> np.ndarray:
    """A random field whose power falls as 1/f^2 above a random frequency."""
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side))
    corner = rng.uniform(0.01, 0.04)  # cycles a place
    spectrum = np.fft.rfft2(rng.standard_normal((side, side))) / np.maximum(frequency, corner)
    field = np.fft.irfft2(spectrum, (side, side))
    field -= field.mean()
    return 0.5 + rng.uniform(0.1, 0.25) * field / field.std()


def _patches(side: int, rng: np.random.Generator) -> np.ndarray:
    """Polygons and discs of random luminance, which cover each other."""
    canvas = Image.new("L", (side, side), int(rng.integers(256)))
    draw = ImageDraw.Draw(canvas)
    for _ in range(side * side // 900):
        x, y = rng.uniform(0, side, 2)
        radius = rng.uniform(6, 30)
        light = int(rng.integers(256))
        if rng.random() < 0.4:
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=light)
        else:
            draw.polygon(_corners(x, y, radius, rng), fill=light)
    return np.asarray(canvas, np.float64) / 255.0


def _checks(side: int, rng: np.random.Generator) -> np.ndarray:
    """Squares of random luminance, turned by a random angle."""
    square = rng.uniform(8, 24)
    angle = rng.uniform(0, np.pi / 2)
    y, x = np.mgrid[:side, :side]
    column = np.floor((np.cos(angle) * x + np.sin(angle) * y) / square).astype(int)
    row = np.floor((np.cos(angle) * y - np.sin(angle) * x) / square).astype(int)
    lights = rng.uniform(0, 1, (64, 64))
    return lights[row % 64, column % 64]


def _bricks(side: int, rng: np.random.Generator) -> np.ndarray:
    """A wall: bricks of random luminance with bright joints, every second row moved by a half."""
    height = int(rng.integers(10, 22))
    width = 2 * height
    joint = int(rng.integers(2, 5))
    y, x = np.mgrid[:side, :side]
    row = y // height
    moved = x + (row % 2) * height
    lights = rng.uniform(0, 0.7, (64, 64))
    wall = lights[row % 64, (moved // width) % 64]
    is_joint = (y % height < joint) | (moved % width < joint)
    return np.where(is_joint, 0.9, wall)


TEXTURES: dict[str, Callable[[int, np.random.Generator], np.ndarray]] = {
    "noise": _noise,
    "patches": _patches,
    "checks": _checks,
    "bricks": _bricks,
}
"""Kind of a ground -> function (side, rng) that draws it."""


# -- objects ---------------------------------------------------------------------------------------


def _corners(
    x: float, y: float, radius: float, rng: np.random.Generator
) -> list[tuple[float, float]]:
    """The corners of a random polygon about (x, y)."""
    n = int(rng.integers(3, 8))
    angles = np.sort(rng.uniform(0, 2 * np.pi, n))
    radii = radius * rng.uniform(0.6, 1.0, n)
    return [(x + r * np.cos(a), y + r * np.sin(a)) for a, r in zip(angles, radii, strict=True)]


def _polygon(canvas: Image.Image, rng: np.random.Generator) -> None:
    radius = canvas.width / 2
    ImageDraw.Draw(canvas).polygon(_corners(radius, radius, radius, rng), fill=255)


def _ellipse(canvas: Image.Image, rng: np.random.Generator) -> None:
    width, height = canvas.width * rng.uniform(0.5, 1.0, 2)
    left = (canvas.width - width) / 2
    top = (canvas.width - height) / 2
    ImageDraw.Draw(canvas).ellipse((left, top, left + width, top + height), fill=255)


def _star(canvas: Image.Image, rng: np.random.Generator) -> None:
    radius = canvas.width / 2
    n = int(rng.integers(4, 8))
    inner = rng.uniform(0.4, 0.7)
    angles = rng.uniform(0, np.pi) + np.pi * np.arange(2 * n) / n
    radii = radius * np.where(np.arange(2 * n) % 2, inner, 1.0)
    points = np.stack([radius + radii * np.cos(angles), radius + radii * np.sin(angles)], axis=1)
    ImageDraw.Draw(canvas).polygon([tuple(point) for point in points], fill=255)


def _ring(canvas: Image.Image, rng: np.random.Generator) -> None:
    width = int(canvas.width * rng.uniform(0.12, 0.25))
    box = (0, 0, canvas.width - 1, canvas.width - 1)
    ImageDraw.Draw(canvas).ellipse(box, outline=255, width=width)


def _letter(canvas: Image.Image, rng: np.random.Generator) -> None:
    letter = LETTERS[rng.integers(len(LETTERS))]
    middle = canvas.width / 2
    font = ImageFont.load_default(int(0.95 * canvas.width))
    ImageDraw.Draw(canvas).text((middle, middle), letter, fill=255, font=font, anchor="mm")


SHAPES: dict[str, Callable[[Image.Image, np.random.Generator], None]] = {
    "polygon": _polygon,
    "ellipse": _ellipse,
    "star": _star,
    "ring": _ring,
    "letter": _letter,
}
"""Kind of an object -> function (canvas, rng) that draws it white on a square black canvas."""
