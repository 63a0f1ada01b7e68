"""Pictures before a camera that nobody has seen, in motions that nobody recorded -> events.

    picture -> its surroundings, contrast, posture -> a random motion -> random pixels -> events

size        the object's longer side, as a share of the sensor's shorter one, in a stated range
place       at half time all of it is on the sensor, anywhere
posture     a plane that is seen from aside: each corner is moved inwards by up to .08 of the
            object's size
contrast    white to black 2 to 15, log-uniform; as on the picture, or dark against bright as on a
            negative
ground      that of the picture, or a random one; in half of the recordings with a texture, 1/f,
            which moves along
lens        blur of .3 to .9 pixels
motion      lengths of .06 to .5 of the sensor's shorter side, to 4 where it follows the object,
            log-uniform; turns of up to 15 degrees, growth of up to .15; a quarter of them come
            back; see `random_motion`
pixels      see `random_pixels`
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from async_tnt.simulation.measured_pixels import MeasuredPixels
from async_tnt.simulation.periodic_image import PeriodicImage
from async_tnt.simulation.pictures import Picture
from async_tnt.simulation.random_motion import random_motion
from async_tnt.simulation.random_pixels import random_pixels

SHORTEST, LONGEST, LONGEST_FOLLOWED = 0.06, 0.5, 4.0
MOST_TURN, MOST_GROWTH, BACK = np.radians(15.0), 0.15, 0.25
CONTRASTS, BLURS_PX, POSTURE = (2.0, 15.0), (0.3, 0.9), 0.08
TEXTURE, TEXTURED, FADES = 0.15, 0.5, 0.1
"""Largest deviation of a texture, the share of recordings with one, and the rim in which a
photograph fades into it."""
APART = 0.25
"""Between the light of an object that is cut out and its ground, at least."""
FINENESS = 2
"""Places of the image in a sensor pixel."""
FRAMES_A_PX, FEWEST_FRAMES, MOST_FRAMES = 2.0, 52, 500
"""Of a motion, closer together in time where it is faster: the light runs straight from one to the
next."""
FINE = 4_000
"""Moments at which a motion is drawn."""
LIGHTS = "positive", "negative", "both"


@dataclass(frozen=True)
class SceneSettings:
    """What pictures are recorded with.

    Parameters
    ----------
    sensor : (width, height), in pixels. window_us : length of a recording.
    size : range of the object's longer side, as a share of the sensor's shorter one.
    light : of `LIGHTS`.
    follow : the sensor is a crop of a larger one, which follows the object in steps of whole
        pixels.
    camera : what is known of its pixels; None: nothing.
    """

    sensor: tuple[int, int]
    window_us: int
    size: tuple[float, float] = (0.4, 0.8)
    light: str = "both"
    follow: bool = False
    camera: MeasuredPixels | None = None

    def __post_init__(self) -> None:
        if not 0 < self.size[0] <= self.size[1] <= 1:
            raise ValueError(f"`size` must be a range within (0, 1], got {self.size}")
        if self.light not in LIGHTS:
            raise ValueError(f"`light` must be one of {', '.join(LIGHTS)}, got {self.light!r}")


def record_picture(
    picture: Picture, settings: SceneSettings, rng: np.random.Generator
) -> np.ndarray:
    """Events of one recording, as `rng` draws it: a structured array of `EVENT_DTYPE`, times in [0,
    window_us)."""
    smaller = min(settings.sensor)
    side_px = smaller * rng.uniform(*settings.size)
    longest = LONGEST_FOLLOWED if settings.follow else LONGEST
    length = smaller * float(np.exp(rng.uniform(*np.log((SHORTEST, longest)))))
    fine = np.linspace(0, 1, FINE)
    drawn = random_motion(
        length, fine, rng, most_turn=MOST_TURN, most_growth=MOST_GROWTH, back=BACK
    )
    shares, motion, turn = _frames_of(*drawn)
    times_us = settings.window_us * shares
    reach = np.ceil(np.abs(motion).max(0)).astype(int)
    scene = _scene(picture, side_px, reach, settings, rng)
    half = side_px * np.array(picture.light.shape[::-1]) / max(picture.light.shape) / 2
    free = np.maximum(0, np.array(settings.sensor) / 2 - half)
    displacement = (
        (np.array(scene.sensor) - 1) / 2 + rng.uniform(-free, free) - scene.centre + motion
    )
    pixels = random_pixels(rng, settings.camera)
    if not settings.follow:
        return scene.events(times_us, displacement, turn, pixels, rng)
    # of the sensor, what is near the crop for a while: all of its way takes three times as long
    parts = []
    n_parts = math.ceil(np.hypot(*np.diff(motion, axis=0).T).sum() / smaller)
    for frames in np.array_split(np.arange(len(times_us) - 1), max(1, n_parts)):
        some = slice(frames[0], frames[-1] + 2)
        first, last = (
            np.floor(motion[some].min(0)).astype(int),
            np.ceil(motion[some].max(0)).astype(int),
        )
        part = replace(scene, sensor=tuple((np.array(settings.sensor) + last - first).tolist()))
        events = part.events(times_us[some], displacement[some] - first, turn[some], pixels, rng)
        parts.append(_crop(events, times_us, motion, first, settings.sensor))
    return np.concatenate(parts)


def _frames_of(motion: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shares of the window, (n,), at which frames are made, and motion and turn there, (n, 2).

    motion, turn : at `FINE` moments, evenly.
    """
    shares = np.linspace(0, 1, len(motion))
    gone_px = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(motion, axis=0).T))])
    frames = FRAMES_A_PX * gone_px + FEWEST_FRAMES * shares  # so many until then
    n = int(min(np.ceil(frames[-1]), MOST_FRAMES))
    at = np.interp(np.linspace(0, frames[-1], n + 1), frames, shares)
    motion, turn = (
        np.stack([np.interp(at, shares, column) for column in of.T], axis=1)
        for of in (motion, turn)
    )
    return at, motion, turn


def _crop(
    events: np.ndarray,
    times_us: np.ndarray,
    motion: np.ndarray,
    first: np.ndarray,
    sensor: tuple[int, int],
) -> np.ndarray:
    """What a crop of the size of `sensor` sees that moves along. Pixel (0, 0) is the crop's first
    one after a motion by `first`, (x, y)."""
    inside = np.ones(len(events), bool)
    for axis, name in enumerate("xy"):
        moved = np.rint(np.interp(events["t"], times_us, motion[:, axis]))
        at = events[name].astype(np.int64) + first[axis] - moved.astype(np.int64)
        inside &= (at >= 0) & (at < sensor[axis])
        events[name] = np.where(inside, at, 0)
    return events[inside]


def _scene(
    picture: Picture,
    side_px: float,
    reach: np.ndarray,
    settings: SceneSettings,
    rng: np.random.Generator,
) -> PeriodicImage:
    """The object in its surroundings, as log luminance, seen through a lens. It moves `reach`
    pixels (x, y) either way: so far apart are copies on the torus, unless a crop follows the
    object."""
    sensor = np.array(settings.sensor)
    apart = sensor + side_px + np.maximum(0.5 * side_px, 0 if settings.follow else 2 * reach)
    apart *= np.exp(MOST_GROWTH) / np.cos(MOST_TURN)
    covered, cover = _posed(picture, FINENESS * side_px, rng)
    shape = tuple(8 * math.ceil(FINENESS * side / 8) for side in apart[::-1])  # of small factors
    texture = (
        rng.uniform(0, TEXTURE) * _texture(shape, rng)
        if rng.random() < TEXTURED
        else np.zeros(shape)
    )
    if picture.ground is None:
        inside = float(covered.sum() / max(cover.sum(), 1e-6))
        ground = rng.uniform(0, 1)
        if abs(ground - inside) < APART:
            ground = inside + APART if inside < 0.5 else inside - APART
    else:
        ground = picture.ground
    seen = np.clip(ground + texture, 0, 1)
    rows, columns = cover.shape
    top, left = (shape[0] - rows) // 2, (shape[1] - columns) // 2
    place = slice(top, top + rows), slice(left, left + columns)
    seen[place] = (1 - cover) * seen[place] + covered
    if settings.light == "negative" or (settings.light == "both" and rng.random() < 0.5):
        seen = 1.0 - seen
    seen = _blurred(seen, FINENESS * rng.uniform(*BLURS_PX))
    darkest = 1.0 / np.exp(rng.uniform(*np.log(CONTRASTS)))
    centre = np.array([left + (columns - 1) / 2, top + (rows - 1) / 2]) / FINENESS
    image = np.log(darkest + (1.0 - darkest) * np.clip(seen, 0, 1))
    return PeriodicImage(image, FINENESS, 0.0, centre, settings.sensor)


def _posed(
    picture: Picture, side: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Light times cover, and cover, with `side` places along the longer side, of a plane that is
    seen from aside."""
    from PIL import Image

    size = tuple(
        max(2, round(side * n / max(picture.light.shape))) for n in picture.light.shape[::-1]
    )
    corners = np.array([(0, 0), (0, size[1]), (size[0], size[1]), (size[0], 0)], float)
    # of a thin object less: its corners shall not cross
    most = np.minimum(POSTURE * side, np.array(size) / 3)
    seen = corners + most * rng.uniform(0, 1, (4, 2)) * np.where(corners > 0, -1, 1)
    coefficients = _perspective(seen, corners)
    faded = (
        _rim(picture.cover)
        if picture.ground is None and picture.cover.min() == 1
        else picture.cover
    )
    layers = []
    for layer in (picture.light * faded, faded):
        sized = Image.fromarray(np.asarray(layer, np.float32)).resize(
            size, Image.Resampling.BILINEAR
        )
        posed = sized.transform(
            size, Image.Transform.PERSPECTIVE, coefficients, Image.Resampling.BILINEAR
        )
        layers.append(np.asarray(posed, np.float64))
    return layers[0], layers[1]


def _perspective(seen: np.ndarray, corners: np.ndarray) -> tuple[float, ...]:
    """(a, ..., h) of (x, y) -> ((a x + b y + c) / (g x + h y + 1), (d x + e y + f) / (g x + h y +
    1)), which takes the four places `seen` to `corners`."""
    rows = []
    for (x, y), (u, v) in zip(seen, corners, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
    return tuple(np.linalg.solve(np.array(rows), corners.ravel()))


def _rim(cover: np.ndarray) -> np.ndarray:
    """Rises from 0 at the border to 1 within `FADES` of the sides."""
    rises = [
        np.clip((np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5) / max(1.0, FADES * n), 0, 1)
        for n in cover.shape
    ]
    return rises[0][:, None] * rises[1]


def _texture(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """A random field of power 1/f^2 and deviation 1, which repeats itself."""
    radius = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    radius[0, 0] = np.inf
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) / radius, shape)
    return np.asarray(field / field.std())


def _blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """Behind a Gaussian of `sigma` places, on the torus."""
    squared = np.fft.fftfreq(image.shape[0])[:, None] ** 2 + np.fft.rfftfreq(image.shape[1]) ** 2
    return np.asarray(
        np.fft.irfft2(
            np.fft.rfft2(image) * np.exp(-2 * (np.pi * sigma) ** 2 * squared), image.shape
        )
    )
