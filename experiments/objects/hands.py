"""Made recordings of single grey objects that a hand swings in front of a sensor of 128x128 pixels.

The hand swings an object by two or three pixels. Half a swing takes 75 to 100 ms; in some
recordings the hand turns round and comes back. Meanwhile the object turns by a few degrees, and
comes nearer or goes away. A pixel with events has about two of them. A sixth of the events are
after-pulses: another event of the same pixel within a millisecond, mostly of the other sign. This
module shares no code with motion re-synthesis, which is measured on its recordings.

The objects are eight signs, thin or bold, and darker than the background. Edges along the motion
give no events, so each direction of motion shows other parts of a sign. Discs, squares, crosses,
corners and triangles are no test, because a network that `train` trained on one direction
recognised .89 to .98 of them in the other directions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from experiments.objects.pairs import in_order, pixel_events, write_classes

SENSOR = (128, 128)
"""Width and height of the sensor, in pixels."""

DIRECTIONS = tuple(np.pi / 4 * np.arange(8))
"""All directions of motion, in radians."""

WINDOW_US = 100_000
"""Length of a recording, in microseconds."""

STEPS = 50
"""Number of steps between the pictures that the pixels see during a recording."""

SWING_PX = (2.0, 3.0)
"""Least and largest length of a swing, in pixels."""

SWING_MS = (75.0, 100.0)
"""Least and largest duration of half a swing, in milliseconds."""

BACK = 0.3
"""Share of the recordings in which the hand turns round within the window."""

SPREAD = np.radians(4.0)
"""Standard deviation of a swing's direction about the wanted direction, in radians."""

AFTER = 0.2
"""Share of events with an after-pulse."""

AFTER_US = 1_000
"""Longest time from an event to its after-pulse, in microseconds."""

AFTER_OTHER = 0.8
"""Share of after-pulses that have the opposite sign of their event."""

SOFT_PX = 0.7
"""Width of an object's edge, in pixels."""

FAR = 1.6
"""Reach of the tables of distances from an object's middle, in radii of the object."""

STEP = 0.005
"""Distance between two places of the tables, in radii of an object."""

Points = list[tuple[float, float]]
"""Points (x, y) of a line."""

Distance = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""A function that gives the distance from an outline at places (x, y), negative inside."""


@dataclass(frozen=True)
class HandSession:
    """What differs from one day of recording to the next.

    threshold : mean threshold of the pixels, in log luminance.
    mismatch : standard deviation of the logarithm of the pixels' thresholds.
    noise_hz : events of noise a second, of each pixel.
    size : radius of the objects, in pixels.
    place : place (x, y) of the objects from the middle of the sensor, in pixels.
    turn_deg : standard deviation of the angle by which objects turn in a swing.
    nearer : standard deviation of the share by which objects grow in a swing.
    """

    threshold: float = 0.2
    mismatch: float = 0.1
    noise_hz: float = 0.03
    size: float = 17.0
    place: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 1.0
    nearer: float = 0.02


SESSIONS = (
    HandSession(),
    HandSession(threshold=0.25, mismatch=0.18, noise_hz=0.08, size=15.0, place=(9.0, -6.0)),
)
"""Two sessions: the first for training and testing, the second for a test on another day."""


def _arc(x: float, y: float, radius: float, first: float, last: float) -> Points:
    """Points of an arc from angle `first` to angle `last`, in degrees; 0 is right, 90 down."""
    angles = np.radians(np.linspace(first, last, 13))
    return [(x + radius * np.cos(angle), y + radius * np.sin(angle)) for angle in angles]


def _strokes(thick: float, *lines: Points) -> Distance:
    """A function that gives the distance from the outline of lines through points.

    thick : half the width of the lines.
    """

    def distance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        nearest = np.full(x.shape, np.inf)
        for line in lines:
            for (x0, y0), (x1, y1) in pairwise(line):
                # the nearest point of the line is at this share of the way to (x1, y1)
                length_squared = (x1 - x0) ** 2 + (y1 - y0) ** 2
                along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length_squared
                share = np.clip(along, 0, 1)
                away = np.hypot(x - x0 - share * (x1 - x0), y - y0 - share * (y1 - y0))
                nearest = np.minimum(nearest, away)
        return nearest - thick

    return distance


THIN = 0.07
"""Half the width of thin lines, in radii of an object."""

BOLD = 0.2
"""Half the width of bold lines, in radii of an object."""

SIX = [[*_arc(0.25, 0.0, 0.75, 235, 180), *_arc(0.0, 0.4, 0.5, 180, -180)]]
"""The lines of a 6. Turned by half a circle, they are the lines of a 9."""

SHAPES: Mapping[str, Distance] = {
    "2": _strokes(THIN, [*_arc(0.0, -0.4, 0.5, 190, 370), (-0.5, 0.9), (0.5, 0.9)]),
    "5": _strokes(
        THIN, [(0.45, -0.9), (-0.4, -0.9), (-0.45, -0.15), *_arc(0.0, 0.35, 0.55, 225, 510)]
    ),
    "6": _strokes(THIN, *SIX),
    "9": _strokes(THIN, *([(-x, -y) for x, y in line] for line in SIX)),
    "3": _strokes(BOLD, [*_arc(0.0, -0.4, 0.4, 200, 450), *_arc(0.0, 0.4, 0.4, 270, 520)]),
    "8": _strokes(BOLD, _arc(0.0, -0.4, 0.4, 90, 450), _arc(0.0, 0.4, 0.4, 270, 630)),
    "S": _strokes(BOLD, [*_arc(0.0, -0.4, 0.4, -20, -270), *_arc(0.0, 0.4, 0.4, -90, 160)]),
    "Z": _strokes(BOLD, [(-0.5, -0.8), (0.5, -0.8), (-0.5, 0.8), (0.5, 0.8)]),
}
"""Name of a sign -> function that gives the approximate distance from its outline, if the sign has
a radius of 1."""


@cache
def _table(name: str) -> np.ndarray:
    """A table [y, x] of the distances from a sign's outline, at places `STEP` apart within `FAR`.

    To compute the distances for each picture would take a second.
    """
    places = np.arange(-FAR, FAR, STEP)
    return SHAPES[name](*np.meshgrid(places, places)).astype(np.float32)


def _distance(name: str, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The distance from a sign's outline at places (x, y), looked up in its table."""
    table = _table(name)

    def indices(coordinates: np.ndarray) -> np.ndarray:
        return np.clip(((coordinates + FAR) / STEP).astype(np.int64), 0, len(table) - 1)

    distance: np.ndarray = table[indices(y), indices(x)]
    return distance


def record(
    name: str, direction: float, rng: np.random.Generator, session: HandSession
) -> dict[str, np.ndarray]:
    """Columns t, x, y, p of one recording of a sign that a hand swings.

    name : name of the sign.
    direction : direction of the swing, in radians.
    """
    width, height = SENSOR
    angle = direction + SPREAD * rng.standard_normal()
    length = rng.uniform(*SWING_PX)
    duration_share = rng.uniform(*SWING_MS) * 1e3 / WINDOW_US
    start_share = rng.uniform(0, 1 - duration_share)
    turns_at = rng.uniform(0.4, 0.9)
    is_back = rng.random() < BACK
    origin = np.array([width, height]) / 2 + session.place + rng.uniform(-4, 4, 2)
    size = session.size * rng.uniform(0.85, 1.15)
    posture = np.radians(rng.uniform(-4, 4))
    grey = -rng.uniform(0.4, 1.1)
    turn = np.radians(session.turn_deg) * rng.standard_normal()
    nearer = session.nearer * rng.standard_normal()
    slope = rng.uniform(-0.001, 0.001, 2)
    threshold = session.threshold * np.exp(session.mismatch * rng.standard_normal((height, width)))
    row, column = np.mgrid[:height, :width].astype(float)
    background = slope[0] * column + slope[1] * row
    window = (
        slice(max(0, int(origin[1] - FAR * size)), int(origin[1] + FAR * size)),
        slice(max(0, int(origin[0] - FAR * size)), int(origin[0] + FAR * size)),
    )

    def pictures() -> Iterator[np.ndarray]:
        for share in np.arange(STEPS + 1) / STEPS:
            u = np.clip((share - start_share) / duration_share, 0, 1)
            # The object moves out. If the hand turns round, the object also moves back.
            phase = u / turns_at if is_back else u
            travelled = (1 - np.cos(np.pi * phase)) / 2
            distance = length * travelled
            x = column[window] - origin[0] - distance * np.cos(angle)
            y = row[window] - origin[1] - distance * np.sin(angle)
            cos = np.cos(posture + turn * travelled)
            sin = np.sin(posture + turn * travelled)
            scale = size * (1 + nearer * travelled)
            own_x = (cos * x + sin * y) / scale
            own_y = (cos * y - sin * x) / scale
            outline = scale * _distance(name, own_x, own_y)
            light = background.copy()
            light[window] += grey / (1 + np.exp(np.clip(outline / SOFT_PX, -30, 30)))
            yield light

    t, x, y, p = pixel_events(pictures(), threshold, session.noise_hz, WINDOW_US, STEPS, rng)
    t, x, y, p = with_after_pulses(t, x, y, p, rng)
    is_in_window = t < WINDOW_US
    return in_order(t[is_in_window], x[is_in_window], y[is_in_window], p[is_in_window])


def with_after_pulses(
    t: np.ndarray, x: np.ndarray, y: np.ndarray, p: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, ...]:
    """Columns of events, and behind them the columns of their after-pulses."""
    has_pulse = rng.random(len(t)) < AFTER
    pulse_times = t[has_pulse] + rng.uniform(20, AFTER_US, has_pulse.sum())
    pulse_signs = np.where(rng.random(has_pulse.sum()) < AFTER_OTHER, ~p[has_pulse], p[has_pulse])
    return (
        np.concatenate([t, pulse_times]),
        np.concatenate([x, x[has_pulse]]),
        np.concatenate([y, y[has_pulse]]),
        np.concatenate([p, pulse_signs]),
    )


def write(
    folder: Path, n: int, directions: tuple[float, ...], seed: int, session: HandSession
) -> Path:
    """Write `n` recordings of each class as `folder/<class>/<number>.npz`.

    The recordings of a class take the `directions` in turn.
    """

    def recorded(name: str, i: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
        return record(name, directions[i % len(directions)], rng, session)

    return write_classes(folder, SHAPES, n, seed, recorded)
