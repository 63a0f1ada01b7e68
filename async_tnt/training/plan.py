"""What a user asks of a training, and what can be checked before the data set is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from async_tnt.networks.models.model import GRID_STEP
from async_tnt.training.networks import find_network
from async_tnt.training.pipeline import check_network
from async_tnt.training.run_folder import load_checkpoint
from async_tnt.training.scenes import SceneMaker
from async_tnt.training.settings import (
    BATCH_OF_TABLES,
    OF_PICTURES,
    OF_SCALES,
    TrainSettings,
    settings_for,
)
from async_tnt.training.training_data import TrainingData
from async_tnt.training.volume_choice import VolumeChoice
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.sensor import Sensor


@dataclass(frozen=True)
class Plan:
    """What a user asks of a training. The data set decides the fields that are None.

    Parameters
    ----------
    volume : how events become volumes.
    network : the classifier, see `training.networks.build_network`.
    epochs : number of epochs.
    seed : seed of the weights, the order of windows and the augmentation.
    everywhere : whether a map model is trained, on scenes.
    mirror : whether half of the windows are mirrored from left to right.
    has_pictures : whether the data set holds pictures.
    scales : sizes of objects, see `dataset_data`.
    has_tables : whether the data set has tables of boxes.
    """

    volume: VolumeChoice
    network: str | None = None
    epochs: int | None = None
    seed: int = 0
    everywhere: bool = False
    mirror: bool = False
    has_pictures: bool = False
    scales: tuple[float, float] | None = None
    has_tables: bool = False

    @property
    def _has_sizes(self) -> bool:
        """Whether the sizes of objects are known, so that scenes have objects of many sizes."""
        return self.scales is not None or self.has_tables

    def check(self) -> None:
        """Refuse a network that does not fit the volume.

        The volume of the data set is not known yet, and a user's own network may fit no other
        volume. So only the file and the function of such a network are looked for.

        Raises
        ------
        ValueError : see `check_network` and `find_network`.
        """
        # the number of windows is not known yet, and does not decide the network
        network = self._settings(self.volume.config, 1).network
        if ":" in network:
            find_network(network)
        else:
            check_network(network, self._input(self.volume.config), everywhere=self.everywhere)

    def check_run(self, run_folder: Path, sensor: Sensor | None) -> None:
        """Refuse a run folder whose run has another volume, network or seed.

        sensor : (width, height) of the events; None: it is not known yet.

        Raises
        ------
        ValueError, OSError : see `load_checkpoint`.
        """
        settings = self._settings(self.volume.config, 1)
        known = self.volume.known(sensor)
        if self.scales is not None:  # a run knows the sensor and the grid that are cut out
            known.pop("sensor", None)
            known.pop("grid", None)
        known |= {"seed": settings.seed, "network": settings.network}
        load_checkpoint(run_folder, known)

    def settings_for(self, data: TrainingData) -> TrainSettings:
        """The settings with which to train on a data set.

        Raises
        ------
        ValueError : the network does not fit the data set's volumes, see `check_network`.
        """
        settings = self._settings(data.config, len(data.training))
        check_network(
            settings.network,
            data.scenes or self._input(data.config),
            len(data.classes),
            everywhere=self.everywhere,
        )
        return settings

    def _settings(self, config: TNTConfig, n_windows: int) -> TrainSettings:
        """The settings for `n_windows` windows to train on."""
        augmentation: dict[str, Any] = {"mirror": self.mirror}
        if self.has_pictures:
            augmentation |= OF_PICTURES
        chosen: dict[str, Any] = {}
        if self._has_sizes:
            chosen["network"] = OF_SCALES
        if self.has_tables:
            chosen["batch"] = BATCH_OF_TABLES
        if self.network is not None:
            chosen["network"] = self.network
        return settings_for(
            config,
            n_windows,
            epochs=self.epochs,
            seed=self.seed,
            everywhere=self.everywhere,
            augmentation=augmentation,
            **chosen,
        )

    def _input(self, config: TNTConfig) -> TNTConfig:
        """The volume that the network takes: that of a recording, or of a scene of recordings.

        The sensor of scenes of objects of many sizes may not be known yet. Any grid that has twice
        as many steps as it needs stands for theirs.
        """
        if not self._has_sizes:
            return SceneMaker(config).config if self.everywhere else config
        if "grid" not in self.volume.fitted:
            return config
        side = 8 * GRID_STEP
        return config.replace(sensor=(side, side), grid=(side, side))
