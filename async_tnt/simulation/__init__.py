"""Simulate an event camera that looks at a moving image: trajectories, scene, pixels, and MNIST to look at.

Needs numpy and numba alone.
"""

from async_tnt.simulation.digits import simulate_digit
from async_tnt.simulation.mnist import load_mnist, read_idx
from async_tnt.simulation.scene import Scene, render
from async_tnt.simulation.simulator import PixelModel, simulate, simulate_events
from async_tnt.simulation.statistics import describe, side_by_side
from async_tnt.simulation.trajectories import ConstantVelocity, Saccade, Saccades, Trajectory, nmnist_saccades

__all__ = [
    "ConstantVelocity",
    "PixelModel",
    "Saccade",
    "Saccades",
    "Scene",
    "Trajectory",
    "describe",
    "load_mnist",
    "nmnist_saccades",
    "read_idx",
    "render",
    "side_by_side",
    "simulate",
    "simulate_digit",
    "simulate_events",
]
