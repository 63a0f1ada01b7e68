"""Record pictures with a simulated camera. Camera, scene and motion are drawn at random.

    picture -> its surroundings, contrast, posture -> a random motion -> random pixels -> events

size        The ratio of the object's longer side to the sensor's shorter side is in a stated range.
place       At half time all of the object is on the sensor, at a random place.
posture     The object is a plane that is seen at an angle. So each corner is moved inwards by up to
            .08 of the object's size.
contrast    White is 2 to 15 times as bright as black, log-uniform. Bright and dark are as on the
            picture, or exchanged as on a negative.
ground      The ground is that of the picture, or a random one. In half of the recordings it has a
            texture, 1/f, which moves with the object.
lens        The lens blurs by .3 to .9 pixels.
motion      The length is .06 to .5 of the sensor's shorter side, log-uniform. If the sensor follows
            the object, the length is up to 4 times this side. The object turns by up to 15 degrees,
            and the log of its size changes by up to .15. A quarter of the motions come back. See
            `random_motion`.
pixels      See `random_pixels`.

If a sensor is cut out for its object (`SceneSettings.cut_out`), other rules hold for some of these:

size        log-uniform in the stated range, so that small objects are as frequent as large ones
motion      The length is .1 to .8 of the object's longer side, log-uniform.
place       The object and all of its motion lie in the middle of the sensor. Only the pixels around
            them have events.
ground      It has no texture, which would end where the simulated pixels end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.simulation.measured_pixels import MeasuredPixels
from async_tnt.simulation.outlines import farthest_points, moved_points
from async_tnt.simulation.periodic_image import PeriodicImage
from async_tnt.simulation.pictures import Picture
from async_tnt.simulation.random_motion import random_motion
from async_tnt.simulation.random_pixels import random_pixels

SHORTEST = 0.06
"""Least length of a motion, as a share of the sensor's shorter side."""
LONGEST = 0.5
"""Greatest length of a motion, as a share of the sensor's shorter side."""
LONGEST_FOLLOWED = 4.0
"""Greatest length of a motion that the sensor follows, as a share of the sensor's shorter side."""
CUT_OUT_LENGTHS = (0.1, 0.8)
"""Least and greatest length of a motion on a sensor that is cut out, as a share of the object's
longer side."""
CUT_OUT = 1.4
"""Side of a sensor that is cut out for an object without motion, as a multiple of the object's
longer side."""
MOST_TURN = np.radians(15.0)
"""Largest turn of a motion, in radians."""
MOST_GROWTH = 0.15
"""Largest change of the logarithm of the object's size in a motion."""
BACK = 0.25
"""Share of the motions that come back."""

CONTRASTS = (2.0, 15.0)
"""Range of the ratio of white to black."""
BLURS_PX = (0.3, 0.9)
"""Range of the standard deviation of the lens' blur, in pixels."""
POSTURE = 0.08
"""Largest distance by which a corner is moved inwards, as a share of the object's size."""
TEXTURED = 0.5
"""Share of the recordings whose ground has a texture."""
TEXTURE = 0.15
"""Largest standard deviation of a texture, in luminance."""
FADES = 0.1
"""Width of the rim in which a photograph fades into its ground, as a share of its sides."""
APART = 0.25
"""Least difference between the mean luminance of an object and its random ground."""

FINENESS = 2
"""Number of places of the image along a side of a sensor pixel."""
FRAMES_A_PX = 2.0
"""Number of frames for each pixel of a motion. So frames are closer together in time when the
motion is faster. The light changes linearly from one frame to the next."""
FEWEST_FRAMES = 52
"""Number of frames of a recording without motion."""
MOST_FRAMES = 500
"""Largest number of frames of a recording."""
FINE = 4_000
"""Number of moments at which a motion is computed, before the times of its frames are chosen."""
LIGHTS = "positive", "negative", "both"
"""Values of `SceneSettings.light`. Bright and dark are as on the picture, or exchanged as on its
negative, or one of the two is drawn for each recording."""


@dataclass(frozen=True)
class SceneSettings:
    """Camera and scene with which pictures are recorded.

    Parameters
    ----------
    sensor : (width, height), in pixels.
    window_us : length of a recording, in microseconds.
    size : range of the object's longer side, as a share of the sensor's shorter side.
    light : one of `LIGHTS`.
    follow : whether the sensor is a crop of a larger sensor. The crop follows the object in steps
        of whole pixels.
    camera : measured pixels of the camera; None: the pixels were not measured.
    cut_out : whether the sensor is cut out of a larger one around an object of any size.
    """

    sensor: tuple[int, int]
    window_us: int
    size: tuple[float, float] = (0.4, 0.8)
    light: str = "both"
    follow: bool = False
    camera: MeasuredPixels | None = None
    cut_out: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.size[0] <= self.size[1] <= 1:
            raise ParameterValueError("size", "must be a range within (0, 1]", self.size)
        if self.light not in LIGHTS:
            rule = f"must be one of {', '.join(LIGHTS)}"
            raise ParameterValueError("light", rule, repr(self.light))
        if self.follow and self.cut_out:
            raise ValueError("a sensor may follow its object, or be cut out for it, but not both")


class PictureRecording(NamedTuple):
    """A simulated recording of a picture.

    events : structured array of `EVENT_DTYPE`, times in [0, window_us).
    outline : float32, (MOMENTS, POINTS, 2): points (x, y) on the object's outline at moments from
        the recording's start to its end, see `outlines`.
    """

    events: np.ndarray
    outline: np.ndarray


def record_picture(
    picture: Picture, settings: SceneSettings, rng: np.random.Generator
) -> PictureRecording:
    """Simulate one recording of a picture.

    Parameters
    ----------
    picture : the object.
    settings : camera and scene.
    rng : draws the scene, the motion and the pixels.
    """
    if settings.cut_out:
        return _record_cut_out(picture, settings, rng)
    smaller = min(settings.sensor)
    side_px = smaller * rng.uniform(*settings.size)
    longest = LONGEST_FOLLOWED if settings.follow else LONGEST
    log_share = rng.uniform(*np.log((SHORTEST, longest)))
    shares, motion, turn = _draw_motion(smaller * float(np.exp(log_share)), rng)
    reach = np.ceil(np.abs(motion).max(0)).astype(int)
    scene, points = _scene(picture, side_px, reach, settings, rng)

    # At half time the object is anywhere on the sensor, but completely on it.
    size_px = side_px * np.array(picture.light.shape[::-1]) / max(picture.light.shape)
    free = np.maximum(0, np.array(settings.sensor) / 2 - size_px / 2)
    middle = (np.array(scene.sensor) - 1) / 2
    place = middle + rng.uniform(-free, free)
    displacement = place - scene.centre + motion

    times_us = settings.window_us * shares
    pixels = random_pixels(rng, settings.camera)
    if not settings.follow:
        outline = moved_points(points, scene.centre, shares, displacement, turn)
        return PictureRecording(scene.events(times_us, displacement, turn, pixels, rng), outline)

    # The crop moves over a large sensor. Its path is divided into parts, and for each part only the
    # pixels near the crop are simulated. To simulate the whole sensor takes three times as long.
    parts = []
    path_px = np.hypot(*np.diff(motion, axis=0).T).sum()
    n_parts = max(1, math.ceil(path_px / smaller))
    steps = np.arange(len(times_us) - 1)  # step k leads from frame k to frame k + 1
    for part_steps in np.array_split(steps, n_parts):
        frames = slice(part_steps[0], part_steps[-1] + 2)
        first = np.floor(motion[frames].min(0)).astype(int)
        last = np.ceil(motion[frames].max(0)).astype(int)
        width, height = (np.array(settings.sensor) + last - first).tolist()
        # the pixels that the crop covers in this part; the first of them is at `first`
        part_scene = replace(scene, sensor=(width, height))
        events = part_scene.events(
            times_us[frames], displacement[frames] - first, turn[frames], pixels, rng
        )
        parts.append(_crop(events, times_us, motion, first, settings.sensor))
    # on the crop, which moves in whole pixels
    on_crop = displacement - np.rint(motion)
    outline = moved_points(points, scene.centre, shares, on_crop, turn)
    return PictureRecording(np.concatenate(parts), outline)


def _record_cut_out(
    picture: Picture, settings: SceneSettings, rng: np.random.Generator
) -> PictureRecording:
    """Simulate one recording on the part of the sensor that the object and its motion need.

    A motion for which the sensor is too small leaves it.
    """
    whole = np.array(settings.sensor)
    log_share = rng.uniform(*np.log(settings.size))
    side_px = whole.min() * float(np.exp(log_share))
    length = side_px * float(np.exp(rng.uniform(*np.log(CUT_OUT_LENGTHS))))
    shares, motion, turn = _draw_motion(length, rng)
    low = motion.min(axis=0)
    needed = np.ceil(motion.max(axis=0) - low + CUT_OUT * side_px).astype(int)
    part = np.minimum(needed, whole)
    reach = np.ceil(np.abs(motion).max(0)).astype(int)
    on_part = replace(settings, sensor=(int(part[0]), int(part[1])))
    scene, points = _scene(picture, side_px, reach, on_part, rng)
    place = CUT_OUT * side_px / 2 - low + rng.uniform(-0.5, 0.5, 2)
    displacement = place - scene.centre + motion
    pixels = random_pixels(rng, settings.camera)
    events = scene.events(settings.window_us * shares, displacement, turn, pixels, rng)
    first = (whole - part) // 2
    for axis, name in enumerate("xy"):
        events[name] += first[axis].astype(events[name].dtype)
    outline = moved_points(points, scene.centre, shares, displacement + first, turn)
    return PictureRecording(events, outline)


def _draw_motion(
    length: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw a random motion of this length, in pixels.

    Returns
    -------
    The times of the motion's frames, as shares of the window, (n,). The displacement at these
    times, in pixels, (n, 2). The turn at these times, (n, 2), see `PeriodicImage.frames`.
    """
    shares = np.linspace(0, 1, FINE)
    motion, turn = random_motion(
        length, shares, rng, most_turn=MOST_TURN, most_growth=MOST_GROWTH, back=BACK
    )
    return _frames_of(motion, turn)


def _frames_of(motion: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Choose the times of the frames: more of them where the motion is faster.

    Parameters
    ----------
    motion, turn : (N, 2) each, at N moments that are spread evenly over the window.

    Returns
    -------
    The times of the n frames, as shares of the window, (n,), and motion and turn at these times,
    (n, 2) each.
    """
    shares = np.linspace(0, 1, len(motion))
    steps_px = np.hypot(*np.diff(motion, axis=0).T)
    distance_px = np.concatenate([[0.0], np.cumsum(steps_px)])  # since the start
    # the number of frames that are wanted up to each moment
    n_until = FRAMES_A_PX * distance_px + FEWEST_FRAMES * shares
    n = int(min(np.ceil(n_until[-1]), MOST_FRAMES))
    frame_shares = np.interp(np.linspace(0, n_until[-1], n + 1), n_until, shares)
    return (
        frame_shares,
        _interpolated(frame_shares, shares, motion),
        _interpolated(frame_shares, shares, turn),
    )


def _interpolated(times: np.ndarray, known_times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values, (N, 2), that are known at N `known_times`, interpolated at n `times`: (n, 2)."""
    return np.stack([np.interp(times, known_times, column) for column in values.T], axis=1)


def _crop(
    events: np.ndarray,
    times_us: np.ndarray,
    motion: np.ndarray,
    first: np.ndarray,
    sensor: tuple[int, int],
) -> np.ndarray:
    """The events of a crop that moves along with the object.

    Parameters
    ----------
    events : events of a larger sensor. Changed in place.
    times_us, motion : the displacement of the crop at n times, (n, 2), in pixels.
    first : (x, y), the displacement at which the crop's first pixel is pixel (0, 0) of the larger
        sensor.
    sensor : (width, height) of the crop.
    """
    is_inside = np.ones(len(events), bool)
    for axis, name in enumerate("xy"):
        displacement = np.rint(np.interp(events["t"], times_us, motion[:, axis]))
        in_crop = events[name].astype(np.int64) + first[axis] - displacement.astype(np.int64)
        is_inside &= (in_crop >= 0) & (in_crop < sensor[axis])
        # 0 instead of a value outside, which the field may not hold
        events[name] = np.where(is_inside, in_crop, 0)
    return events[is_inside]


def _scene(
    picture: Picture,
    side_px: float,
    reach: np.ndarray,
    settings: SceneSettings,
    rng: np.random.Generator,
) -> tuple[PeriodicImage, np.ndarray]:
    """The object in its surroundings, as log luminance, seen through a lens, and its outline.

    The outline is (P, 2) points (x, y) of the object before its motion, in sensor pixels.

    Parameters
    ----------
    picture : the object.
    side_px : the object's longer side, in pixels.
    reach : (x, y), the largest displacement of the object, in pixels. The image repeats itself, and
        its other copies of the object must stay off the sensor. So the copies are farther apart if
        the displacement is larger. A crop that follows the object does not need this.
    settings : camera and scene.
    rng : draws the scene.
    """
    sensor = np.array(settings.sensor)
    gap = np.full(2, 0.5 * side_px)
    if not settings.follow:
        gap = np.maximum(gap, 2 * reach)
    # the distance between copies of the object; it is still enough after a turn and growth
    period = sensor + side_px + gap
    period *= np.exp(MOST_GROWTH) / np.cos(MOST_TURN)
    object_light, cover = _posed(picture, FINENESS * side_px, rng)
    # Sides that are multiples of 8 have a fast Fourier transform.
    shape = tuple(8 * math.ceil(FINENESS * side / 8) for side in period[::-1])

    # the ground
    if rng.random() < TEXTURED and not settings.cut_out:
        texture = rng.uniform(0, TEXTURE) * _texture(shape, rng)
    else:
        texture = np.zeros(shape)
    ground = picture.ground
    if ground is None:
        mean_luminance = float(object_light.sum() / max(cover.sum(), 1e-6))
        ground = _random_ground(mean_luminance, rng)
    light = np.clip(ground + texture, 0, 1)

    # the object in the middle of the ground
    rows, columns = cover.shape
    top = (shape[0] - rows) // 2
    left = (shape[1] - columns) // 2
    place = slice(top, top + rows), slice(left, left + columns)
    light[place] = (1 - cover) * light[place] + object_light
    if settings.light == "negative" or (settings.light == "both" and rng.random() < 0.5):
        light = 1.0 - light

    # the lens, and luminance from `darkest` to 1
    light = _blurred(light, FINENESS * rng.uniform(*BLURS_PX))
    contrast = np.exp(rng.uniform(*np.log(CONTRASTS)))
    darkest = 1.0 / contrast
    centre = np.array([left + (columns - 1) / 2, top + (rows - 1) / 2]) / FINENESS
    image = np.log(darkest + (1.0 - darkest) * np.clip(light, 0, 1))
    points = (farthest_points(cover) + np.array([left, top])) / FINENESS
    return PeriodicImage(image, FINENESS, 0.0, centre, settings.sensor), points


def _random_ground(luminance: float, rng: np.random.Generator) -> float:
    """The luminance of a random ground around an object with this mean luminance."""
    ground = rng.uniform(0, 1)
    if abs(ground - luminance) >= APART:
        return ground
    return luminance + APART if luminance < 0.5 else luminance - APART


def _posed(
    picture: Picture, side: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The object as a plane that is seen at an angle, with `side` places along its longer side.

    Returns
    -------
    light : float64, (h, w): the object's luminance times its cover.
    cover : float64, (h, w): the share of each place that the object covers.
    """
    from PIL import Image

    longer = max(picture.light.shape)
    height, width = [max(2, round(side * n / longer)) for n in picture.light.shape]
    size = (width, height)
    corners = np.array([(0, 0), (0, height), (width, height), (width, 0)], float)
    # the corners of a thin object move less, so that they do not cross
    most = np.minimum(POSTURE * side, np.array(size) / 3)
    inwards = np.where(corners > 0, -1, 1)
    posed_corners = corners + most * rng.uniform(0, 1, (4, 2)) * inwards
    coefficients = _perspective(posed_corners, corners)

    # A photograph has no ground of its own, so it fades into the random ground.
    is_photograph = picture.ground is None and picture.cover.min() == 1
    cover = _rim(picture.cover) if is_photograph else picture.cover
    layers = []
    for layer in (picture.light * cover, cover):
        original = Image.fromarray(np.asarray(layer, np.float32))
        sized = original.resize(size, Image.Resampling.BILINEAR)
        posed = sized.transform(
            size, Image.Transform.PERSPECTIVE, coefficients, Image.Resampling.BILINEAR
        )
        layers.append(np.asarray(posed, np.float64))
    return layers[0], layers[1]


def _perspective(points: np.ndarray, images: np.ndarray) -> tuple[float, ...]:
    """The coefficients (a, ..., h) of the perspective that maps four `points` to their `images`.

    (x, y) -> ((a x + b y + c) / (g x + h y + 1), (d x + e y + f) / (g x + h y + 1))
    """
    # two linear equations in the coefficients for each point
    rows = []
    for (x, y), (u, v) in zip(points, images, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
    return tuple(np.linalg.solve(np.array(rows), images.ravel()))


def _rim(cover: np.ndarray) -> np.ndarray:
    """A cover that rises from 0 at the border to 1 within `FADES` of the sides."""
    rises = []
    for n in cover.shape:
        from_border = np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5
        rises.append(np.clip(from_border / max(1.0, FADES * n), 0, 1))
    return rises[0][:, None] * rises[1]


def _texture(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """A random field that repeats itself. Its power is 1/f^2, and its standard deviation is 1."""
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    frequency[0, 0] = np.inf  # the mean becomes 0
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) / frequency, shape)
    return np.asarray(field / field.std())


def _blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """An image that repeats itself, blurred by a Gaussian of `sigma` places."""
    squared = np.fft.fftfreq(image.shape[0])[:, None] ** 2 + np.fft.rfftfreq(image.shape[1]) ** 2
    gain = np.exp(-2 * (np.pi * sigma) ** 2 * squared)  # the Gaussian's Fourier transform
    return np.asarray(np.fft.irfft2(np.fft.rfft2(image) * gain, image.shape))
