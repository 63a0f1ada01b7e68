"""What a training minimizes, and what it measures after each epoch.

`ClassOfWindows` is for classifiers, `ObjectsInScenes` for map models.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F

from async_tnt.base.checks import ParameterValueError
from async_tnt.evaluation.object_scores import (
    ObjectScores,
    by_milliseconds,
    moments_us,
    score_objects,
)
from async_tnt.evaluation.scores import share_right
from async_tnt.kernels.training.window_batches import SHOWN
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.objects import ObjectReader, n_of_boxes, new_tracks
from async_tnt.training.augment import Draws, on_pixels, unchanged
from async_tnt.training.evaluation import class_probabilities, confusion_by_recording
from async_tnt.training.networks import build_network
from async_tnt.training.pipeline import Pipeline, pipeline_of
from async_tnt.training.scenes import OF_RECORDING, Scenes
from async_tnt.training.settings import TrainSettings
from async_tnt.training.table_scenes import maker_of
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig


@dataclass(frozen=True)
class BatchLoss:
    """The loss of a batch, and how much of the batch is classified right.

    Parameters
    ----------
    loss : the loss, to minimize.
    n_right, n : `n_right` of the `n` windows that show a class are classified right. For a map
        model, `n_right` of the `n` places whose target is a class are classified right.
    """

    loss: torch.Tensor
    n_right: int
    n: int


class ClassOfWindows:
    """The objective of a classifier: the cross-entropy of each window's class.

    Parameters
    ----------
    config : how events become the volumes that the finished model takes.
    validation : windows that are held out; may be empty.
    settings : how the model is trained.
    n_classes : number of classes.
    teachers : models that the trained model imitates. The mean of their probabilities makes up half
        of the target (Hinton, Vinyals, Dean 2015, arXiv:1503.02531).
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
        self._validation = validation
        self._settings = settings
        self._n_classes = n_classes
        self._teachers = [pipeline_of(teacher) for teacher in teachers]

    def loss(self, pipeline: Pipeline, windows: Windows, draws: Draws | None) -> BatchLoss:
        """The loss of a batch of windows, augmented by `draws`."""
        target = self._targets(windows, draws).to(pipeline.scale.device)
        logits = pipeline(windows, draws)
        loss = F.cross_entropy(logits, target, label_smoothing=self._settings.label_smoothing)
        shows_class = ~_shows_nothing(windows, draws)
        is_right = logits.detach().argmax(1).cpu().numpy() == windows.labels
        return BatchLoss(loss, int(is_right[shows_class].sum()), int(shows_class.sum()))

    def _targets(self, windows: Windows, draws: Draws | None) -> torch.Tensor:
        """The probabilities, (N, n_classes), that the model should give.

        The class of a window has probability 1. A window that shows nothing has the same
        probability for all classes (Hendrycks, Mazeika, Dietterich 2019, arXiv:1812.04606), so that
        no class is decided with confidence. With teachers, the target of a window that shows a
        class is the mean of two: its target without teachers, and the teachers' mean probabilities
        for the same window.
        """
        shows_nothing = _shows_nothing(windows, draws)
        targets = np.eye(self._n_classes, dtype=np.float32)[windows.labels]
        targets[shows_nothing] = 1.0 / self._n_classes
        target = torch.from_numpy(targets)
        if not self._teachers:
            return target
        logits = []
        with torch.no_grad():
            for teacher in self._teachers:
                teacher_draws = None if draws is None else on_pixels(draws, teacher.config)
                logits.append(teacher(windows, teacher_draws))
            teacher_mean = torch.softmax(torch.stack(logits), 2).mean(0)
        is_uniform = torch.from_numpy(shows_nothing)[:, None]
        return torch.where(is_uniform, target, (target + teacher_mean) / 2)

    def validate(self, pipeline: Pipeline) -> dict[str, float]:
        """Accuracy and loss on the held-out windows, for the history; empty if there are none."""
        return self.scores(pipeline, self._validation)

    def scores(self, pipeline: Pipeline, windows: Windows) -> dict[str, float]:
        """Accuracy and loss at the ends of windows, for the history; empty without windows.

        With `TrainSettings.balance`, the loss is the mean of the classes' mean losses.
        """
        if len(windows) == 0:
            return {}
        probabilities = class_probabilities(pipeline, windows)
        labels = windows.labels
        right_probabilities = probabilities[np.arange(len(labels)), labels]
        losses = -np.log(right_probabilities + 1e-12)
        groups = [losses]
        if self._settings.balance:
            groups = [losses[labels == label] for label in np.unique(labels)]
        return {
            "per_window": float((probabilities.argmax(1) == labels).mean()),
            "per_recording": share_right(confusion_by_recording(probabilities, windows)),
            "validation_loss": float(np.mean([group.mean() for group in groups])),
        }


def _shows_nothing(windows: Windows, draws: Draws | None) -> np.ndarray:
    """Whether each window shows no class: bool, (N,)."""
    if draws is None:
        return np.zeros(len(windows), bool)
    shows_nothing: np.ndarray = draws.content != SHOWN
    return shows_nothing


REACH = 0.15
"""Largest distance between an object and an answer that finds it, as a share of a recording's
shorter side. The answer must be of the object's class."""
N_SCENES = 400
"""Number of scenes in which a map model is scored, about."""


class SceneScores:
    """Scores how well a map model finds objects in scenes. The scenes are the same at each call.

    Parameters
    ----------
    crops : how the recordings' events become volumes.
    model : a map model for scenes of these recordings. Its weights are not used.
    windows : the objects of the scenes. About `N_SCENES` scenes are made of them, or fewer if there
        are too few windows.
    scenes : see `maker_of`. With it, an object is found within `REACH` of its own extent.
    """

    def __init__(
        self, crops: TNTConfig, model: Model, windows: Windows, scenes: TNTConfig | None = None
    ) -> None:
        assert model.places is not None
        self._classes = model.classes
        self._maker = maker_of(crops, scenes, windows)
        self._reader = ObjectReader(model.logits_shape, len(model.classes))
        self._tracks = new_tracks(model.places, model.logits_shape, 0)
        n_windows = round(N_SCENES * self._maker.n_windows)
        chosen = np.random.default_rng(0).permutation(len(windows))[:n_windows]
        self._windows = windows[chosen]
        self._within_px = REACH * min(crops.sensor)
        self._has_sizes = scenes is not None

    def after(self, pipeline: Pipeline, until_us: int | None = None) -> ObjectScores:
        """The scores of a map model at a moment of the windows.

        until_us : the moment, in microseconds since the windows' start; by default their end.
        """
        if until_us is None:
            until_us = self._maker.config.window_us
        rng = np.random.default_rng(1)  # the same scenes at each call
        was_training = pipeline.training
        pipeline.eval()
        n_classes = len(self._classes)
        scores = ObjectScores(*np.zeros((3, n_classes), np.int64))
        for first in range(0, len(self._windows), self._maker.at_once):
            windows = self._windows[first : first + self._maker.at_once]
            draws = unchanged(len(windows), self._maker.crops)
            draws.until_us[:] = until_us
            scenes = self._maker(windows, draws, rng)
            with torch.no_grad():
                maps = pipeline.classify(torch.from_numpy(scenes.volumes)).cpu().numpy()
            for k, logits in enumerate(maps):
                n = self._reader.read(logits, self._tracks, 0, False)
                objects = self._reader.found[: max(0, n)]  # n < 0: a logit is not finite
                is_in_scene = scenes.scene == k
                within_px: np.ndarray | float = self._within_px
                if self._has_sizes:
                    within_px = REACH * _extents(scenes.size[is_in_scene])
                scores += score_objects(
                    objects,
                    scenes.label[is_in_scene],
                    scenes.position[is_in_scene],
                    within_px,
                    n_classes,
                )
        pipeline.train(was_training)
        return scores

    def evaluate(self, pipeline: Pipeline) -> dict[str, Any]:
        """Score a map model at the windows' ends and before. Returns plain values, for JSON."""
        *early_us, _ = moments_us(self._maker.config.window_us)
        at_end = self.after(pipeline)
        early_f1 = {us: round(self.after(pipeline, us).f1, 5) for us in early_us}
        return {
            **at_end.to_dict(self._classes),
            "f1_against_time_ms": by_milliseconds(early_f1),
        }


def _extents(size: np.ndarray) -> np.ndarray:
    """What stands for a recording's shorter side, for objects of any size.

    Returns (N, 2), with the same number for x and for y.

    size : (N, 2), the width and height of the objects' boxes.
    """
    return np.repeat(size.max(axis=1, keepdims=True) / OF_RECORDING, 2, axis=1)


LEFT_OUT = 0.2
"""Largest distance to an object at which a place of the map may be left out of the loss, as a share
of a recording's shorter side.

The target of a place depends on the distance from the place to the nearest object. Up to `REACH`,
the target is the object's class. The place that is nearest to an object has the object's class at
any distance. Between `REACH` and `LEFT_OUT`, the place has no target and weight 0. Beyond
`LEFT_OUT`, the target is nothing."""
REACH_OF_SIZES = 0.1
"""What `REACH` is for the targets of objects of many sizes, as a share of an object's extent."""
LEFT_OUT_OF_SIZES = 0.25
"""What `LEFT_OUT` is for objects of many sizes."""
OBJECT_WEIGHT = 4.0
"""Weight in the loss of a place whose target is a class. A place whose target is nothing has weight
1."""
OBJECT_WEIGHT_OF_SIZES = 16.0
"""What `OBJECT_WEIGHT` is for objects of many sizes, of which most have a single place among more
than a thousand."""
LISTED_WEIGHT_OF_SIZES = 2.0
"""The weight of objects of many sizes with which the finished model decides what it lists.

A larger weight in the loss makes a network learn faster that there are objects, but it would also
list what is likely nothing. So the loss sees the logit of nothing less the logarithm of the ratio
of both weights (logit adjustment, Menon et al. 2021, arXiv:2007.07314)."""
LEAST_SIZE_PX = 1.0
"""The least width and height of an object from which the size is learned."""
SIZE_WEIGHT = 0.1
"""Weight of the mean loss of sizes, beside the mean loss of classes."""
BOX_WEIGHT = 0.3
"""Weight of the mean loss of sizes and middles, beside the mean loss of classes. With 1, classes
are learned more slowly, and fewer objects are found. With 0.1, boxes are less exact."""


class ObjectsInScenes:
    """The objective of a map model: the cross-entropy at each place of the maps of scenes.

    If maps have two channels for sizes, their loss is added: at places whose target is a class, the
    smooth absolute difference from the logarithms of the object's width and height, in places. If
    they have two more for middles, so is the difference from the way to the object's middle, in
    places. A place counts for a middle in inverse proportion to the object's extent.

    Parameters
    ----------
    config : how the recordings' events become volumes.
    validation : windows that are held out, for scenes on which F1 is measured; may be empty.
    settings : how the model is trained.
    classes : names, one for each label from 0 on.
    scenes : how the events of scenes become volumes, if their objects have many sizes, see
        `maker_of`.

    Raises
    ------
    ValueError : as `check_volume`; the network of `settings` computes no map.
    """

    def __init__(
        self,
        config: TNTConfig,
        validation: Windows,
        settings: TrainSettings,
        classes: tuple[str, ...],
        scenes: TNTConfig | None = None,
    ) -> None:
        self._maker = maker_of(config, scenes, validation)
        self.config = self._maker.config
        with torch.random.fork_rng(devices=[]):
            network = build_network(
                settings.network, config.channels, self.config.grid, len(classes)
            )
        model = Model.from_torch(network, self.config, classes)
        if model.places is None:
            raise ParameterValueError(
                "network",
                f"{settings.network} must compute a map of {len(classes) + 1} channels, or of "
                f"{len(classes) + 3} with the sizes of objects, or of {len(classes) + 5} with "
                "their middles, too",
            )
        self._places = model.places
        self._map_shape = model.logits_shape
        self._nothing = len(classes)  # its channel
        self._of_boxes = n_of_boxes(model.logits_shape[0], len(classes))
        self._shorter = min(config.sensor)
        self._has_extents = scenes is not None
        self._scorer = None
        if len(validation):
            self._scorer = SceneScores(config, model, validation, scenes)

    def loss(self, pipeline: Pipeline, windows: Windows, draws: Draws | None) -> BatchLoss:
        """The loss of scenes that are made of a batch of windows, augmented by `draws`."""
        # The seed depends on the windows or their draws, so that the same batch gives the same
        # scenes.
        if draws is None:
            rng = np.random.default_rng(windows.recording.tolist())
            draws = unchanged(len(windows), self._maker.crops)
        else:
            rng = np.random.default_rng(draws.seed[:1])
        scenes = self._maker(windows, draws, rng)
        maps = pipeline.classify(torch.from_numpy(scenes.volumes))
        logits = maps[:, : self._nothing + 1]
        if self._has_extents:
            ratio = OBJECT_WEIGHT_OF_SIZES / LISTED_WEIGHT_OF_SIZES
            less = torch.zeros(1, self._nothing + 1, 1, 1, device=logits.device)
            less[:, self._nothing] = math.log(ratio)
            logits = logits - less
        targets, weights, boxes = self._targets(scenes)
        target = torch.from_numpy(targets)
        weight = torch.from_numpy(weights).to(logits.device)
        losses = F.cross_entropy(logits, target.to(logits.device), reduction="none")
        is_object = target < self._nothing
        is_right = logits.detach().argmax(1).cpu() == target
        loss = (losses * weight).sum() / weight.sum()
        if self._of_boxes and is_object.any():
            places = is_object.to(logits.device)
            found = maps[:, -self._of_boxes :].movedim(1, -1)[places]  # (objects' places, 2 or 4)
            wanted = torch.from_numpy(boxes).to(logits.device)[places][:, : self._of_boxes]
            loss = loss + self._loss_of_boxes(found, wanted)
        return BatchLoss(loss, int(is_right[is_object].sum()), int(is_object.sum()))

    def _loss_of_boxes(self, found: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """The loss of boxes at N places: of sizes (N, 2), or of sizes and middles (N, 4)."""
        sizes = F.smooth_l1_loss(found[:, :2], wanted[:, :2], beta=0.1)
        if self._of_boxes == 2:
            return SIZE_WEIGHT * sizes
        # a middle is as wrong as its distance is in sizes of the object
        sides = wanted[:, :2].exp()
        middles = F.smooth_l1_loss(found[:, 2:] / sides, wanted[:, 2:] / sides, beta=0.1)
        return BOX_WEIGHT * (sizes + middles)

    def _targets(self, scenes: Scenes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Target and weight of each place of M maps, int64 and float32, (M, R, C), and boxes.

        M is the number of scenes. See `LEFT_OUT` and `OBJECT_WEIGHT`. Boxes are of the object that
        a place is about: the logarithms of the width and height in places, and how many places to
        the right and down its middle is, float32, (M, R, C, 4).
        """
        _, rows, columns = self._map_shape
        nothing = self._nothing
        shape = len(scenes.volumes), rows, columns
        target = np.full(shape, nothing, np.int64)
        weight = np.ones(shape, np.float32)
        boxes = np.zeros((*shape, 4), np.float32)
        # the distance from each place to the nearest object, in extents of that object
        nearest = np.full(shape, np.inf)
        # place (row, column) of a map is at (x0 + dx column, y0 + dy row), in sensor pixels
        x0, dx, y0, dy = self._places
        log_sizes = np.log(np.maximum(scenes.size, LEAST_SIZE_PX) / (dx, dy))
        extents = np.full(len(log_sizes), float(self._shorter))
        reach = REACH
        left_out = LEFT_OUT
        object_weight = OBJECT_WEIGHT
        if self._has_extents:
            extents = np.maximum(_extents(scenes.size)[:, 0], LEAST_SIZE_PX)
            reach = REACH_OF_SIZES
            left_out = LEFT_OUT_OF_SIZES
            object_weight = OBJECT_WEIGHT_OF_SIZES
        for scene, label, (x, y), log_size, extent in zip(
            scenes.scene, scenes.label, scenes.position, log_sizes, extents, strict=True
        ):
            aside = (x - x0) / dx - np.arange(columns)  # in places
            down = (y - y0) / dy - np.arange(rows)
            distance_x = dx * np.abs(aside) / extent
            distance_y = dy * np.abs(down) / extent
            distance = np.maximum(distance_y[:, None], distance_x)  # (R, C)
            # the nearest place gets the object's class at any distance
            row, column = divmod(int(distance.argmin()), columns)
            distance[row, column] = 0.0
            is_nearer = distance < nearest[scene]
            nearest[scene][is_nearer] = distance[is_nearer]
            is_target = is_nearer & (distance <= reach)
            target[scene][is_target] = label
            rows_of, columns_of = np.nonzero(is_target)
            boxes[scene, rows_of, columns_of, :2] = log_size
            boxes[scene, rows_of, columns_of, 2] = aside[columns_of]
            boxes[scene, rows_of, columns_of, 3] = down[rows_of]
        weight[nearest <= left_out] = 0.0
        weight[target < nothing] = object_weight
        return target, weight, boxes

    def validate(self, pipeline: Pipeline) -> dict[str, float]:
        """F1 in held-out scenes, for the history; empty if nothing is held out."""
        return {} if self._scorer is None else {"f1": self._scorer.after(pipeline).f1}
