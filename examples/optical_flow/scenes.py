"""Scenes with known flow: a textured ground and objects, in motion in front of a simulated camera.

Points of the plane are complex numbers here, x + i y in pixels, so that a product turns a point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from async_tnt.simulation import PixelModel, simulate
from async_tnt.simulation.periodic_image import PeriodicImage
from async_tnt.simulation.random_pixels import random_pixels
from examples.optical_flow.drawing import BLURS_PX, FINENESS, blurred, shape, texture

SPEEDS_PX = (20.0, 300.0)
"""Range of the speeds of objects and grounds, in pixels per second, log-uniform."""

MOST_TURN = 1.5
"""Largest rate at which a layer turns, in radians per second."""

MOST_GROWTH = 1.0
"""Largest rate of the logarithm of a layer's size, per second."""

STILL = 0.2
"""Share of the grounds that do not move."""

SIZES_PX = (14.0, 50.0)
"""Range of the sizes of objects, in pixels."""

CONTRASTS = (2.0, 12.0)
"""Range of the ratio of white to black."""

FRAMES_A_PX = 2.0
"""Number of frames for each pixel of the fastest motion: between them light changes linearly."""


@dataclass(frozen=True)
class Motion:
    """A motion in the plane of the sensor, of which the flow is known.

    A layer's point that is at z(0) at the time 0 is at

        z(t) = p(t) + exp((g + i w) t) (z(0) - p(0))       p(t) = p(0) + v (exp(i k t) - 1) / (i k)

    so the flow at the point z at the time t is

        dz/dt = v exp(i k t) + (g + i w) (z - p(t))

    Attributes
    ----------
    place : p(0), the point about which the layer turns and grows.
    velocity : v, the velocity of this point at the time 0, in pixels per second.
    bend : k, in radians per second. The path of the point is a circle, or straight with k = 0.
    turn : w, in radians per second, from x to y.
    growth : g, the rate of the logarithm of the size, per second.
    """

    place: complex
    velocity: complex
    bend: float = 0.0
    turn: float = 0.0
    growth: float = 0.0

    def path(self, time_s: np.ndarray) -> np.ndarray:
        """p(t): complex, of the shape of `time_s`, in pixels."""
        if self.bend == 0.0:
            return self.place + self.velocity * time_s
        angle = 1j * self.bend
        return self.place + self.velocity * (np.exp(angle * time_s) - 1.0) / angle

    def flow(self, z: np.ndarray, time_s: float) -> np.ndarray:
        """The flow at the points z: complex, in pixels per second."""
        velocity = self.velocity * np.exp(1j * self.bend * time_s)
        return velocity + (self.growth + 1j * self.turn) * (z - self.path(np.array(time_s)))


@dataclass(frozen=True)
class Layer:
    """A picture in motion, which covers what is behind it.

    Attributes
    ----------
    light : luminance, times the cover.
    cover : 1 on the object, 0 beside it; None for a ground, which covers everything.
    motion : how it moves.
    """

    light: PeriodicImage
    cover: PeriodicImage | None
    motion: Motion

    def frames(self, image: PeriodicImage, times_s: np.ndarray) -> np.ndarray:
        """One of the layer's images as the sensor sees it at n moments: float64, (n, H, W)."""
        displacement = self.motion.path(times_s) - complex(*image.centre)
        angle = self.motion.turn * times_s
        growth = self.motion.growth * times_s
        return image.frames(
            np.stack([displacement.real, displacement.imag], axis=1),
            np.stack([angle, growth], axis=1),
        )


@dataclass(frozen=True)
class Scene:
    """Layers in front of a simulated camera.

    Attributes
    ----------
    sensor : (width, height), in pixels.
    layers : the ground, then the objects. Each one covers those before it.
    contrast : the ratio of white to black.
    pixels : the sensor's pixels.
    """

    sensor: tuple[int, int]
    layers: tuple[Layer, ...]
    contrast: float
    pixels: PixelModel

    def light(self, times_s: np.ndarray) -> np.ndarray:
        """Log luminance at n moments: float64, (n, H, W)."""
        ground, *objects = self.layers
        light = ground.frames(ground.light, times_s)
        for layer in objects:
            assert layer.cover is not None
            light *= 1.0 - layer.frames(layer.cover, times_s)
            light += layer.frames(layer.light, times_s)
        darkest = 1.0 / self.contrast
        return np.log(darkest + (1.0 - darkest) * np.clip(light, 0.0, 1.0))

    def flow(self, time_s: float) -> np.ndarray:
        """The true flow at a moment: float32, (2, H, W), in pixels per second, x before y.

        A pixel has the flow of the foremost layer that covers at least half of it.
        """
        width, height = self.sensor
        z = np.arange(width) + 1j * np.arange(height)[:, None]
        ground, *objects = self.layers
        flow = ground.motion.flow(z, time_s)
        for layer in objects:
            assert layer.cover is not None
            (cover,) = layer.frames(layer.cover, np.array([time_s]))
            flow = np.where(cover >= 0.5, layer.motion.flow(z, time_s), flow)
        return np.stack([flow.real, flow.imag]).astype(np.float32)

    def events(self, duration_us: int, rng: np.random.Generator) -> np.ndarray:
        """The events of the first `duration_us` microseconds, as `simulate` returns them."""
        fastest_px = max(abs(layer.motion.velocity) for layer in self.layers)
        duration_s = 1e-6 * duration_us
        n_frames = 2 + int(np.ceil(duration_s * max(1_000.0, FRAMES_A_PX * fastest_px)))
        times_us = np.linspace(0.0, duration_us, n_frames)
        return simulate(self.light(1e-6 * times_us), times_us, rng, self.pixels)


@dataclass(frozen=True)
class Kinds:
    """The kinds of pictures and motions of scenes.

    Attributes
    ----------
    textures, shapes : keys of `drawing.TEXTURES` and `drawing.SHAPES`.
    most_bend : largest rate at which the direction of a path turns, in radians per second.
    """

    textures: tuple[str, ...]
    shapes: tuple[str, ...]
    most_bend: float = 0.0


TRAINED = Kinds(("noise", "patches", "checks"), ("polygon", "ellipse", "star"))
"""The scenes of the training."""

UNSEEN = Kinds(("bricks",), ("ring", "letter"), most_bend=15.0)
"""Scenes of kinds that no training shows, on paths that are bent."""


def random_scene(
    sensor: tuple[int, int],
    duration_s: float,
    kinds: Kinds,
    rng: np.random.Generator,
    n_objects: int | None = None,
) -> Scene:
    """Draw a scene.

    Parameters
    ----------
    sensor : (width, height), in pixels.
    duration_s : how long the scene is seen, in seconds.
    kinds : what it may show.
    rng : draws everything.
    n_objects : by default, on average one for each 40 x 40 pixels, none at all included.
    """
    if n_objects is None:
        n_objects = int(rng.poisson(sensor[0] * sensor[1] / 1_600))
    contrast = _log_uniform(CONTRASTS, rng)
    blur_px = rng.uniform(*BLURS_PX)

    side = FINENESS * (max(sensor) + 64)
    picture = blurred(texture(str(rng.choice(kinds.textures)), side, rng), blur_px)
    motion = random_motion(sensor, kinds, rng)
    if rng.random() < STILL:
        motion = Motion(motion.place, 0j)
    layers = [ground_of(picture, motion, sensor)]
    for _ in range(n_objects):
        motion = random_motion(sensor, kinds, rng)
        size_px = _log_uniform(SIZES_PX, rng)
        layers.append(random_object(sensor, duration_s, size_px, motion, kinds, blur_px, rng))
    return Scene(sensor, tuple(layers), contrast, random_pixels(rng))


def random_motion(sensor: tuple[int, int], kinds: Kinds, rng: np.random.Generator) -> Motion:
    """Draw a motion. It begins anywhere on the sensor, in any direction."""
    x, y = rng.uniform(0, sensor)
    velocity = _log_uniform(SPEEDS_PX, rng) * np.exp(2j * np.pi * rng.random())
    return Motion(
        complex(x, y),
        complex(velocity),
        bend=rng.uniform(-kinds.most_bend, kinds.most_bend),
        turn=rng.uniform(-MOST_TURN, MOST_TURN),
        growth=rng.uniform(-MOST_GROWTH, MOST_GROWTH),
    )


def ground_of(picture: np.ndarray, motion: Motion, sensor: tuple[int, int]) -> Layer:
    """A picture as the ground of a scene. It repeats itself."""
    return Layer(_image(picture, motion.place, sensor), None, motion)


def random_object(
    sensor: tuple[int, int],
    duration_s: float,
    size_px: float,
    motion: Motion,
    kinds: Kinds,
    blur_px: float,
    rng: np.random.Generator,
) -> Layer:
    """Draw an object with a texture. `size_px` is its diameter."""
    size = int(FINENESS * size_px)
    cover = shape(str(rng.choice(kinds.shapes)), size, rng)
    light = 0.6 * texture(str(rng.choice(kinds.textures)), size, rng) + 0.4 * rng.random()
    # a margin that the blur of the edges fills
    margin = int(np.ceil(4 * FINENESS * blur_px))
    pictures = [blurred(np.pad(picture, margin), blur_px) for picture in (cover * light, cover)]

    # Images repeat themselves. The next copy of the object must stay off the sensor.
    reach_px = 2.0 * abs(motion.velocity) * duration_s
    largest_px = (size_px + 1.5 * np.hypot(*sensor)) * np.exp(abs(motion.growth) * duration_s)
    period = FINENESS * int(np.ceil(reach_px + largest_px))
    beside = max(0, period - size - 2 * margin)
    light_image, cover_image = (np.pad(picture, (0, beside)) for picture in pictures)
    middle = complex(1, 1) * (margin + (size - 1) / 2) / FINENESS
    return Layer(_image(light_image, middle, sensor), _image(cover_image, middle, sensor), motion)


def _image(picture: np.ndarray, centre: complex, sensor: tuple[int, int]) -> PeriodicImage:
    return PeriodicImage(picture, FINENESS, 0.0, np.array([centre.real, centre.imag]), sensor)


def _log_uniform(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(bounds))))
