"""A plane fit, the classical way to flow from events, after Benosman et al. 2014.

The newest event of each pixel is a point (x, y, t). Where an edge passes, these points lie about
a plane t = a x + b y + c. The edge's motion along its own normal, the normal flow, is

    (a, b) / (a^2 + b^2)

Motion along the edge cannot be seen at one edge. `PlaneFit.pooled` takes several edges together:
the flow u for which u . n is the speed of each normal flow in its direction n.

References
----------
- Benosman, Clercq, Lagorce, Ieng, Bartolozzi 2014, Event-Based Visual Flow. From it are the plane
  and its repeated fit without outliers.
- Rueckauer, Delbruck 2016, Evaluation of Event-Based Algorithms for Optical Flow with Ground-Truth
  from Inertial Measurement Sensor. From it is the normal flow as above. Benosman et al. have
  (1/a, 1/b), which is infinite for an edge along an axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

NEVER_US = -(1 << 40)
"""Time of the newest event of a pixel without events."""

ROUNDS = 3
"""Number of fits of a plane. After each one, points that are too far from it are left out."""

FLATTEST = 0.05
"""Least determinant of the points' scatter in x and y, in px^4. Below it they lie on a line."""


@dataclass(frozen=True)
class PlaneSettings:
    """What a plane is fitted to.

    Parameters
    ----------
    radius : the neighbourhood is a square of 2 radius + 1 pixels.
    oldest_us : events older than this are left out.
    burst_us : an edge with much contrast makes several events of a pixel. Events that follow
        another one of the pixel and polarity within this time do not count.
    off_us : points farther from the plane than this are left out of the next fit.
    share : a plane needs this share of the pixels of its neighbourhood.
    fastest_px : a faster normal flow, in pixels per second, counts as not found.
    pool_radius, pool_us : `pooled` takes events of this neighbourhood that are at most this old.
    prior : how strongly `pooled` tends to zero, as a number of normal flows.
    """

    radius: int = 3
    oldest_us: int = 20_000
    burst_us: int = 5_000
    off_us: int = 3_000
    share: float = 0.4
    fastest_px: float = 500.0
    pool_radius: int = 6
    pool_us: int = 10_000
    prior: float = 1.0


PLANE_SETTINGS = PlaneSettings(
    radius=2, oldest_us=20_000, burst_us=20_000, off_us=5_000, share=0.4, fastest_px=500.0
)
"""Settings of the plane fit, as `python -m experiments.flow` chose them on its validation
sequences."""

POOLED_SETTINGS = PlaneSettings(
    radius=1,
    oldest_us=50_000,
    burst_us=40_000,
    off_us=5_000,
    share=0.5,
    fastest_px=500.0,
    pool_radius=16,
    pool_us=40_000,
    prior=10.0,
)
"""Settings of pooled plane fits, chosen in the same way."""


class PlaneFit:
    """Newest events of all pixels, and the flow at an event.

    Parameters
    ----------
    sensor : (width, height), in pixels.
    settings : what planes are fitted to.
    """

    def __init__(self, sensor: tuple[int, int], settings: PlaneSettings) -> None:
        self.settings = settings
        width, height = sensor
        # a rim, so that neighbourhoods at the border are whole
        self._rim = settings.radius + settings.pool_radius
        shape = (2, height + 2 * self._rim, width + 2 * self._rim)
        self._seen_us = np.full(shape, NEVER_US)
        self._times_us = np.full(shape, NEVER_US)  # without bursts

    def update(self, events: np.ndarray) -> None:
        """Add events, in order of time."""
        for t, x, y, p in zip(*(events[name].tolist() for name in "txyp"), strict=True):
            place = p, y + self._rim, x + self._rim
            if t - self._seen_us[place] > self.settings.burst_us:
                self._times_us[place] = t
            self._seen_us[place] = t

    def flow(self, t: int, x: int, y: int, p: int) -> np.ndarray:
        """The normal flow at an event that was added: float64, (2,), nan if no plane is found."""
        side = 2 * self.settings.radius + 1
        first_y = y + self._rim - self.settings.radius
        first_x = x + self._rim - self.settings.radius
        patch = self._times_us[p, first_y : first_y + side, first_x : first_x + side]
        return normal_flows(patch[None], np.array([t]), self.settings)[0]

    def pooled(self, t: int, x: int, y: int) -> np.ndarray:
        """The flow at an event, from the normal flows around it: float64, (2,).

        It is zero where no plane is found.
        """
        pool = self.settings.pool_radius
        side = 2 * self.settings.radius + 1
        first_y = y + self._rim - pool - self.settings.radius
        first_x = x + self._rim - pool - self.settings.radius
        end_y = first_y + 2 * pool + side
        end_x = first_x + 2 * pool + side
        around = self._times_us[:, first_y:end_y, first_x:end_x]
        patches = np.lib.stride_tricks.sliding_window_view(around, (side, side), (1, 2))
        times_us = patches[..., self.settings.radius, self.settings.radius]
        is_new = times_us >= t - self.settings.pool_us
        normal = normal_flows(patches[is_new], times_us[is_new], self.settings)
        normal = normal[np.isfinite(normal[:, 0])]
        speed = np.hypot(*normal.T)
        direction = normal / speed[:, None]  # (n, 2)
        matrix = direction.T @ direction + self.settings.prior * np.eye(2)
        return np.linalg.solve(matrix, direction.T @ speed)


def normal_flows(
    patches_us: np.ndarray, times_us: np.ndarray, settings: PlaneSettings
) -> np.ndarray:
    """The normal flows of n neighbourhoods.

    Parameters
    ----------
    patches_us : int64, (n, 2 radius + 1, 2 radius + 1): times of the newest events.
    times_us : int64, (n,): events older than this by more than `oldest_us` are left out.
    settings : see there.

    Returns
    -------
    float64, (n, 2), in pixels per second; nan where no plane is found.
    """
    radius = settings.radius
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    terms = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)  # (k, 3)
    ms = 1e-3 * (patches_us.reshape(len(patches_us), len(terms)) - times_us[:, None])
    used = ms >= -1e-3 * settings.oldest_us  # (n, k)
    for _ in range(ROUNDS):
        plane = _planes(terms, ms, used)
        off_ms = np.abs(plane @ terms.T - ms)
        last_used = used
        used = used & (off_ms <= 1e-3 * settings.off_us)

    slope = 1e-3 * plane[:, :2]  # seconds a pixel
    with np.errstate(divide="ignore", invalid="ignore"):
        flow = slope / np.square(slope).sum(1)[:, None]
    speed = np.hypot(*flow.T)
    is_found = (
        (last_used.sum(1) >= settings.share * len(terms))
        & (_scatter(terms, last_used) > FLATTEST)
        & (speed <= settings.fastest_px)
    )
    return np.where(is_found[:, None], flow, np.nan)


def _planes(terms: np.ndarray, ms: np.ndarray, used: np.ndarray) -> np.ndarray:
    """The planes (a, b, c) of least squares through the points that are used: float64, (n, 3)."""
    matrix = _products(terms, used)
    # with too few points the matrix is singular; such planes do not count
    matrix += 1e-9 * np.eye(3)
    right = np.where(used, ms, 0.0) @ terms
    return np.linalg.solve(matrix, right[..., None])[..., 0]


def _scatter(terms: np.ndarray, used: np.ndarray) -> np.ndarray:
    """The determinants of the covariances of x and y over the points that are used: (n,)."""
    products = _products(terms, used)
    mean = products / np.maximum(1.0, products[:, 2:, 2:])
    covariance = mean[:, :2, :2] - mean[:, :2, 2:] * mean[:, 2:, :2]
    return np.linalg.det(covariance)


def _products(terms: np.ndarray, used: np.ndarray) -> np.ndarray:
    """The sums of the products of two terms over the points that are used: float64, (n, 3, 3)."""
    pairs = terms[:, :, None] * terms[:, None, :]  # (k, 3, 3)
    return (used.astype(np.float64) @ pairs.reshape(len(terms), 9)).reshape(-1, 3, 3)
