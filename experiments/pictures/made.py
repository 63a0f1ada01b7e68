"""Pictures of six kinds of objects before a background, and recordings of such objects.

The kinds are cup, glass (a cup without its handle), bottle, leaf, star and key. Objects and
backgrounds have textures of power 1/f^2, with light from aside. Each picture shows another object
of its kind. The recordings show further objects, on a sensor of 48x48 pixels. They are made by a
renderer and by pixels (`objects/pairs.py`) that share no code with the simulation in training.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from experiments.objects.pairs import in_order, pixel_events, write_classes

CLASSES = ("bottle", "cup", "glass", "key", "leaf", "star")
"""The kinds of objects."""

SENSOR = (48, 48)
"""Width and height of the sensor, in pixels."""

WINDOW_US = 100_000
"""Length of a recording, in microseconds."""

STEPS = 60
"""Number of steps between the pictures that the pixels see during a recording."""

SIDE = 200
"""Width and height of a picture, in pixels."""

OBJECT = 0.55
"""Radius of an object, as a share of half the picture's side."""

FINE = 3
"""Number of points along each side of a picture's pixel at which it is drawn."""

LENGTH_PX = (2.0, 8.0)
"""Least and largest distance that a recording moves, in pixels of the sensor."""

IN_VIEW = (0.75, 1.0)
"""Least and largest side of a picture on the sensor, as a share of the sensor's side."""

Shape = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]
"""A function that tells which places (x, y) are inside an object. It draws random numbers, so each
call gives another object."""


def _body(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    taper = rng.uniform(0.05, 0.2)
    narrow = rng.uniform(0.5, 0.62)
    return (abs(y) < 0.85) & (abs(x + 0.2) < narrow - taper * (y + 0.85) / 1.7)


def _cup(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    body = _body(x, y, rng)
    ring = np.hypot((x - 0.3) / rng.uniform(0.55, 0.65), (y + 0.05) / rng.uniform(0.4, 0.55))
    return body | ((ring < 1) & (ring > 0.62) & (x > 0))


def _bottle(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    wide = rng.uniform(0.35, 0.45)
    neck = rng.uniform(0.1, 0.16)
    shoulder = rng.uniform(-0.4, -0.2)
    widening = np.clip(1 - (shoulder - y) / 0.2, 0, 1)
    half = np.where(y > shoulder, wide, neck + (wide - neck) * widening)
    return (abs(y) < 0.95) & (abs(x) < half)


def _key(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    from_head = np.hypot(x, y + 0.55)
    rows_of_teeth = ((y > 0.35) & (y < 0.5)) | ((y > 0.65) & (y < 0.85))
    teeth = (x > 0) & (x < rng.uniform(0.3, 0.4)) & rows_of_teeth
    ring = (from_head < 0.4) & (from_head > rng.uniform(0.15, 0.22))
    shaft = (abs(x) < 0.1) & (y > -0.2) & (y < 0.95)
    return ring | shaft | teeth


def _leaf(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    wide = rng.uniform(0.4, 0.55)
    blade = abs(x) < wide * np.clip(1 - ((y + 0.15) / 0.8) ** 2, 0, 1) ** 0.8
    return (blade & (abs(x) > 0.03)) | ((abs(x) < 0.05) & (y > 0) & (y < 0.95))


def _star(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    angle = (np.arctan2(x, -y) + np.pi / 5) % (2 * np.pi / 5) - np.pi / 5
    inner = rng.uniform(0.38, 0.45)
    far = abs(angle) / (np.pi / 5)
    return np.hypot(x, y) < 0.95 * inner / (inner + (1 - inner) * far)


SHAPES: dict[str, Shape] = {
    "bottle": _bottle,
    "cup": _cup,
    "glass": _body,
    "key": _key,
    "leaf": _leaf,
    "star": _star,
}
"""Kind of objects -> its shape."""


def picture(name: str, rng: np.random.Generator) -> np.ndarray:
    """A picture of one object of this kind before a background.

    It is luminance from 0 to 1, shape (SIDE, SIDE).
    """
    n = SIDE * FINE
    row, column = (np.mgrid[:n, :n] - n / 2) / (n / 2)
    angle = np.radians(rng.uniform(-10, 10))
    size = OBJECT * rng.uniform(0.9, 1.1)
    aside, down = rng.uniform(-0.1, 0.1, 2)
    x = (column - aside) / size
    y = (row - down) / size
    turned_x = np.cos(angle) * x + np.sin(angle) * y
    turned_y = np.cos(angle) * y - np.sin(angle) * x
    inside = SHAPES[name](turned_x, turned_y, rng)
    background_light = rng.uniform(0.1, 0.9)
    object_light = rng.uniform(0.1, 0.9)
    if abs(background_light - object_light) < 0.3:
        object_light = background_light + 0.4 if background_light < 0.5 else background_light - 0.4
    slope = rng.uniform(-0.15, 0.15, 2)
    shade = 1 + slope[0] * column + slope[1] * row
    ground = background_light * (1 + rng.uniform(0.1, 0.35) * _texture(n, rng))
    surface = object_light * (1 + rng.uniform(0.05, 0.15) * _texture(n, rng))
    light = shade * np.where(inside, surface, ground)
    return np.clip(light.reshape(SIDE, FINE, SIDE, FINE).mean((1, 3)), 0.02, 1)


def _texture(n: int, rng: np.random.Generator) -> np.ndarray:
    """A random texture of power 1/f^2 and standard deviation 1, shape (n, n)."""
    frequency = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n))
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((n, n))) / frequency
    field = np.fft.irfft2(spectrum, (n, n))
    return np.asarray(field / field.std())


def write_pictures(folder: Path, n: int, seed: int) -> Path:
    """Write `n` colour pictures of each class as `folder/<class>/<number>.jpg`."""
    from PIL import Image

    for label, name in enumerate(CLASSES):
        (folder / name).mkdir(parents=True, exist_ok=True)
        for i in range(n):
            rng = np.random.default_rng((seed, label, i))
            light = picture(name, rng)[..., None] * rng.uniform(0.8, 1, 3)
            srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
            pixels = np.rint(255 * np.clip(srgb, 0, 1)).astype(np.uint8)
            Image.fromarray(pixels).save(folder / name / f"{i:03}.jpg")
    return folder


def write_recordings(folder: Path, n: int, seed: int) -> Path:
    """Write `n` recordings of each class as `folder/<class>/<number>.npz`, and return the folder.

    Each recording shows another object.
    """
    return write_classes(folder, CLASSES, n, seed, lambda name, _, rng: _record(name, rng))


def _record(name: str, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Columns t, x, y, p of a camera that swings before a new picture of a class.

    The camera moves along about half a period of a cosine. If it turns round before the end, it
    moves back a little.
    """
    light = np.log(picture(name, rng))
    width, height = SENSOR
    step = SIDE / (min(SENSOR) * rng.uniform(*IN_VIEW))  # picture pixels in a sensor pixel
    row, column = np.mgrid[:height, :width]
    angle = rng.uniform(0, 2 * np.pi)
    length = rng.uniform(*LENGTH_PX)
    offset = rng.uniform(-3, 3, 2)
    turns_at = rng.uniform(0.7, 1.3)

    def views() -> Iterator[np.ndarray]:
        for share in np.arange(STEPS + 1) / STEPS:
            distance = length * ((1 - np.cos(np.pi * share / turns_at)) / 2 - 0.5)
            x = SIDE / 2 + step * (column - width / 2 - offset[0] - distance * np.cos(angle))
            y = SIDE / 2 + step * (row - height / 2 - offset[1] - distance * np.sin(angle))
            yield _bilinear(light, np.clip(x, 0, SIDE - 1.001), np.clip(y, 0, SIDE - 1.001))

    threshold = rng.uniform(0.15, 0.3) * np.exp(0.1 * rng.standard_normal((height, width)))
    t, x, y, p = pixel_events(views(), threshold, rng.uniform(0.05, 0.5), WINDOW_US, STEPS, rng)
    return in_order(t, x, y, p)


def _bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The values of an image at places (x, y), interpolated bilinearly."""
    left = x.astype(int)
    top = y.astype(int)
    x = x - left
    y = y - top
    upper = (1 - x) * image[top, left] + x * image[top, left + 1]
    lower = (1 - x) * image[top + 1, left] + x * image[top + 1, left + 1]
    return np.asarray((1 - y) * upper + y * lower)
