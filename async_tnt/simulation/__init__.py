"""Simulate an event camera in front of a moving image: trajectories, scene, pixels, digits.

Needs no torch.
"""

from async_tnt.simulation.digits import simulate_digit
from async_tnt.simulation.scene import Scene, render
from async_tnt.simulation.simulator import PixelModel, simulate
from async_tnt.simulation.trajectories import ConstantVelocity, Saccade, Saccades, Trajectory, nmnist_saccades

__all__ = [
    "ConstantVelocity",
    "PixelModel",
    "Saccade",
    "Saccades",
    "Scene",
    "Trajectory",
    "nmnist_saccades",
    "render",
    "simulate",
    "simulate_digit",
]
