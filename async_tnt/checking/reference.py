"""What the batch reference (torch, package `tnt_reference`) makes of a window's events and of a model's networks.

Torch is imported only when something is asked.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.networks.model import Model
from async_tnt.networks.torch_modules import torch_classifier, torch_regressor

Landmark = tuple[float, float]


def reference_volume(
    events: np.ndarray, config: TNTConfig, start_us: int, landmark: Landmark | None = None
) -> np.ndarray:
    """The volume of a window's events: float32, shape (C, H, W).

    Parameters
    ----------
    landmark : (x, y) in grid pixels instead of the configuration's; with landmark "regressor" it is needed.
    """
    import tnt_reference

    columns = [events[field] for field in ("t", "x", "y", "p")]
    where = _where(config, start_us) | {"bins": config.bins, "polarity": config.polarity}
    if config.transform == "none":
        return tnt_reference.event_volume(*columns, **where).numpy()
    where |= _transform(config, landmark)
    return tnt_reference.tnt_volume(*columns, **where).numpy()


def reference_kept(
    events: np.ndarray, config: TNTConfig, start_us: int, landmark: Landmark | None = None
) -> np.ndarray:
    """Which events the transform keeps: bool, shape (N,). `landmark` as for `reference_volume`."""
    import tnt_reference

    columns = [events[field] for field in ("t", "x", "y")]
    where = _where(config, start_us) | _transform(config, landmark)
    return tnt_reference.tnt_coordinates(*columns, **where).kept.numpy()


def reference_landmark(events: np.ndarray, config: TNTConfig, start_us: int) -> Landmark:
    """The landmark of the newest event, in grid pixels; not for landmark "regressor"."""
    import tnt_reference

    columns = [events[field] for field in ("t", "x", "y")]
    x, y = tnt_reference.landmark(config.landmark, *columns, **_where(config, start_us))[-1].tolist()
    return x, y


def reference_pipeline(model: Model) -> Callable[[np.ndarray, int], np.ndarray]:
    """The whole model in torch: a window's events and its start -> logits."""
    import tnt_reference
    import torch

    config = model.config
    pipeline = tnt_reference.Pipeline(
        torch_classifier(model),
        sensor=config.sensor,
        window_us=config.window_us,
        grid=config.grid,
        bins=config.bins,
        t_max=config.t_max,
        polarity=config.polarity,
        transform=config.transform,
        remove_flow=config.remove_flow,
        landmark=config.landmark if config.transform == "tnt" else "center",
        regressor=torch_regressor(model),
    )

    def forward(events: np.ndarray, start_us: int) -> np.ndarray:
        with torch.inference_mode():
            return pipeline(*(events[field] for field in ("t", "x", "y", "p")), start_us).numpy()

    return forward


def _where(config: TNTConfig, start_us: int) -> dict[str, Any]:
    return {
        "start_us": start_us,
        "window_us": config.window_us,
        "sensor": config.sensor,
        "grid": config.grid,
    }


def _transform(config: TNTConfig, landmark: Landmark | None) -> dict[str, Any]:
    return {
        "t_max": config.t_max,
        "landmark": config.landmark if landmark is None else landmark,
        "remove_flow": config.remove_flow,
    }
