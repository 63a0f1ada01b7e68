"""Simulate an event camera in front of a moving image: trajectories, scene, pixels, and MNIST's digits.

`moving_mnist.build` makes N-MOVING-MNIST, the thesis' set of moving digits, and `open_set` opens one. Needs no
torch.
"""

from async_tnt.simulation.digits import simulate_digit, write_samples
from async_tnt.simulation.mnist import load_mnist, read_idx
from async_tnt.simulation.motions import Motion, motions_of
from async_tnt.simulation.moving_mnist import open_set
from async_tnt.simulation.saccades import SACCADE_CUTS_US, segment, split_saccades
from async_tnt.simulation.scene import Scene, render
from async_tnt.simulation.set_manifest import MovingMnist
from async_tnt.simulation.shards import Shard, open_shard, write_shard
from async_tnt.simulation.simulator import PixelModel, simulate, simulate_events
from async_tnt.simulation.statistics import describe, side_by_side
from async_tnt.simulation.trajectories import ConstantVelocity, Saccade, Saccades, Trajectory, nmnist_saccades

__all__ = [
    "SACCADE_CUTS_US",
    "ConstantVelocity",
    "Motion",
    "MovingMnist",
    "PixelModel",
    "Saccade",
    "Saccades",
    "Scene",
    "Shard",
    "Trajectory",
    "describe",
    "load_mnist",
    "motions_of",
    "nmnist_saccades",
    "open_set",
    "open_shard",
    "read_idx",
    "render",
    "segment",
    "side_by_side",
    "simulate",
    "simulate_digit",
    "simulate_events",
    "split_saccades",
    "write_samples",
    "write_shard",
]
