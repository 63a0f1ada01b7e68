"""Augmentation of events: every epoch changes every window at random.

Each window is moved in time and on the sensor, and some of its events are left out. Some windows
are mirrored, cut short, or made to show nothing. These changes are our choice, not the thesis':

    start      the window's start is shifted. The windows of a live stream start at its first event,
               which comes some milliseconds after N-MNIST's saccade has begun. TNT magnifies what
               happens near the start, so the network must not rely on an exact start
    position   (x', y') = A (x - c) + c + shift
               A = rotation * shear * scale * mirror
               c is the middle between the recording's outermost events, so that a mirrored object
               stays where it was
    thinning   each event is kept with a probability that is drawn for each window
    partial    the window ends early, so that the network learns to decide before a window's end
    late start the window begins later, during the recorded motion
    nothing    the window shows no class. It has as many events as before, but at other places:
               anywhere, as noise; at hot pixels; on a patch that twinkles; or along a straight edge
               that crosses the sensor

After a rotation, positions are not whole pixels. Rounding them to whole pixels would leave stripes
in the volume. So augmented events are on a finer sensor. It has the same corners, but up to `FINE`
times as many positions from corner to corner, see `fineness`. The volume's grid is mapped onto the
sensor from corner to corner, so the grid stays the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.kernels.training.window_batches import (
    EDGE,
    HOT_PIXELS,
    ONE_POLARITY,
    PATCH,
    SCATTERED,
    SHOWN,
)
from async_tnt.training.windows import Windows
from async_tnt.volume.config import MAX_SIDE, TIME_IMAGES, TNTConfig

KINDS = {
    "scattered": SCATTERED,
    "of one polarity": ONE_POLARITY,
    "at hot pixels": HOT_PIXELS,
    "on a patch": PATCH,
    "along an edge": EDGE,
}
"""Kinds of windows that show no class: name -> the value of `Draws.content`."""
PATCH_SIDE = (0.1, 0.5)
"""Range of a patch's width and height, as shares of the sensor's."""
EDGE_WAY = (0.2, 1.2)
"""Range of the distance that an edge moves in a window, as a share of the sensor's longer side."""
EDGE_THICKNESS = (0.01, 0.1)
"""Range of an edge's thickness, as a share of the sensor's longer side."""
EDGE_LENGTH = (0.4, 2.0)
"""Range of an edge's length, as a share of the sensor's longer side."""
FINE = 32
"""Number of positions that an augmented event can have in the width of a pixel."""
LATEST = 0.6
"""How far a late start is moved at most, as a share of the window's length."""


@dataclass(frozen=True)
class Draws:
    """How each of N windows is augmented.

    Parameters
    ----------
    start_us : int64, (N,). Added to the window's start.
    until_us : int64, (N,). Events at or after this time since the window's start are dropped.
    matrix : float64, (N, 2, 3). (x', y') = matrix @ (x, y, 1), rounded, in pixels of `sensor`.
    keep : float64, (N,). Probability that an event is kept.
    seed : uint64, (N,). Decides which events are kept, and where events stand in a window that
        shows nothing.
    content : int64, (N,). SHOWN if a window shows its recording. Otherwise the kind of nothing that
        it shows instead, one of the values of `KINDS`.
    place : float64, (N, 8). Where the events of a window that shows nothing stand, in pixels of
        `sensor`, and the share of these events that is ON. `showing_nothing` fills it.
    sensor : (width, height) of the augmented events' sensor. Events beyond it are dropped.
    """

    start_us: np.ndarray
    until_us: np.ndarray
    matrix: np.ndarray
    keep: np.ndarray
    seed: np.ndarray
    content: np.ndarray
    place: np.ndarray
    sensor: tuple[int, int]


def fineness(sensor: tuple[int, int]) -> int:
    """How many times finer than `sensor` the sensor of augmented events is.

    It is `FINE` times finer, or less if a side of `sensor` has over 1024 pixels. A line of pixels
    is as fine as it is.

    Examples
    --------
    >>> fineness((34, 34)), fineness((1280, 720))
    (32, 25)
    """
    if min(sensor) == 1:
        return 1  # a line of pixels has no places between two lines
    finest = (MAX_SIDE - 1) // (max(sensor) - 1)  # a side may have at most `MAX_SIDE` pixels
    return max(1, min(FINE, finest))


def unchanged(n: int, config: TNTConfig) -> Draws:
    """Draws that leave `n` windows unchanged."""
    matrix = np.zeros((n, 2, 3))
    matrix[:, 0, 0] = 1.0
    matrix[:, 1, 1] = 1.0
    return Draws(
        start_us=np.zeros(n, np.int64),
        until_us=np.full(n, config.window_us, np.int64),
        matrix=matrix,
        keep=np.ones(n),
        seed=np.zeros(n, np.uint64),
        content=np.full(n, SHOWN, np.int64),
        place=np.zeros((n, 8)),
        sensor=config.sensor,
    )


def on_pixels(draws: Draws, config: TNTConfig) -> Draws:
    """The draws on the sensor's own pixels, for a volume that is an image of times.

    An image of times would count an event between pixels as an event of each of these pixels. For
    another volume, `draws` are returned as they are.
    """
    if config.representation not in TIME_IMAGES or draws.sensor == config.sensor:
        return draws
    return replace(
        draws,
        matrix=draws.matrix * (config.sensor[0] - 1) / (draws.sensor[0] - 1),
        sensor=config.sensor,
    )


def showing_nothing(draws: Draws, kinds: np.ndarray, rng: np.random.Generator) -> Draws:
    """The draws of the same windows, but some windows now show nothing.

    The last column of `Draws.place` is the share of ON events. The other columns depend on the kind
    of nothing:

    scattered, of one polarity, on a patch   left, top, width and height of the rectangle in which
                                             the events stand
    at hot pixels                            x and y of three pixels
    along an edge                            x and y of a point of the edge, the edge's normal
                                             (cosine, sine), the distance that the edge moves along
                                             its normal in the window, its thickness and its length

    Parameters
    ----------
    draws : the draws of N windows.
    kinds : int64, (N,): SHOWN, or the kind of nothing that a window shows, see `Draws.content`.
    rng : draws where the events stand.
    """
    n = len(kinds)
    sensor = np.array(draws.sensor, np.float64)
    place = np.zeros((n, 8))
    place[:, 2:4] = sensor  # the whole sensor, unless a kind needs less
    on_share = rng.uniform(0.0, 1.0, n)
    # In a window of one polarity, all events are ON, or all are OFF.
    is_one_polarity = kinds == ONE_POLARITY
    on_share[is_one_polarity] = rng.random(is_one_polarity.sum()) < 0.5

    is_patch = kinds == PATCH
    place[is_patch, 2:4] = sensor * rng.uniform(*PATCH_SIDE, (is_patch.sum(), 2))
    place[is_patch, :2] = (sensor - place[is_patch, 2:4]) * rng.random((is_patch.sum(), 2))

    is_hot = kinds == HOT_PIXELS
    place[is_hot, :6] = np.floor(np.tile(sensor, 3) * rng.random((is_hot.sum(), 6)))
    # A window has three hot pixels, of which one, two or three are different. The remaining pixels
    # repeat the first.
    n_different = rng.integers(1, 4, is_hot.sum())
    for k in (1, 2):
        x_and_y = place[is_hot, 2 * k : 2 * k + 2]
        is_different = (n_different > k)[:, None]
        place[is_hot, 2 * k : 2 * k + 2] = np.where(is_different, x_and_y, place[is_hot, :2])

    is_edge = kinds == EDGE
    n_edges = is_edge.sum()
    angle = rng.uniform(0.0, 2 * np.pi, n_edges)
    place[is_edge, :2] = sensor * rng.uniform(0.25, 0.75, (n_edges, 2))
    place[is_edge, 2] = np.cos(angle)
    place[is_edge, 3] = np.sin(angle)
    place[is_edge, 4] = sensor.max() * rng.uniform(*EDGE_WAY, n_edges)
    place[is_edge, 5] = sensor.max() * rng.uniform(*EDGE_THICKNESS, n_edges)
    place[is_edge, 6] = sensor.max() * rng.uniform(*EDGE_LENGTH, n_edges)
    # Half of the edges have events of one polarity: their share of ON events is 0 or 1.
    has_one_polarity = rng.random(n_edges) < 0.5
    on_share[is_edge] = np.where(has_one_polarity, np.rint(on_share[is_edge]), on_share[is_edge])
    place[:, 7] = on_share
    return replace(draws, content=kinds, place=place)


def during_slice(draws: Draws, b: int, n: int) -> Draws:
    """The same draws for slice `b` of `n`, which is filled as a window of its own.

    Other events are left out than in the other slices, and what shows nothing has other events. An
    edge goes on where it was at the end of the slice before.
    """
    # the constant is odd, so no two slices have the same seed
    shift = np.uint64(b * 0xD1B54A32D192ED03 % (1 << 64))
    place = draws.place.copy()
    is_edge = draws.content == EDGE
    # how far the edge is from its middle place when half of the slice has passed
    travelled = place[is_edge, 4] * ((b + 0.5) / n - 0.5)
    place[is_edge, 0] += place[is_edge, 2] * travelled
    place[is_edge, 1] += place[is_edge, 3] * travelled
    place[is_edge, 4] /= n
    return replace(draws, seed=draws.seed + shift, place=place)


@dataclass(frozen=True)
class Augmentation:
    """How large the changes of windows may be, and how frequent.

    All changes are drawn uniformly, except for the ends of partial windows.

    Parameters
    ----------
    start_ms : largest shift of the window's start, earlier or later, in milliseconds.
    shift_px : largest shift in x and in y, in either direction, in sensor pixels.
    translate_px : largest additional shift by a whole number of pixels, in x and in y (the thesis'
        augmentation).
    rotation_deg : largest rotation, in either direction, in degrees.
    scale : largest change of size, as a fraction of the size.
    shear : largest shift of x, as a fraction of y.
    drop : largest fraction of a window's events that is dropped.
    partial : fraction of windows that end early.
    partial_from_ms : earliest end of the windows that end early, in milliseconds. The logarithm of
        their length is drawn uniformly.
    late_start : fraction of windows that begin later, by up to `LATEST` of their length.
    mirror : whether half of the windows are mirrored from left to right.
    nothing : fraction of windows that show nothing. All `KINDS` are equally likely. Such windows
        belong to no class.

    Raises
    ------
    ValueError : a negative value, or a fraction above 1.
    """

    start_ms: float = 5.0
    shift_px: float = 1.5
    translate_px: int = 0
    rotation_deg: float = 10.0
    scale: float = 0.1
    shear: float = 0.1
    drop: float = 0.3
    partial: float = 0.2
    partial_from_ms: float = 15.0
    late_start: float = 0.0
    mirror: bool = False
    nothing: float = 0.0

    def __post_init__(self) -> None:
        fractions = ("scale", "drop", "partial", "late_start", "mirror", "nothing")
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            limit = 1.0 if name in fractions else np.inf
            if not 0 <= value <= limit:
                raise ParameterValueError(name, f"must be in [0, {limit}]", value)

    @classmethod
    def for_sensor(cls, config: TNTConfig, **changes: Any) -> Augmentation:
        """The default augmentation for a sensor and a window.

        The numbers were chosen for N-MNIST's 34x34 pixels and windows of 105 ms. They are scaled to
        other sensors and windows.

        Parameters
        ----------
        config : a configuration with that sensor and window.
        changes : fields of `Augmentation` with other values; these are not scaled.
        """
        # N-MNIST's sensor has 34 pixels along a side: 33 from the first pixel to the last
        scale_px = (min(config.sensor) - 1) / 33
        scale_ms = config.window_us / 105_000
        scaled = cls(
            start_ms=cls.start_ms * scale_ms,
            shift_px=cls.shift_px * scale_px,
            partial_from_ms=cls.partial_from_ms * scale_ms,
        )
        return replace(scaled, **changes)

    def draw(self, windows: Windows, config: TNTConfig, rng: np.random.Generator) -> Draws:
        """Random changes for `windows` of this `config`, drawn by `rng`."""
        n = len(windows)

        def within(limit: float) -> np.ndarray:
            """A number in [-limit, limit) for each window."""
            return rng.uniform(-limit, limit, n)

        start_us = np.rint(within(1e3 * self.start_ms)).astype(np.int64)
        angle = np.deg2rad(within(self.rotation_deg))
        scale = 1.0 + within(self.scale)
        shear = within(self.shear)
        shift = np.stack([within(self.shift_px), within(self.shift_px)], axis=1)  # (n, 2)
        if self.translate_px:
            shift += rng.integers(-self.translate_px, self.translate_px + 1, (n, 2))
        keep = 1.0 - rng.uniform(0.0, self.drop, n)
        shortest_us = np.clip(1e3 * self.partial_from_ms, 1.0, config.window_us)
        log_until = rng.uniform(np.log(shortest_us), np.log(config.window_us), n)
        until_us = np.rint(np.exp(log_until)).astype(np.int64)
        until_us[rng.random(n) >= self.partial] = config.window_us
        if self.late_start:
            later_us = np.rint(rng.uniform(0.0, LATEST * config.window_us, n)).astype(np.int64)
            start_us += np.where(rng.random(n) < self.late_start, later_us, 0)
        if config.slice_us is not None:
            # the newest slice of a stream has just begun, or is nearly complete
            lacking_us = rng.integers(0, config.slice_us, n)
            start_us += lacking_us
            until_us = np.minimum(until_us, config.window_us - lacking_us)
        seed = rng.integers(0, 1 << 63, n, dtype=np.uint64)
        # -1 if a window is mirrored
        x_sign = np.where(rng.random(n) < 0.5, -1.0, 1.0) if self.mirror else np.ones(n)

        # rotation * shear * scale * mirror, about the middle of the recording
        cos = scale * np.cos(angle)
        sin = scale * np.sin(angle)
        matrix = np.empty((n, 2, 3))
        matrix[:, 0, 0] = cos * x_sign
        matrix[:, 0, 1] = cos * shear - sin
        matrix[:, 1, 0] = sin * x_sign
        matrix[:, 1, 1] = sin * shear + cos
        center = windows.recordings.middles[windows.recording]  # (n, 2)
        matrix[:, :, 2] = center + shift - np.einsum("nij,nj->ni", matrix[:, :, :2], center)

        # An image of times would count an event between pixels as an event of each of them.
        fine = 1 if config.representation in TIME_IMAGES else fineness(config.sensor)
        sensor = ((config.sensor[0] - 1) * fine + 1, (config.sensor[1] - 1) * fine + 1)
        draws = Draws(
            start_us=start_us,
            until_us=until_us,
            matrix=fine * matrix,
            keep=keep,
            seed=seed,
            content=np.full(n, SHOWN, np.int64),
            place=np.zeros((n, 8)),
            sensor=sensor,
        )
        if not self.nothing:
            return draws
        kinds = rng.choice(list(KINDS.values()), n)
        kinds = np.where(rng.random(n) < self.nothing, kinds, SHOWN)
        return showing_nothing(draws, kinds, rng)
