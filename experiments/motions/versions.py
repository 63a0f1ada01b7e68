"""Versions of recordings that show other directions of motion, without any simulation.

A network that has seen one direction can be shown others by cheap means. They are the controls of
motion re-synthesis:

    reversed             time runs backwards and polarities are swapped: a brightness that rose
                         falls. The object moves back on its path
    flipped x, y         the sensor is mirrored, from left to right or from top to bottom. The
                         motion is mirrored, and so is the object
    flipped x and y      both, which turns by 180 degrees
    turned               positions are turned about the middle of the sensor, by any angle
"""

from __future__ import annotations

import numpy as np

FLIPPED = ("flipped x", "flipped y", "flipped x and y")
"""Versions that are mirrored."""

VERSIONS = (*FLIPPED, "reversed")
"""Names of the versions that move events by whole pixels."""

Columns = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Columns t, x, y, p of events in order of time; times are from 0 to the end of a window."""


def flipped(columns: Columns, name: str, sensor: tuple[int, int]) -> Columns:
    """The version `name` of `FLIPPED`; the columns as they are for another name."""
    t, x, y, p = columns
    axes = name.split() if name in FLIPPED else []
    if "x" in axes:
        x = sensor[0] - 1 - x
    if "y" in axes:
        y = sensor[1] - 1 - y
    return t, x, y, p


def backwards(columns: Columns, window_us: int) -> Columns:
    """The version "reversed" of a window."""
    t, x, y, p = columns
    return window_us - 1 - t[::-1], x[::-1], y[::-1], 1 - p[::-1]


def turned(columns: Columns, angle: float, sensor: tuple[int, int]) -> Columns:
    """The events turned about the middle of the sensor, and rounded to whole pixels.

    Events that leave the sensor are left out.

    angle : in radians, from the x axis to the y axis.
    """
    t, x, y, p = columns
    middle = (np.array(sensor) - 1) / 2
    x_from_middle = x - middle[0]
    y_from_middle = y - middle[1]
    cosine = np.cos(angle)
    sine = np.sin(angle)
    x = np.rint(middle[0] + cosine * x_from_middle - sine * y_from_middle).astype(np.int64)
    y = np.rint(middle[1] + sine * x_from_middle + cosine * y_from_middle).astype(np.int64)
    stays = (x >= 0) & (x < sensor[0]) & (y >= 0) & (y < sensor[1])
    return t[stays], x[stays], y[stays], p[stays]
