"""How to train: settings, and their defaults for a data set."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from async_tnt.training.augment import Augmentation
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.sensor import Sensor

PRECISIONS = ("float32", "bfloat16", "auto")
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
"""Of `Augmentation` for a data set by default: windows end early or begin late, as in a stream, or
show nothing; they are shifted and scaled. Rotation by 10 degrees, shear by .1 and thinning by .3
cost .01 on N-CARS' held-out recordings."""
OF_PICTURES = MappingProxyType({"rotation_deg": 10.0, "shear": 0.1, "drop": 0.3})
"""Further changes where a data set holds pictures, whose recordings are simulated once for all
epochs."""
EARLIEST = 0.05
"""The earliest end of such a window, as a share of the complete one."""
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
"""Of `TrainSettings` for a data set by default."""
EVERYWHERE = MappingProxyType({"network": "map", "balance": False})
"""Of a map model's by default, instead: in scenes nothing is far more frequent than any class."""
LONGER_SIDE = 120
"""Of a default grid."""
BINS, OFTEN = 5, 2.25
"""Of a default volume: time bins where an active pixel fires `OFTEN` or more times in a window. Its
counts blur what moves that far, and cost up to .1; where pixels fire less (N-CARS 1.7; N-MNIST
3.2), bins cost .03. In motions that are simulated again there are always bins: of digits with a
fifth of their events .922 are right that are held out in other motions, by counts .897
(`experiments/unseen_motions.py`)."""
MIN_EPOCHS, MIN_STEPS, STEPS_AN_EPOCH = 20, 4_000, 50
"""Of a data set by default: epochs; steps of the optimizer, which decide where windows are few;
steps between two checkpoints."""


@dataclass(frozen=True)
class TrainSettings:
    """How to train. Where the thesis is silent (everywhere but the loss), the choices are ours.

    Parameters
    ----------
    epochs : of `passes` over the training windows; after each a checkpoint is saved.
    iterations : steps of the optimizer, instead of `epochs`; the last epoch may be cut short. The
        thesis has 60,000, with a batch of 64.
    batch : windows per step.
    passes : of an epoch.
    learning_rate : the highest; it rises over the first steps and falls along a cosine to 0.
    warm_up : the share of steps over which it rises.
    weight_decay : of AdamW, on weights, not on biases.
    label_smoothing : share of the target spread over all classes.
    averaging : the model has the exponential moving average of the weights of all steps, each of
        which keeps this share of the average before; 0: the last weights.
    logarithm : the classifier takes log(1 + V) of each cell of the volume; not of signed ones.
    seed : of weights, order and augmentation.
    augmentation : None trains on the windows as they are.
    precision : "float32", or "bfloat16": the networks' products in 16 bits, the weights in 32. Half
        the time or less where the hardware is fast at it (AMX, AVX512-BF16, GPUs), slower
        elsewhere; "auto" finds out.
    balance : each epoch shows every class equally often, and the validation loss weights classes
        equally; else windows count equally.
    network : the classifier, see `training.networks.build_network`. Not used where a model is
        trained further.
    everywhere : train a map model, on scenes of several windows, see `scenes`; `batch` counts these
        windows.
    ends_early : end before the last epoch where nothing that is measured on held-out windows can
        improve, see `training.early_end`.
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
        for name, low in (
            ("epochs", 1),
            ("iterations", 1),
            ("passes", 1),
            ("batch", 1),
            ("seed", 0),
        ):
            value = getattr(self, name)
            if value is not None and value < low:
                raise ValueError(f"`{name}` must be at least {low}, got {value}")
        if self.precision not in PRECISIONS:
            raise ValueError(
                f"`precision` must be one of {', '.join(PRECISIONS)}, got {self.precision!r}"
            )
        if not 0 < self.learning_rate < math.inf:
            raise ValueError(f"`learning_rate` must be positive, got {self.learning_rate}")
        if not 0 <= self.weight_decay < math.inf:
            raise ValueError(f"`weight_decay` must be at least 0, got {self.weight_decay}")
        for name in ("label_smoothing", "averaging", "warm_up"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"`{name}` must be in [0, 1), got {getattr(self, name)}")

    def n_steps(self, n_windows: int) -> int:
        """Steps of an epoch of `n_windows`. A last batch of a single window is left out: batch norm
        needs two."""
        n_full, n_rest = divmod(self.passes * n_windows, self.batch)
        return max(1, n_full + (n_rest > 1))

    def n_epochs(self, n_windows: int) -> int:
        """Epochs of `n_windows` training windows; the last one may be cut short."""
        return math.ceil(self.n_iterations(n_windows) / self.n_steps(n_windows))

    def n_iterations(self, n_windows: int) -> int:
        """All steps, for `n_windows` training windows."""
        return self.iterations or self.epochs * self.n_steps(n_windows)


def default_config(**changes: Any) -> TNTConfig:
    """The volume that a data set is trained on by default: how many ON and OFF events each pixel
    has.

    changes : values of other fields. For the grid see `default_grid`, for time bins `with_bins`.
    """
    return TNTConfig(**{"representation": "count", "landmark": "center", **changes})


def with_bins(config: TNTConfig, events_a_pixel: float = OFTEN) -> TNTConfig:
    """The default volume in time bins, where pixels fire often.

    events_a_pixel : events of one polarity in a window, of a pixel that has any.

    Examples
    --------
    >>> with_bins(default_config(), 1.7).shape, with_bins(default_config(), 3.2).shape
    ((2, 34, 34), (10, 34, 34))
    """
    if events_a_pixel < OFTEN:
        return config
    return config.replace(representation="volume", bins=BINS, polarity="split", transform="none")


def default_grid(sensor: Sensor) -> Sensor:
    """In the shape of the sensor: its own pixels, or `LONGER_SIDE` of them along the longer side.
    At least 16x16, which the networks need.

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
    n_windows : windows to train on.
    epochs : None: `MIN_EPOCHS`, or as many as give `MIN_STEPS` steps, or fewer where all that is
        held out is right (`ends_early`).
    settings : others of `TrainSettings`, instead of ours; `augmentation` may be a mapping, of the
        fields of `Augmentation` that differ from ours.
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
        augmentation = Augmentation.for_sensor(
            config, **{"partial_from_ms": earliest_ms, **CHANGES, **augmentation}
        )
    ours = {**RECIPE, "logarithm": config.polarity != "signed"}
    if settings.get("everywhere"):
        ours |= EVERYWHERE
    return TrainSettings(epochs=epochs, augmentation=augmentation, **{**ours, **settings})
