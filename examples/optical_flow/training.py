"""Training on made scenes: windows of any age, with the true flow where events are new."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import nn

from async_tnt import Model, TNTVolume
from async_tnt.base.progress import progress
from examples.optical_flow.network import WINDOW_US, flow_config, flow_network
from examples.optical_flow.scenes import TRAINED, random_scene

SENSOR = (64, 64)
"""Width and height of the scenes of the training, in pixels."""

DURATION_US = 60_000
"""How long a scene is seen, in microseconds."""

MOMENTS_US = range(30_000, DURATION_US + 1, 10_000)
"""Moments of a scene at which its true flow is known, in microseconds."""

STEPS = 9_000
"""Number of steps, by default."""

STEPS_A_SCENE = 2
"""Number of steps for each scene that is made."""

BATCH = 16
"""Number of windows of a step."""

RATE = 3e-3
"""Largest rate of learning."""

UNIT_PX = 100.0
"""What counts as 1 in the training, in pixels per second, so that numbers are about 1."""

YOUNGEST_US = 2_000
"""Least age of a window, in microseconds. The network also learns from windows that have just
begun."""

NEW_US = 5_000
"""A pixel counts in the loss if its newest event is at most this old, in microseconds."""


class KnownScene(NamedTuple):
    """The events of a scene and its flow."""

    events: np.ndarray
    """Events of `DURATION_US`."""
    flows: np.ndarray
    """The true flow at `MOMENTS_US`: float16, (n, 2, H, W), in pixels per second."""


class Example(NamedTuple):
    """A window that is not over yet, and what the network should say of it."""

    volume: np.ndarray
    """The events so far: float32, (BINS, H, W)."""
    flow: np.ndarray
    """The true flow at this moment: float32, (2, H, W), in `UNIT_PX`."""
    is_new: np.ndarray
    """Pixels with new events: bool, (H, W)."""


def known_scene(rng: np.random.Generator) -> KnownScene:
    """Make a scene of the training."""
    scene = random_scene(SENSOR, 1e-6 * DURATION_US, TRAINED, rng)
    events = scene.events(DURATION_US, rng)
    flows = [scene.flow(1e-6 * time_us) for time_us in MOMENTS_US]
    return KnownScene(events, np.array(flows, np.float16))


def draw_example(scene: KnownScene, volume: TNTVolume, rng: np.random.Generator) -> Example:
    """Draw a window, which ends at one of the moments with known flow.

    volume : is overwritten.
    """
    moment = int(rng.integers(len(MOMENTS_US)))
    end_us = MOMENTS_US[moment]
    start_us = end_us - int(rng.integers(YOUNGEST_US, WINDOW_US))
    first, last = np.searchsorted(scene.events["t"], (start_us, end_us))
    events = scene.events[first:last]
    volume.open(start_us)
    volume.update(events)
    new = events[events["t"] >= end_us - NEW_US]
    is_new = np.zeros(scene.flows.shape[2:], bool)
    is_new[new["y"], new["x"]] = True
    flow = scene.flows[moment].astype(np.float32) / UNIT_PX
    return mirrored(Example(np.array(volume.array), flow, is_new), rng)


def mirrored(example: Example, rng: np.random.Generator) -> Example:
    """The same window as in a mirror, with rows and columns exchanged, or with the light inverted.

    Each of these changes is made with probability 1/2.
    """
    volume, flow, is_new = example
    if rng.random() < 0.5:
        volume, flow, is_new = volume[..., ::-1], flow[..., ::-1], is_new[..., ::-1]
        flow = flow * np.array([-1, 1], np.float32)[:, None, None]
    if rng.random() < 0.5:
        # x and y of the flow are exchanged as the axes are
        volume, flow, is_new = volume.swapaxes(1, 2), flow[::-1].swapaxes(1, 2), is_new.T
    if rng.random() < 0.5:
        volume = -volume
    return Example(volume, flow, is_new)


def train_flow(steps: int = STEPS, seed: int = 0) -> Model:
    """Make scenes, and train the network on them.

    Parameters
    ----------
    steps : number of steps; half as many scenes are made.
    seed : of scenes, windows and first weights.
    """
    rng = np.random.default_rng([0, seed])
    scenes = []
    n_scenes = max(1, steps // STEPS_A_SCENE)
    with progress(n_scenes, "scenes") as bar:
        for _ in range(n_scenes):
            scenes.append(known_scene(rng))
            bar.update()
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = flow_network()
    losses = _fit(network, scenes, steps, rng)

    # from now on the network computes pixels per second
    last = network[-2]
    assert isinstance(last, nn.Conv2d) and last.bias is not None
    with torch.no_grad():
        last.weight *= UNIT_PX
        last.bias *= UNIT_PX
    record = {"data": "simulated scenes", "steps": steps, "seed": seed, "error_px": losses}
    return Model.from_torch(network.eval(), flow_config(SENSOR), record=record)


def _fit(
    network: nn.Module, scenes: list[KnownScene], steps: int, rng: np.random.Generator
) -> list[float]:
    """Train a network. Returns the loss of the last steps, in pixels per second."""
    volume = TNTVolume(flow_config(SENSOR))
    optimizer = torch.optim.AdamW(network.parameters(), RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, steps, pct_start=0.1)
    losses = []
    with progress(steps, "training") as bar:
        for _ in range(steps):
            chosen = rng.integers(len(scenes), size=BATCH)
            examples = [draw_example(scenes[k], volume, rng) for k in chosen]
            volumes, flows, is_new = (
                torch.from_numpy(np.stack(arrays)) for arrays in zip(*examples, strict=True)
            )
            loss = endpoint_error(network(volumes), flows, is_new)
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            losses.append(UNIT_PX * loss.item())
            bar.update(title=f"training, error {np.mean(losses[-100:]):.0f} px/s")
    return losses


def endpoint_error(flow: torch.Tensor, true: torch.Tensor, counts: torch.Tensor) -> torch.Tensor:
    """The mean distance between flow and true flow, over the places that count.

    Parameters
    ----------
    flow, true : (N, 2, H, W).
    counts : bool, (N, H, W).
    """
    # the small number keeps the gradient finite where both are equal
    squared = (flow - true).square().sum(1) + 1e-6
    return squared.sqrt()[counts].sum() / counts.sum().clamp(min=1)
