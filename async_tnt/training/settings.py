"""How to train: settings, and their defaults for a data set."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from async_tnt.config import TNTConfig
from async_tnt.training.augment import Augmentation

PRECISIONS = ("float32", "bfloat16")
STREAMED = MappingProxyType({"partial": 0.9, "nothing": 0.1})
"""Of `Augmentation` for a data set by default: most windows end early, and some show only noise."""
EARLIEST = 0.05
"""The earliest end of such a window, as a share of the complete one."""
MIN_STEPS, MIN_STEPS_MOVED = 1_500, 6_000
"""Optimizer steps on a small data set by default, unless patience ends the training earlier; more with other motions,
which take longer to learn."""


@dataclass(frozen=True)
class TrainSettings:
    """How to train. Where the thesis is silent (everywhere but the loss), the choices are ours.

    Parameters
    ----------
    epochs : passes over the training windows.
    iterations : steps of the optimizer, instead of `epochs`; the last epoch may be cut short. The thesis has
        60,000, with a batch of 64.
    batch : windows per step.
    learning_rate : the highest; it rises over the first 5 % of the steps and falls along a cosine to 0.
    weight_decay : of AdamW, on weights, not on biases.
    label_smoothing : share of the target spread over all classes.
    seed : of weights, order and augmentation.
    augmentation : None trains on the windows as they are.
    precision : "float32", or "bfloat16": the networks' products in 16 bits, the weights in 32. Half the time or
        less where the hardware supports it (AMX, AVX512-BF16, GPUs), no gain elsewhere.
    balance : each epoch shows every class equally often, and the validation loss weights classes equally; else
        windows count equally.
    patience : stop when the validation loss has not fallen for this many epochs; the best epoch is then the one with
        the lowest validation loss. None trains to the end; the best epoch then has the most windows right.
    network : the classifier, see `training.networks.build_network`. Not used where a model is trained further.
    """

    epochs: int = 10
    iterations: int | None = None
    batch: int = 64
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    label_smoothing: float = 0.05
    seed: int = 0
    augmentation: Augmentation | None = field(default_factory=Augmentation)
    precision: str = "float32"
    balance: bool = False
    patience: int | None = None
    network: str = "thesis"

    def __post_init__(self) -> None:
        for name, low in (("epochs", 1), ("iterations", 1), ("batch", 1), ("seed", 0), ("patience", 1)):
            value = getattr(self, name)
            if value is not None and value < low:
                raise ValueError(f"`{name}` must be at least {low}, got {value}")
        if self.precision not in PRECISIONS:
            raise ValueError(f"`precision` must be one of {', '.join(PRECISIONS)}, got {self.precision!r}")
        if not 0 < self.learning_rate < math.inf:
            raise ValueError(f"`learning_rate` must be positive, got {self.learning_rate}")
        if not 0 <= self.weight_decay < math.inf:
            raise ValueError(f"`weight_decay` must be at least 0, got {self.weight_decay}")
        if not 0 <= self.label_smoothing < 1:
            raise ValueError(f"`label_smoothing` must be in [0, 1), got {self.label_smoothing}")

    def n_steps(self, n_windows: int) -> int:
        """Steps of an epoch of `n_windows`. A last batch of a single window is left out: batch norm needs two."""
        n_full, n_rest = divmod(n_windows, self.batch)
        return max(1, n_full + (n_rest > 1))

    def n_epochs(self, n_windows: int) -> int:
        """Passes over `n_windows` training windows; the last one may be cut short."""
        return math.ceil(self.n_iterations(n_windows) / self.n_steps(n_windows))

    def n_iterations(self, n_windows: int) -> int:
        """All steps, for `n_windows` training windows."""
        return self.iterations or self.epochs * self.n_steps(n_windows)


def settings_for(
    config: TNTConfig,
    n_windows: int,
    n_held_out: int,
    *,
    epochs: int | None = None,
    batch: int | None = None,
    patience: int | None = None,
    augmentation: Mapping[str, Any] | None = MappingProxyType({}),
    resynthesized: bool = False,
    **settings: Any,
) -> TrainSettings:
    """Settings for a data set of any size: where nothing is given, enough small steps even for few windows.

    Parameters
    ----------
    config : of the volumes, which scales the augmentation.
    n_windows, n_held_out : windows to train on, and held out.
    epochs, batch : passes over the windows, and windows in a step; by default by their number.
    patience : 0 trains to the end, where the learning rate is 0. The default, but for other motions: a fifth of all
        epochs.
    augmentation : fields of `Augmentation` whose values differ from `Augmentation.for_sensor` and `STREAMED`; None: as
        recorded.
    resynthesized : whether the windows are also shown in other motions.
    settings : others of `TrainSettings`.
    """
    batch = min(64, max(8, n_windows // 32)) if batch is None else batch
    if epochs is None:
        steps = MIN_STEPS_MOVED if resynthesized else MIN_STEPS
        epochs = max(30, math.ceil(steps / TrainSettings(batch=batch).n_steps(n_windows)))
    found = TrainSettings(
        epochs=epochs,
        batch=batch,
        augmentation=None if augmentation is None else _augmentation(config, augmentation),
        balance=True,
        **settings,
    )
    if patience is None:
        patience = max(5, found.n_epochs(n_windows) // 5) if n_held_out and resynthesized else 0
    return replace(found, patience=patience or None)


def _augmentation(config: TNTConfig, changes: Mapping[str, Any]) -> Augmentation:
    earliest_ms = EARLIEST * config.window_us / 1e3
    return Augmentation.for_sensor(config, **{"partial_from_ms": earliest_ms, **STREAMED, **changes})
