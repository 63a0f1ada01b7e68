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
"""Fields of a configuration that `tnt_reference.Pipeline` has under the same names."""


def reference_volume(
    events: np.ndarray, config: TNTConfig, start_us: int, landmark: Landmark | None = None
) -> np.ndarray:
    """The volume of a window's events: float32, shape (C, H, W).

    Parameters
    ----------
    landmark : (x, y) in grid pixels, used instead of the configuration's landmark. It is needed if
        the configuration's landmark is "regressor".
    """
    columns = [events[field] for field in "txyp"]
    settings = _window_arguments(events, config, start_us)
    settings["polarity"] = config.polarity
    if config.representation in TIME_IMAGES:
        settings["representation"] = config.representation
        return tnt_reference.time_image(*columns, **settings).numpy()
    settings["bins"] = config.bins
    if config.transform == "none":
        return tnt_reference.event_volume(*columns, **settings).numpy()
    settings["t_max"] = config.t_max
    settings["remove_flow"] = config.remove_flow
    settings["landmark"] = config.landmark if landmark is None else landmark
    return tnt_reference.tnt_volume(*columns, **settings).numpy()


def reference_landmark(events: np.ndarray, config: TNTConfig, start_us: int) -> Landmark:
    """The landmark of the newest event, in grid pixels, for all landmarks but "regressor"."""
    arguments = _window_arguments(events, config, start_us)
    landmarks = tnt_reference.landmark(
        config.landmark, events["t"], events["x"], events["y"], **arguments
    )
    x, y = landmarks[-1].tolist()
    return x, y


def reference_pipeline(model: Model) -> Callable[[np.ndarray, int], list[np.ndarray]]:
    """The whole model in torch: a function from a window's events and its start to its outputs.

    The only output of a model with classes are the logits.
    """
    config = model.config
    settings = {name: getattr(config, name) for name in PIPELINE_SETTINGS}
    pipeline = tnt_reference.Pipeline(
        torch_classifier(model),
        window_us=config.window_us if config.window_events is None else None,
        landmark=config.landmark if config.transform == "tnt" else "center",
        regressor=torch_regressor(model),
        **settings,
    )

    def outputs_of(events: np.ndarray, start_us: int) -> list[np.ndarray]:
        with torch.inference_mode():
            answer = pipeline(*(events[field] for field in "txyp"), start_us)
        tensors = answer if isinstance(answer, tuple) else (answer,)
        return [tensor.numpy() for tensor in tensors]

    return outputs_of


def reference_windows(
    events: np.ndarray, config: TNTConfig, start_us: int | None
) -> list[tuple[int, np.ndarray]]:
    """The start and the events of each window that holds events.

    The first window begins at `start_us`, or else at the first event. An event that comes after its
    window has closed is late, and belongs to no window.
    """
    if not events.size:
        return []
    t = events["t"]
    if config.window_events is not None:
        indices_of_windows = tnt_reference.windows_of_events(
            t, config.window_events, config.window_us
        )
        return [(int(t[indices[0]]), events[indices.numpy()]) for indices in indices_of_windows]

    first_us = int(t[0]) if start_us is None else start_us
    window_number = (t - first_us) // config.window_us
    # a late event has a lower number than an event before it
    is_in_time = (window_number >= 0) & (window_number == np.maximum.accumulate(window_number))
    windows = []
    for k in np.unique(window_number[is_in_time]).tolist():
        window_events = events[is_in_time & (window_number == k)]
        windows.append((first_us + k * config.window_us, window_events))
    return windows


def _window_arguments(events: np.ndarray, config: TNTConfig, start_us: int) -> dict[str, Any]:
    """The arguments of the reference that describe a window."""
    window_us = config.window_us
    if config.window_events is not None:
        window_us = tnt_reference.until_newest(events["t"], start_us)
    return {
        "start_us": start_us,
        "window_us": window_us,
        "sensor": config.sensor,
        "grid": config.grid,
    }
