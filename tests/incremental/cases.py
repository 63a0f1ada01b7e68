"""What the tests of the incremental classifier share: configurations of every kind, with models, volumes, streams."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import tnt_reference
import torch
from made import random_model

from async_tnt import CompiledClassifier, CompiledRegressor, Model, TNTConfig, TNTVolume

WINDOW_US = 4000
LANDMARKS = {
    "center": {"landmark": "center"},
    "running": {"landmark": "running"},
    "line": {"landmark": "line"},
    "flow": {"landmark": "line", "remove_flow": True},
    "window": {"landmark": "window"},
    "regressor": {"landmark": "regressor"},
    "none": {"transform": "none"},
}


class Case(NamedTuple):
    """A configuration and a network."""

    grid: tuple[int, int]
    bins: int
    polarity: str
    landmark: str
    widths: tuple[int, int, int]
    classes: int
    sensor: tuple[int, int] | None = None

    def __str__(self) -> str:
        grid, widths = ("x".join(map(str, numbers)) for numbers in (self.grid, self.widths))
        return f"{grid}-{self.bins}-{self.polarity}-{self.landmark}-{widths}-{self.classes}"

    @property
    def config(self) -> TNTConfig:
        sensor = self.sensor or self.grid
        return TNTConfig(
            sensor=sensor,
            grid=self.grid,
            bins=self.bins,
            polarity=self.polarity,
            window_us=WINDOW_US,
            t_max=2.0,
            **LANDMARKS[self.landmark],
        )

    def volume(self) -> TNTVolume:
        regressor = CompiledRegressor(model_of(self)) if self.config.needs_regressor else None
        return TNTVolume(self.config, regressor=regressor)

    def classifier(self, seed: int = 0) -> CompiledClassifier:
        return CompiledClassifier(model_of(self, seed))


CASES = [
    Case((4, 4), 1, "signed", "none", (1, 1, 1), 1),
    Case((5, 7), 2, "unsigned", "running", (3, 5, 7), 2),
    Case((6, 4), 9, "split", "line", (1, 1, 1), 10),
    Case((7, 5), 1, "split", "center", (17, 33, 65), 37),
    Case((8, 8), 2, "signed", "regressor", (3, 5, 7), 2),
    Case((8, 8), 9, "split", "window", (16, 32, 64), 10),
    Case((13, 9), 9, "signed", "flow", (40, 20, 130), 37, (20, 14)),
    Case((34, 34), 9, "signed", "running", (16, 32, 64), 10),
    Case((34, 34), 9, "signed", "none", (16, 32, 64), 10),
    Case((34, 34), 2, "split", "flow", (17, 33, 65), 2),
    Case((40, 30), 9, "unsigned", "line", (3, 5, 7), 1),
]
LARGE = Case((346, 260), 9, "signed", "running", (16, 32, 64), 10)


@cache
def model_of(case: Case, seed: int = 0) -> Model:
    """Random weights; the same model each time."""
    model = random_model(case.config, classes=case.classes, widths=case.widths, seed=seed, sharpness=30.0)
    if case.widths > (1, 1, 1):
        return model
    alive = {name: np.abs(w) for name, w in model.weights.items() if not name.startswith("fc2")}
    return Model(model.config, model.weights | alive, model.classes)  # or else one ReLU may end it all


@cache
def dense_of(case: Case, seed: int = 0) -> CompiledClassifier:
    """What is held to be right: a classifier that is only ever called with arrays, and so computes everything."""
    return case.classifier(seed)


def reference_of(model: Model) -> tnt_reference.Classifier:
    """The torch reference with the model's weights."""
    widths = tuple(len(model.weights[f"{layer}.bias"]) for layer in ("conv1", "conv2", "fc1"))
    reference = tnt_reference.Classifier(model.config.channels, model.config.grid, len(model.classes), widths)
    names = reference.state_dict().keys()
    reference.load_state_dict({name: torch.tensor(model.weights[name]) for name in names})
    return reference
