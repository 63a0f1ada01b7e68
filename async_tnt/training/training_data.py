"""The data of a training: windows to train on, to validate on and to test on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig


@dataclass(frozen=True)
class TrainingData:
    """The data of a training: windows to train on, to validate on and to test on.

    Parameters
    ----------
    config : how events become volumes, with the sensor of the events.
    classes : names, one for each label from 0 on.
    training : windows to learn from.
    validation : windows that are held out; may be empty. They decide the temperature. With
        `TrainSettings.ends_early` they also decide which epoch is the last. They decide nothing
        else.
    record : a description of the recordings, for the model's record.
    tests : name of an entry of the model's record -> the windows to test on, and the values that
        this entry has beside their scores.
    held_out : names of the recordings to validate on.
    masked : bool, (H, W): pixels of the sensor whose events were left out; None: no such pixel.
    left_out : the recordings that were left out and why, one line each.
    notes : what else a user should know, one line each.
    scenes : how the events of scenes become volumes, if scenes have objects of many sizes, see
        `table_scenes.maker_of`.
    """

    config: TNTConfig
    classes: tuple[str, ...]
    training: Windows
    validation: Windows
    record: dict[str, Any] = field(default_factory=dict)
    tests: Mapping[str, tuple[Windows, dict[str, Any]]] = field(default_factory=dict)
    held_out: tuple[str, ...] = ()
    masked: np.ndarray | None = None
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    scenes: TNTConfig | None = None
