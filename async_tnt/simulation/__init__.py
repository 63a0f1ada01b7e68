"""Simulate an event camera in front of a moving image: trajectories, scene, pixels, and MNIST's digits.

Needs no torch.
"""

from async_tnt.simulation.digits import simulate_digit
from async_tnt.simulation.mnist import load_mnist, read_idx
from async_tnt.simulation.scene import Scene, render
from async_tnt.simulation.shards import Shard, open_shard, write_shard
from async_tnt.simulation.simulator import PixelModel, simulate
from async_tnt.simulation.trajectories import ConstantVelocity, Saccade, Saccades, Trajectory, nmnist_saccades

__all__ = [
    "ConstantVelocity",
    "PixelModel",
    "Saccade",
    "Saccades",
    "Scene",
    "Shard",
    "Trajectory",
    "load_mnist",
    "nmnist_saccades",
    "open_shard",
    "read_idx",
    "render",
    "simulate",
    "simulate_digit",
    "write_shard",
]
