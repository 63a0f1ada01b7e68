"""Volumes, landmarks and logits of the batch reference (torch, package `tnt_reference`), imported when needed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.networks.model import Model
from async_tnt.networks.torch_modules import torch_classifier, torch_regressor

Landmark = tuple[float, float]

PIPELINE_SETTINGS = ("sensor", "window_us", "grid", "bins", "t_max", "polarity", "transform", "remove_flow")


def reference_volume(
    events: np.ndarray, config: TNTConfig, start_us: int, landmark: Landmark | None = None
) -> np.ndarray:
    """The volume of a window's events: float32, shape (C, H, W).

    Parameters
    ----------
    landmark : (x, y) in grid pixels instead of the configuration's; with landmark "regressor" it is needed.
    """
    import tnt_reference

    columns = [events[field] for field in "txyp"]
    settings: dict[str, Any] = {**_window(config, start_us), "bins": config.bins, "polarity": config.polarity}
    if config.transform == "none":
        return tnt_reference.event_volume(*columns, **settings).numpy()
    return tnt_reference.tnt_volume(*columns, **(settings | _transform(config, landmark))).numpy()


def reference_kept(
    events: np.ndarray, config: TNTConfig, start_us: int, landmark: Landmark | None = None
) -> np.ndarray:
    """Which events the transform keeps: bool, shape (N,). `landmark` as for `reference_volume`."""
    import tnt_reference

    settings = _window(config, start_us) | _transform(config, landmark)
    return tnt_reference.tnt_coordinates(*(events[field] for field in "txy"), **settings).kept.numpy()


def reference_landmark(events: np.ndarray, config: TNTConfig, start_us: int) -> Landmark:
    """The landmark of the newest event, in grid pixels; not for landmark "regressor"."""
    import tnt_reference

    columns = (events[field] for field in "txy")
    x, y = tnt_reference.landmark(config.landmark, *columns, **_window(config, start_us))[-1].tolist()
    return x, y


def reference_pipeline(model: Model) -> Callable[[np.ndarray, int], np.ndarray]:
    """The whole model in torch: a window's events and its start -> logits."""
    import tnt_reference
    import torch

    config = model.config
    pipeline = tnt_reference.Pipeline(
        torch_classifier(model),
        **{name: getattr(config, name) for name in PIPELINE_SETTINGS},
        landmark=config.landmark if config.transform == "tnt" else "center",
        regressor=torch_regressor(model),
    )

    def forward(events: np.ndarray, start_us: int) -> np.ndarray:
        with torch.inference_mode():
            return pipeline(*(events[field] for field in "txyp"), start_us).numpy()

    return forward


def _window(config: TNTConfig, start_us: int) -> dict[str, Any]:
    return {"start_us": start_us, "window_us": config.window_us, "sensor": config.sensor, "grid": config.grid}


def _transform(config: TNTConfig, landmark: Landmark | None) -> dict[str, Any]:
    landmark_of = config.landmark if landmark is None else landmark
    return {"t_max": config.t_max, "landmark": landmark_of, "remove_flow": config.remove_flow}
