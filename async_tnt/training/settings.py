"""How to train: settings, and their defaults for a data set."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from async_tnt.base.checks import ParameterValueError
from async_tnt.training.augment import Augmentation
from async_tnt.volume.config import WINDOW_US, TNTConfig
from async_tnt.volume.sensor import Sensor

PRECISIONS = ("float32", "bfloat16", "auto")
"""Values of `TrainSettings.precision`."""

CHANGES = MappingProxyType(
    {
        "partial": 0.6,
        "late_start": 0.5,
        "nothing": 0.1,
        "scale": 0.2,
        "rotation_deg": 0.0,
        "shear": 0.0,
        "drop": 0.0,
    }
)
"""Default values of `Augmentation` for a data set.

Windows are shifted and scaled. Some end early or begin late, as in a stream, and some show nothing.
Windows are not rotated, sheared or thinned, because rotation by 10 degrees, shear by .1 and
thinning by .3 cost .01 of the accuracy on N-CARS' held-out recordings."""
EARLIEST = 0.05
"""The earliest end of a window that ends early, as a share of the complete window."""
SLIDING = MappingProxyType({"start_ms": 0.0, "partial": 0.0, "late_start": 0.0})
"""Values of `Augmentation` that differ from `CHANGES` for windows that slide. `Windows.slid` moves
these windows to all moments."""
OF_PICTURES = MappingProxyType({"rotation_deg": 10.0, "shear": 0.1, "drop": 0.3})
"""Values of `Augmentation` that differ from `CHANGES` if a data set holds pictures. Recordings of
pictures are simulated once for all epochs, so they need more augmentation."""

RECIPE = MappingProxyType(
    {
        "learning_rate": 4e-3,
        "weight_decay": 0.05,
        "warm_up": 0.3,
        "averaging": 0.995,
        "balance": True,
        "precision": "auto",
        "network": "residual",
    }
)
"""Default values of `TrainSettings` for a data set."""
EVERYWHERE = MappingProxyType({"network": "map", "balance": False})
"""Values of `TrainSettings` that differ from `RECIPE` for a map model. Classes are not balanced,
because in scenes "nothing" is far more frequent than any class anyway."""

OF_SCALES = "boxes"
"""The default network of a map model that learns objects of many sizes."""

BATCH_OF_TABLES = 16
"""Number of windows per step for recordings with tables of boxes. They are of the whole sensor."""

LONGER_SIDE = 120
"""Most cells along the longer side of a default grid."""
BINS = 5
"""Number of time bins of a default volume that has bins."""
OFTEN = 2.25
"""Number of events of one polarity, per active pixel and window, from which on the default volume
has time bins.

If pixels fire more often, counts may blur what moves. Counts instead of bins cost .1 of the
accuracy on the simulated data set `sessions` of `experiments/RESULTS.md` (3.0 events), and nothing
on N-MNIST (3.2 events). If pixels fire less often, bins cost accuracy: .03 on N-CARS (1.7 events).
A training with windows under other motions always has bins, because they help there. With a fifth
of N-MNIST's events, .922 of the digits in held-out motions are right with bins, and .897 with
counts."""

MIN_EPOCHS = 20
"""Least number of epochs by default."""
MIN_STEPS = 4_000
"""Least number of optimizer steps by default. With few windows, a training has more epochs than
`MIN_EPOCHS` to make so many steps."""
STEPS_AN_EPOCH = 50
"""Least number of steps of an epoch by default. After each epoch a checkpoint is saved."""


@dataclass(frozen=True)
class TrainSettings:
    """How to train. The thesis states some of the values. The other values are our choice.

    Parameters
    ----------
    epochs : number of epochs. After each epoch a checkpoint is saved.
    iterations : number of optimizer steps, instead of `epochs`. The last epoch may be cut short.
        The thesis has 60,000 steps, with a batch of 64.
    passes : number of times that an epoch goes through the training windows.
    batch : number of windows per step.
    learning_rate : the highest rate. It rises over the first steps, and falls along a cosine to 0.
    warm_up : the share of steps over which the rate rises.
    weight_decay : decay of AdamW. It acts on weights, not on biases.
    label_smoothing : share of the target that is spread over all classes.
    averaging : if it is above 0, the model has an exponential moving average of the weights of all
        steps. Each step keeps this share of the average before it. 0: the model has the last
        weights.
    logarithm : whether the classifier takes log(1 + V) of each cell V of the volume. Not for signed
        volumes.
    seed : decides the weights, the order of windows and the augmentation.
    augmentation : changes of the windows; None trains on the windows as they are.
    precision : "float32", "bfloat16" or "auto". With "bfloat16", the networks multiply in 16 bits,
        and keep their weights in 32 bits. This takes half the time or less on hardware that
        multiplies fast in 16 bits (AMX, AVX512-BF16, GPUs), and more time on other hardware. "auto"
        chooses "bfloat16" on fast hardware.
    balance : whether each epoch shows every class equally often, and the validation loss gives all
        classes the same weight. Otherwise all windows have the same weight.
    network : the classifier, see `training.networks.build_network`. Not used if a model is trained
        further.
    everywhere : whether a map model is trained, on scenes of several windows, see `scenes`. `batch`
        counts these windows.
    ends_early : whether the training ends before its last epoch when no measurement on held-out
        windows can improve any more, see `training.early_end`.

    Raises
    ------
    ValueError : a value is outside of its range.
    """

    epochs: int = 10
    iterations: int | None = None
    passes: int = 1
    batch: int = 64
    learning_rate: float = 2e-3
    warm_up: float = 0.05
    weight_decay: float = 1e-2
    label_smoothing: float = 0.05
    averaging: float = 0.0
    logarithm: bool = False
    seed: int = 0
    augmentation: Augmentation | None = field(default_factory=Augmentation)
    precision: str = "float32"
    balance: bool = False
    network: str = "thesis"
    everywhere: bool = False
    ends_early: bool = False

    def __post_init__(self) -> None:
        least = {"epochs": 1, "iterations": 1, "passes": 1, "batch": 1, "seed": 0}
        for name, low in least.items():
            value = getattr(self, name)
            if value is not None and value < low:
                raise ParameterValueError(name, f"must be at least {low}", value)
        if self.precision not in PRECISIONS:
            names = ", ".join(PRECISIONS)
            raise ParameterValueError("precision", f"must be one of {names}", repr(self.precision))
        if not 0 < self.learning_rate < math.inf:
            raise ParameterValueError("learning_rate", "must be positive", self.learning_rate)
        if not 0 <= self.weight_decay < math.inf:
            raise ParameterValueError("weight_decay", "must be at least 0", self.weight_decay)
        for name in ("label_smoothing", "averaging", "warm_up"):
            value = getattr(self, name)
            if not 0 <= value < 1:
                raise ParameterValueError(name, "must be in [0, 1)", value)

    def n_steps(self, n_windows: int) -> int:
        """The number of steps of an epoch of `n_windows` training windows.

        A last batch of a single window is left out, because batch norm needs two.
        """
        n_full, n_rest = divmod(self.passes * n_windows, self.batch)
        return max(1, n_full + (n_rest > 1))

    def n_epochs(self, n_windows: int) -> int:
        """The number of epochs of `n_windows` training windows; the last one may be cut short."""
        return math.ceil(self.n_iterations(n_windows) / self.n_steps(n_windows))

    def n_iterations(self, n_windows: int) -> int:
        """The number of steps of all epochs of `n_windows` training windows."""
        return self.iterations or self.epochs * self.n_steps(n_windows)


def default_config(**changes: Any) -> TNTConfig:
    """The default volume for training: each pixel's counts of ON and of OFF events.

    changes : fields of `TNTConfig` with other values. For the grid see `default_grid`, for time
        bins `with_bins`.
    """
    return TNTConfig(**{"representation": "count", "landmark": "center", **changes})


def duration_us(config: TNTConfig) -> int:
    """The duration of a window; the default one where windows have a number of events instead."""
    return WINDOW_US if config.last_events is not None else config.window_us


def with_bins(config: TNTConfig, events_a_pixel: float = OFTEN) -> TNTConfig:
    """The volume with time bins if pixels fire at least `OFTEN` times; otherwise `config` itself.

    Parameters
    ----------
    config : the volume, with counts instead of bins.
    events_a_pixel : number of events of one polarity that an active pixel has in a window. By
        default, pixels fire often enough.

    Examples
    --------
    >>> with_bins(default_config(), 1.7).shape, with_bins(default_config(), 3.2).shape
    ((2, 34, 34), (10, 34, 34))
    """
    if events_a_pixel < OFTEN:
        return config
    return config.replace(representation="volume", bins=BINS, polarity="split", transform="none")


def default_grid(sensor: Sensor) -> Sensor:
    """The default grid of a sensor, with the sensor's ratio of sides.

    A sensor of at most `LONGER_SIDE` pixels along its longer side gets a cell for each pixel. A
    larger sensor gets `LONGER_SIDE` cells along that side. Each side gets at least 16 cells, which
    the networks need.

    Examples
    --------
    >>> default_grid((34, 34)), default_grid((346, 260)), default_grid((1280, 720))
    ((34, 34), (120, 90), (120, 68))
    """
    shrink = min(1.0, LONGER_SIDE / max(sensor))
    return max(16, round(shrink * sensor[0])), max(16, round(shrink * sensor[1]))


def settings_for(
    config: TNTConfig, n_windows: int, *, epochs: int | None = None, **settings: Any
) -> TrainSettings:
    """Settings for a data set of any size: enough small steps even for few windows.

    Parameters
    ----------
    config : how events become volumes.
    n_windows : number of windows to train on.
    epochs : number of epochs. None: the least number that is at least `MIN_EPOCHS` and has at least
        `MIN_STEPS` steps. In this case the training may end early (`ends_early`).
    settings : fields of `TrainSettings` with other values than the defaults. `augmentation` may be
        a mapping: the fields of `Augmentation` with other values than the defaults.
    """
    batch = settings.setdefault("batch", min(64, max(8, n_windows // 32)))
    passes = settings.setdefault("passes", max(1, STEPS_AN_EPOCH * batch // n_windows))
    if epochs is None:
        steps = TrainSettings(batch=batch, passes=passes).n_steps(n_windows)
        epochs = max(MIN_EPOCHS, math.ceil(MIN_STEPS / steps))
        settings.setdefault("ends_early", True)
    augmentation = settings.pop("augmentation", {})
    if isinstance(augmentation, Mapping):
        earliest_ms = EARLIEST * config.window_us / 1e3
        changes = {"partial_from_ms": earliest_ms, **CHANGES, **augmentation}
        if config.slides:
            changes |= SLIDING
        if config.last_events is not None:
            changes["drop"] = 0.0  # each window has as many events
        augmentation = Augmentation.for_sensor(config, **changes)
    # the logarithm is for volumes without negative cells
    recipe = {**RECIPE, "logarithm": config.polarity != "signed"}
    if settings.get("everywhere"):
        recipe |= EVERYWHERE
    return TrainSettings(epochs=epochs, augmentation=augmentation, **{**recipe, **settings})
