"""The networks that the laws of this folder hold for, each with its configuration.

Another network is one line more.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from made import random_model, thesis_model

from async_tnt import CompiledClassifier, CompiledRegressor, Model, TNTConfig, TNTVolume
from async_tnt.training.networks import build_network

WINDOW_US = 4000


class Network:
    """A grid, bins, widths of the layers and a number of classes.

    `settings` are those of TNTConfig.

    The laws use the methods below and nothing else of it.
    """

    def __init__(
        self, grid: tuple[int, int], bins: int, widths: tuple[int, ...], classes: int, **settings
    ) -> None:
        defaults = {
            "sensor": grid,
            "grid": grid,
            "bins": bins,
            "window_us": WINDOW_US,
            "t_max": 2.0,
        }
        self.config = TNTConfig(**defaults | settings)
        self.widths = widths
        self.classes = classes

    def __str__(self) -> str:
        config = self.config
        grid = "x".join(map(str, config.grid))
        widths = "x".join(map(str, self.widths))
        if config.representation != "volume":
            volume = config.representation
        elif config.transform == "none":
            volume = "none"
        else:
            volume = config.landmark
        return f"{grid}-{config.bins}-{config.polarity}-{volume}-{widths}-{self.classes}"

    @cache  # noqa: B019 (the networks of the list below live as long as the tests)
    def model(self, seed: int = 0) -> Model:
        """Random weights; the same model each time."""
        model = random_model(
            self.config, classes=self.classes, widths=self.widths, seed=seed, sharpness=30.0
        )
        if self.widths > (1, 1, 1):
            return model
        # positive weights: otherwise one ReLU may hide all changes
        alive = {name: np.abs(w) for name, w in model.weights.items() if not name.startswith("fc2")}
        return thesis_model(model.config, model.weights | alive, model.classes)

    def classifier(self, seed: int = 0) -> CompiledClassifier:
        return CompiledClassifier(self.model(seed))

    @cache  # noqa: B019
    def dense(self, seed: int = 0) -> CompiledClassifier:
        """The standard that updates are compared with.

        It is called with arrays only, and so computes everything.
        """
        return self.classifier(seed)

    def volume(self, config: TNTConfig | None = None) -> TNTVolume:
        config = config or self.config
        regressor = CompiledRegressor(self.model()) if config.needs_regressor else None
        return TNTVolume(config, regressor=regressor)


class TrainedNetwork(Network):
    """One of the networks that `train` offers, with random weights and statistics."""

    def __init__(
        self, name: str, grid: tuple[int, int], bins: int, classes: int, **settings
    ) -> None:
        super().__init__(grid, bins, (), classes, **settings)
        self.name = name

    def __str__(self) -> str:
        return f"{self.name}-{super().__str__()}"

    @cache  # noqa: B019
    def model(self, seed: int = 0) -> Model:
        config = self.config
        classes = [f"class {k}" for k in range(self.classes)]
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            module = build_network(self.name, config.channels, config.grid, self.classes)
            for part in module.modules():
                if isinstance(part, torch.nn.BatchNorm2d):
                    part.running_mean.uniform_(-0.2, 0.2)
                    part.running_var.uniform_(0.05, 0.2)
        return Model.from_torch(module, config, classes)


NETWORKS = [
    Network((4, 4), 1, (1, 1, 1), 1, transform="none"),
    Network((5, 7), 2, (3, 5, 7), 2, polarity="unsigned"),
    Network((6, 4), 9, (1, 1, 1), 10, polarity="split", landmark="line"),
    Network((7, 5), 1, (17, 33, 65), 37, polarity="split", landmark="center"),
    Network((8, 8), 2, (3, 5, 7), 2, landmark="regressor"),
    Network((8, 8), 9, (16, 32, 64), 10, polarity="split", landmark="window"),
    Network((13, 9), 9, (40, 20, 130), 37, landmark="line", remove_flow=True, sensor=(20, 14)),
    Network((34, 34), 9, (16, 32, 64), 10),
    Network((34, 34), 9, (16, 32, 64), 10, transform="none"),
    Network((34, 34), 2, (17, 33, 65), 2, polarity="split", landmark="line", remove_flow=True),
    Network((40, 30), 9, (3, 5, 7), 1, polarity="unsigned", landmark="line"),
    TrainedNetwork("conv4", (19, 16), 3, 5, polarity="split", transform="none"),
    TrainedNetwork("residual", (21, 17), 2, 3),
    TrainedNetwork("separable", (16, 16), 2, 3, landmark="line", remove_flow=True),
    TrainedNetwork("residual", (21, 17), 1, 2, representation="count"),
    Network((9, 8), 2, (3, 5, 7), 3, representation="count_time", sensor=(20, 14)),
    Network((9, 8), 1, (3, 5, 7), 3, representation="mean_time", polarity="unsigned"),
    Network((9, 8), 1, (3, 5, 7), 3, representation="time_surface", sensor=(20, 14)),
]
LARGE = Network((346, 260), 9, (16, 32, 64), 10)
SMALL = NETWORKS[1]
DIGITS = NETWORKS[7]
