"""Volumes, landmarks and logits of the batch reference (torch, package `tnt_reference`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import tnt_reference
import torch

from async_tnt.networks.models.model import Model
from async_tnt.networks.models.torch_modules import torch_classifier, torch_regressor
from async_tnt.volume.config import TIME_IMAGES, TNTConfig

Landmark = tuple[float, float]

PIPELINE_SETTINGS = (
    "sensor",
    "grid",
    "bins",
    "t_max",
    "polarity",
    "transform",
    "remove_flow",
    "representation",
)


def reference_volume(
    events: np.ndarray, config: TNTConfig, start_us: int, landmark: Landmark | None = None
) -> np.ndarray:
    """The volume of a window's events: float32, shape (C, H, W).

    Parameters
    ----------
    landmark : (x, y) in grid pixels instead of the configuration's; with landmark "regressor" it is
        needed.
    """
    columns = [events[field] for field in "txyp"]
    settings: dict[str, Any] = {**_window(events, config, start_us), "polarity": config.polarity}
    if config.representation in TIME_IMAGES:
        return tnt_reference.time_image(
            *columns, **settings, representation=config.representation
        ).numpy()
    settings["bins"] = config.bins
    if config.transform == "none":
        return tnt_reference.event_volume(*columns, **settings).numpy()
    settings |= {"t_max": config.t_max, "remove_flow": config.remove_flow}
    settings["landmark"] = config.landmark if landmark is None else landmark
    return tnt_reference.tnt_volume(*columns, **settings).numpy()


def reference_landmark(events: np.ndarray, config: TNTConfig, start_us: int) -> Landmark:
    """The landmark of the newest event, in grid pixels; not for landmark "regressor"."""
    columns = (events[field] for field in "txy")
    x, y = tnt_reference.landmark(config.landmark, *columns, **_window(events, config, start_us))[
        -1
    ].tolist()
    return x, y


def reference_pipeline(model: Model) -> Callable[[np.ndarray, int], np.ndarray]:
    """The whole model in torch: a window's events and its start -> logits."""
    config = model.config
    pipeline = tnt_reference.Pipeline(
        torch_classifier(model),
        window_us=config.window_us if config.window_events is None else None,
        **{name: getattr(config, name) for name in PIPELINE_SETTINGS},
        landmark=config.landmark if config.transform == "tnt" else "center",
        regressor=torch_regressor(model),
    )

    def forward(events: np.ndarray, start_us: int) -> np.ndarray:
        with torch.inference_mode():
            return pipeline(*(events[field] for field in "txyp"), start_us).numpy()

    return forward


def reference_windows(
    events: np.ndarray, config: TNTConfig, start_us: int | None
) -> list[tuple[int, np.ndarray]]:
    """The start and the events of each window that holds events, for a stream from `start_us`, or
    the first event, on.

    An event that comes after its window has closed is late, and belongs to none.
    """
    if not events.size:
        return []
    if config.window_events is not None:
        lots = tnt_reference.windows_of_events(events["t"], config.window_events, config.window_us)
        return [(int(events["t"][lot[0]]), events[lot.numpy()]) for lot in lots]
    first_us = int(events["t"][0]) if start_us is None else start_us
    number = (events["t"] - first_us) // config.window_us
    in_time = (number >= 0) & (number == np.maximum.accumulate(number))
    starts = [(int(k), first_us + int(k) * config.window_us) for k in np.unique(number[in_time])]
    return [(start, events[in_time & (number == k)]) for k, start in starts]


def _window(events: np.ndarray, config: TNTConfig, start_us: int) -> dict[str, Any]:
    by_time = config.window_events is None
    window_us = config.window_us if by_time else tnt_reference.until_newest(events["t"], start_us)
    return {
        "start_us": start_us,
        "window_us": window_us,
        "sensor": config.sensor,
        "grid": config.grid,
    }
