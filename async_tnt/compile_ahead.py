"""Compile every kernel before a stream opens."""

from __future__ import annotations

import sys
import threading
import time

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.events import EVENT_DTYPE
from async_tnt.networks.model import HEATMAP, REGRESSOR_LAYERS, Model
from async_tnt.processor import Processor

PATIENCE_S, PATIENCE_OF_LOGS_S = 1.0, 5.0  # silent until then, on a terminal and elsewhere


def warmup(model: Model | TNTConfig | None = None) -> float:
    """Compile everything that a stream may call, or load it from Numba's cache.

    The first time on a machine this takes some seconds, later a fraction of one. After it, no event waits for
    the compiler. A line on stderr explains a long wait.

    Parameters
    ----------
    model : also run this model's network (or make a volume of this configuration) once.

    Returns
    -------
    float : seconds it took.
    """
    started = time.perf_counter()
    notice = threading.Timer(PATIENCE_S if sys.stderr.isatty() else PATIENCE_OF_LOGS_S, _say)
    notice.daemon = True
    notice.start()
    try:
        events = np.zeros(2, EVENT_DTYPE)
        events["t"] = [0, 3]
        # with `window` and `regressor` a decision per event is not made in compiled code, but as for other classifiers
        for landmark in ("running", "window", "regressor"):
            config = TNTConfig(sensor=(8, 8), grid=(8, 8), window_us=10, landmark=landmark)
            made = Model(config, _made_weights(config), ("a",))
            Processor(made, every_events=1).push(events)
            Processor(made, classifier=lambda volume: [0.0], every_events=1).push(events)
            for late in ("accept", "drop"):
                processor = Processor(made, late=late)
                processor.push(events)
                processor.push(tuple(events[name].copy() for name in ("t", "x", "y", "p")))
                processor.push_one(4, 1, 1, 1)
                processor.fire()
        if isinstance(model, Model):
            Processor(model).fire()
        elif isinstance(model, TNTConfig):
            regressor = (lambda volume: (0.0, 0.0)) if model.needs_regressor else None
            Processor(model, classifier=lambda volume: [0.0], regressor=regressor).fire()
    finally:
        notice.cancel()
    return time.perf_counter() - started


def _say() -> None:
    print("async_tnt: compiling kernels, once on this machine (15 to 30 s) ...", file=sys.stderr, flush=True)


def _made_weights(config: TNTConfig) -> dict[str, np.ndarray]:
    channels, height, width = config.shape
    shapes = {
        "conv1": (1, channels, 3, 3),
        "conv2": (1, 1, 3, 3),
        "fc1": (1, (height // 4) * (width // 4)),
        "fc2": (1, 1),
    }
    if config.needs_regressor:
        shapes |= dict.fromkeys(REGRESSOR_LAYERS, (1, 1, 3, 3)) | {"regressor.conv1": (1, channels, 3, 3)}
    weights = {f"{layer}.weight": np.zeros(shape, np.float32) for layer, shape in shapes.items()}
    biases = {f"{layer}.bias": np.zeros(shape[0], np.float32) for layer, shape in shapes.items()}
    return weights | biases | ({HEATMAP: np.zeros((1, 1, 1, 1), np.float32)} if config.needs_regressor else {})
