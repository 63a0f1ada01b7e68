"""The outline of an object of a picture, as points that move with the object."""

from __future__ import annotations

import numpy as np

POINTS = 16
"""Number of points of an outline: the object's farthest points in as many directions."""

MOMENTS = 16
"""Number of moments of a recording, evenly spread, at which the points are known."""


def farthest_points(cover: np.ndarray) -> np.ndarray:
    """The farthest points of an object in `POINTS` directions.

    Boxes around these points are boxes around the object, also when it is turned by multiples of
    the angle between two directions, and nearly so between them.

    Parameters
    ----------
    cover : float, (h, w): the share of each place that the object covers. A place that is covered
        by half belongs to the object. If none is, all places do.

    Returns
    -------
    float64, (POINTS, 2): (x, y) in places.
    """
    is_object = cover >= 0.5
    if not is_object.any():
        is_object = np.ones_like(is_object)
    rows, columns = np.nonzero(is_object)
    places = np.stack([columns, rows], axis=1).astype(np.float64)
    angles = 2 * np.pi * np.arange(POINTS) / POINTS
    directions = np.stack([np.cos(angles), np.sin(angles)])
    farthest: np.ndarray = places[(places @ directions).argmax(axis=0)]
    return farthest


def moved_points(
    points: np.ndarray,
    centre: np.ndarray,
    shares: np.ndarray,
    displacement: np.ndarray,
    turn: np.ndarray,
) -> np.ndarray:
    """The points of an outline at `MOMENTS` moments of a motion.

    Parameters
    ----------
    points : float64, (P, 2), before the motion, in sensor pixels.
    centre : (x, y), the point about which the object turns, in sensor pixels.
    shares : float64, (n,), moments as shares of the recording, increasing from 0 to 1.
    displacement, turn : float64, (n, 2) each: the motion at these moments, see
        `PeriodicImage.frames`.

    Returns
    -------
    float32, (MOMENTS, P, 2): (x, y) in sensor pixels.
    """
    moments = np.linspace(0, 1, MOMENTS)
    x, y, angle, growth = [
        np.interp(moments, shares, column) for column in (*displacement.T, *turn.T)
    ]
    scale = np.exp(growth)
    cos = scale * np.cos(angle)
    sin = scale * np.sin(angle)
    turned = np.stack([cos, -sin, sin, cos], axis=1).reshape(-1, 2, 2)
    middles = centre + np.stack([x, y], axis=1)
    moved = np.einsum("kij,pj->kpi", turned, points - centre) + middles[:, None]
    return np.asarray(moved, np.float32)
