"""What a training minimizes, and what it measures after each epoch: the class of windows, or
objects in scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F

from async_tnt.evaluation.object_scores import ObjectScores, score_objects
from async_tnt.evaluation.scores import share_right
from async_tnt.kernels.training.window_batches import SHOWN
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.objects import ObjectReader, new_tracks
from async_tnt.training.augment import Draws, on_pixels, unchanged
from async_tnt.training.evaluation import BATCH, class_probabilities, confusion_by_recording
from async_tnt.training.networks import build_network
from async_tnt.training.pipeline import Pipeline, pipeline_of
from async_tnt.training.scenes import OBJECTS, SceneMaker, Scenes
from async_tnt.training.settings import TrainSettings
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig


@dataclass(frozen=True)
class BatchLoss:
    """Of a batch: the loss to minimize, and how many of what were right."""

    loss: torch.Tensor
    n_right: int
    n: int


class ClassOfWindows:
    """Cross-entropy of each window's class.

    Parameters
    ----------
    config : of the volumes that the finished model takes.
    validation : windows that are held out; may be empty.
    teachers : models whose mean probabilities are half of the target (Hinton, Vinyals, Dean 2015,
        arXiv:1503.02531).
    """

    def __init__(
        self,
        config: TNTConfig,
        validation: Windows,
        settings: TrainSettings,
        n_classes: int,
        teachers: Sequence[Model] = (),
    ) -> None:
        self.config = config
        self._validation, self._settings, self._n_classes = validation, settings, n_classes
        self._masters = [pipeline_of(teacher) for teacher in teachers]

    def loss(self, pipeline: Pipeline, windows: Windows, draws: Draws | None) -> BatchLoss:
        """Of a batch of windows, augmented by `draws`."""
        target = self._targets(windows, draws).to(pipeline.scale.device)
        logits = pipeline(windows, draws)
        loss = F.cross_entropy(logits, target, label_smoothing=self._settings.label_smoothing)
        of_a_class = np.ones(len(windows), bool) if draws is None else draws.nothing == SHOWN
        is_right = logits.detach().argmax(1).cpu().numpy() == windows.labels
        return BatchLoss(loss, int(is_right[of_a_class].sum()), int(of_a_class.sum()))

    def _targets(self, windows: Windows, draws: Draws | None) -> torch.Tensor:
        """(N, n_classes): all on the class; the same on all classes where nothing is shown
        (Hendrycks, Mazeika, Dietterich 2019, arXiv:1812.04606), so that no class is decided with
        confidence. With teachers half of it is what they say of the same windows, but where nothing
        is shown."""
        targets = np.eye(self._n_classes, dtype=np.float32)[windows.labels]
        nothing = np.zeros(len(windows), bool) if draws is None else draws.nothing != SHOWN
        targets[nothing] = 1.0 / self._n_classes
        target = torch.from_numpy(targets)
        if not self._masters:
            return target
        with torch.no_grad():
            answers = [
                m(windows, None if draws is None else on_pixels(draws, m.config))
                for m in self._masters
            ]
            said = torch.softmax(torch.stack(answers), 2).mean(0)
        return torch.where(torch.from_numpy(nothing)[:, None], target, (target + said) / 2)

    def validate(self, pipeline: Pipeline) -> dict[str, float]:
        """What the history has of an epoch; empty where nothing is held out."""
        return self.of_windows(pipeline, self._validation)

    def of_windows(self, pipeline: Pipeline, windows: Windows) -> dict[str, float]:
        """Accuracy and loss at the windows' ends; with `balance`, the loss is the mean over
        classes."""
        if len(windows) == 0:
            return {}
        probabilities = class_probabilities(pipeline, windows)
        labels = windows.labels
        losses = -np.log(probabilities[np.arange(len(labels)), labels] + 1e-12)
        balance = self._settings.balance
        parts = [losses[labels == label] for label in np.unique(labels)] if balance else [losses]
        return {
            "per_window": float((probabilities.argmax(1) == labels).mean()),
            "per_recording": share_right(confusion_by_recording(probabilities, windows)),
            "validation_loss": float(np.mean([part.mean() for part in parts])),
        }


REACH = 0.15
"""Of a recording's shorter side: an object counts as found where one of its class is found so
near."""
N_SCENES = 400
SHARES = 0.3, 0.5
"""Of a window, after which scenes are also scored."""


class SceneScores:
    """How well a map model finds objects in scenes, which are the same at each call.

    Parameters
    ----------
    crops : of the recordings' volumes.
    model : a map model for scenes of these; its weights do not matter.
    windows : of which at most as many are used as `N_SCENES` scenes hold.
    """

    def __init__(self, crops: TNTConfig, model: Model, windows: Windows) -> None:
        assert model.places is not None
        self._classes = model.classes
        self._maker, self._reader = SceneMaker(crops), ObjectReader(model.logits_shape)
        self._tracks = new_tracks(model.places, model.logits_shape, 0)
        some = np.random.default_rng(0).permutation(len(windows))[: round(N_SCENES * OBJECTS)]
        self._windows, self._within = windows[some], REACH * min(crops.sensor)

    def after(self, pipeline: Pipeline, share: float) -> ObjectScores:
        """After this share of each window."""
        rng = np.random.default_rng(1)
        was_training = pipeline.training
        pipeline.eval()
        n_classes = self._reader.shape[0] - 1
        scores = ObjectScores(*np.zeros((3, n_classes), np.int64))
        for first in range(0, len(self._windows), BATCH):
            windows = self._windows[first : first + BATCH]
            draws = unchanged(len(windows), self._maker.crops)
            draws.until_us[:] = round(share * self._maker.config.window_us)
            scenes = self._maker(windows, draws, rng)
            with torch.no_grad():
                maps = pipeline.classify(torch.from_numpy(scenes.volumes)).cpu().numpy()
            for k, logits in enumerate(maps):
                n = self._reader.read(logits, self._tracks, 0, False)
                objects = self._reader.found[: max(0, n)]  # none where a logit is not finite
                inside = scenes.scene == k
                scores += score_objects(
                    objects, scenes.label[inside], scenes.position[inside], self._within, n_classes
                )
        pipeline.train(was_training)
        return scores

    def to_dict(self, pipeline: Pipeline) -> dict[str, Any]:
        """Plain values, for JSON."""
        whole = self.after(pipeline, 1.0)
        early = {share: self.after(pipeline, share).f1 for share in SHARES}
        window_ms = self._maker.config.window_us / 1e3
        return {
            **whole.to_dict(self._classes),
            "f1_against_time_ms": {
                f"{share * window_ms:g}": round(f1, 5) for share, f1 in early.items()
            },
        }


LEFT_OUT, WEIGHT = 0.2, 4.0
"""A share of a recording's shorter side: a place within `REACH` of an object, or the nearest one,
is to name its class; one that is so near is left out; others are to say nothing. And what an
object's places weigh, by those of nothing."""


class ObjectsInScenes:
    """Cross-entropy at each place of the map of scenes.

    Parameters
    ----------
    config : of the recordings' volumes.
    validation : windows that are held out, for scenes to measure F1 on; may be empty.

    Raises
    ------
    ValueError : see `SceneMaker`; or the network of `settings` computes no map.
    """

    def __init__(
        self,
        config: TNTConfig,
        validation: Windows,
        settings: TrainSettings,
        classes: tuple[str, ...],
    ) -> None:
        self._maker = SceneMaker(config)
        self.config = self._maker.config
        with torch.random.fork_rng(devices=[]):
            network = build_network(
                settings.network, config.channels, self.config.grid, len(classes)
            )
        model = Model.from_torch(network, self.config, classes)
        if model.places is None:
            raise ValueError(
                f"`network` {settings.network} must compute a map of {len(classes) + 1} channels"
            )
        self._places, self._map = model.places, model.logits_shape
        self._shorter = min(config.sensor)
        self._scores = SceneScores(config, model, validation) if len(validation) else None

    def loss(self, pipeline: Pipeline, windows: Windows, draws: Draws | None) -> BatchLoss:
        """Of scenes of a batch of windows, augmented by `draws`."""
        rng = np.random.default_rng(
            [*windows.recording.tolist()] if draws is None else draws.seed[:1]
        )
        scenes = self._maker(
            windows, unchanged(len(windows), self._maker.crops) if draws is None else draws, rng
        )
        logits = pipeline.classify(torch.from_numpy(scenes.volumes))
        target, weight = map(torch.from_numpy, self._targets(scenes))
        weight = weight.to(logits.device)
        losses = F.cross_entropy(logits, target.to(logits.device), reduction="none")
        is_object = target < self._map[0] - 1
        is_right = logits.detach().argmax(1).cpu() == target
        return BatchLoss(
            (losses * weight).sum() / weight.sum(),
            int(is_right[is_object].sum()),
            int(is_object.sum()),
        )

    def _targets(self, scenes: Scenes) -> tuple[np.ndarray, np.ndarray]:
        """Class and weight of each place, int64 and float32, (M, R, C)."""
        nothing, rows, columns = self._map[0] - 1, *self._map[1:]
        shape = len(scenes.volumes), rows, columns
        target, weight = np.full(shape, nothing, np.int64), np.ones(shape, np.float32)
        nearest = np.full(shape, np.inf)
        x0, dx, y0, dy = self._places
        for scene, label, (x, y) in zip(scenes.scene, scenes.label, scenes.position, strict=True):
            across, down = (
                np.abs(x0 + dx * np.arange(columns) - x),
                np.abs(y0 + dy * np.arange(rows) - y),
            )
            away = np.maximum(down[:, None], across)
            away[away.argmin() // columns, away.argmin() % columns] = 0.0
            is_nearest = away < nearest[scene]
            nearest[scene][is_nearest] = away[is_nearest]
            target[scene][is_nearest & (away <= REACH * self._shorter)] = label
        weight[nearest <= LEFT_OUT * self._shorter] = 0.0
        weight[target < nothing] = WEIGHT
        return target, weight

    def validate(self, pipeline: Pipeline) -> dict[str, float]:
        """What the history has of an epoch; empty where nothing is held out."""
        return {} if self._scores is None else {"f1": self._scores.after(pipeline, 1.0).f1}
