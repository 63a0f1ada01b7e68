"""Simulated recordings of digits, as N-MNIST's camera would have made them."""

from __future__ import annotations

import numpy as np

from async_tnt.simulation.simulator import PixelModel, simulate
from experiments.motions.scene import Scene, render
from experiments.motions.trajectories import Trajectory, nmnist_saccades


def simulate_digit(
    image: np.ndarray,
    rng: np.random.Generator,
    *,
    trajectory: Trajectory | None = None,
    scene: Scene | None = None,
    pixels: PixelModel | None = None,
    sensor: tuple[int, int] = (34, 34),
    frame_us: float = 1_000.0,
) -> np.ndarray:
    """Simulate one recording of an image that moves over the sensor.

    Parameters
    ----------
    image : shape (28, 28) for MNIST, or any other; uint8 in 0-255 or floating in [0, 1]; 0 is the
        background.
    rng : source of all randomness. The same state and arguments give the same events.
    trajectory : the motion; N-MNIST's three saccades, a little delayed at random, by default.
    scene : contrast, blur and polarity; `Scene()` by default, with dark strokes on a bright
        background.
    pixels : thresholds, mismatch, refractory time and noise; `PixelModel()` by default.
    sensor : (width, height) in pixels.
    frame_us : time between rendered frames; the light is interpolated linearly between them.

    Returns
    -------
    Structured array of `EVENT_DTYPE`, sorted by (t, y, x); times from 0 to
    `trajectory.duration_us`.

    Raises
    ------
    ValueError : an argument out of its range.
    """
    trajectory = nmnist_saccades(rng) if trajectory is None else trajectory
    if not 0 < frame_us <= trajectory.duration_us:
        raise ValueError(
            f"`frame_us` must be in (0, {trajectory.duration_us}], the duration, got {frame_us}"
        )
    n_frames = 1 + round(trajectory.duration_us / frame_us)
    times_us = np.linspace(0.0, trajectory.duration_us, n_frames)
    dx, dy = trajectory.position(times_us)
    return simulate(render(image, dx, dy, scene=scene, sensor=sensor), times_us, rng, pixels)
