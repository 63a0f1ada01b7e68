"""What a training minimizes, and what it measures after each epoch.

`ClassOfWindows` is for classifiers, `ObjectsInScenes` for map models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F

from async_tnt.base.checks import ParameterValueError
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
SHARES = (0.3, 0.5)
"""Moments at which scenes are scored besides a window's end, as shares of the window."""


class SceneScores:
    """Scores how well a map model finds objects in scenes. The scenes are the same at each call.

    Parameters
    ----------
    crops : how the recordings' events become volumes.
    model : a map model for scenes of these recordings. Its weights are not used.
    windows : the objects of the scenes. About `N_SCENES` scenes are made of them, or fewer if there
        are too few windows.
    """

    def __init__(self, crops: TNTConfig, model: Model, windows: Windows) -> None:
        assert model.places is not None
        self._classes = model.classes
        self._maker = SceneMaker(crops)
        self._reader = ObjectReader(model.logits_shape, len(model.classes))
        self._tracks = new_tracks(model.places, model.logits_shape, 0)
        chosen = np.random.default_rng(0).permutation(len(windows))[: round(N_SCENES * OBJECTS)]
        self._windows = windows[chosen]
        self._within_px = REACH * min(crops.sensor)

    def after(self, pipeline: Pipeline, share: float) -> ObjectScores:
        """The scores of a map model when this share of each window has passed."""
        rng = np.random.default_rng(1)  # the same scenes at each call
        was_training = pipeline.training
        pipeline.eval()
        n_classes = len(self._classes)
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
                objects = self._reader.found[: max(0, n)]  # n < 0: a logit is not finite
                is_in_scene = scenes.scene == k
                scores += score_objects(
                    objects,
                    scenes.label[is_in_scene],
                    scenes.position[is_in_scene],
                    self._within_px,
                    n_classes,
                )
        pipeline.train(was_training)
        return scores

    def evaluate(self, pipeline: Pipeline) -> dict[str, Any]:
        """Score a map model at the windows' ends and before. Returns plain values, for JSON."""
        at_end = self.after(pipeline, 1.0)
        window_ms = self._maker.config.window_us / 1e3
        early_f1 = {}
        for share in SHARES:
            early_f1[f"{share * window_ms:g}"] = round(self.after(pipeline, share).f1, 5)
        return {**at_end.to_dict(self._classes), "f1_against_time_ms": early_f1}


LEFT_OUT = 0.2
"""Largest distance to an object at which a place of the map may be left out of the loss, as a share
of a recording's shorter side.

The target of a place depends on the distance from the place to the nearest object. Up to `REACH`,
the target is the object's class. The place that is nearest to an object has the object's class at
any distance. Between `REACH` and `LEFT_OUT`, the place has no target and weight 0. Beyond
`LEFT_OUT`, the target is nothing."""
OBJECT_WEIGHT = 4.0
"""Weight in the loss of a place whose target is a class. A place whose target is nothing has weight
1."""
LEAST_SIZE_PX = 1.0
"""The least width and height of an object from which the size is learned."""
SIZE_WEIGHT = 0.1
"""Weight of the mean loss of sizes, beside the mean loss of classes."""


class ObjectsInScenes:
    """The objective of a map model: the cross-entropy at each place of the maps of scenes.

    If maps have two channels for sizes, their loss is added: at places whose target is a class, the
    smooth absolute difference from the logarithms of the object's width and height, in places.

    Parameters
    ----------
    config : how the recordings' events become volumes.
    validation : windows that are held out, for scenes on which F1 is measured; may be empty.
    settings : how the model is trained.
    classes : names, one for each label from 0 on.

    Raises
    ------
    ValueError : as `SceneMaker`; the network of `settings` computes no map.
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
            raise ParameterValueError(
                "network",
                f"{settings.network} must compute a map of {len(classes) + 1} channels, or of "
                f"{len(classes) + 3} with the sizes of objects",
            )
        self._places = model.places
        self._map_shape = model.logits_shape
        self._nothing = len(classes)  # its channel
        self._has_sizes = model.logits_shape[0] == len(classes) + 3
        self._shorter = min(config.sensor)
        self._scorer = SceneScores(config, model, validation) if len(validation) else None

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
        targets, weights, sizes = self._targets(scenes)
        target = torch.from_numpy(targets)
        weight = torch.from_numpy(weights).to(logits.device)
        losses = F.cross_entropy(logits, target.to(logits.device), reduction="none")
        is_object = target < self._nothing
        is_right = logits.detach().argmax(1).cpu() == target
        loss = (losses * weight).sum() / weight.sum()
        if self._has_sizes and is_object.any():
            places = is_object.to(logits.device)
            found = maps[:, -2:].movedim(1, -1)[places]  # (objects' places, 2)
            wanted = torch.from_numpy(sizes).to(logits.device)[places]
            loss = loss + SIZE_WEIGHT * F.smooth_l1_loss(found, wanted, beta=0.1)
        return BatchLoss(loss, int(is_right[is_object].sum()), int(is_object.sum()))

    def _targets(self, scenes: Scenes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Target and weight of each place of M maps, int64 and float32, (M, R, C), and sizes.

        M is the number of scenes. See `LEFT_OUT` and `OBJECT_WEIGHT`. Sizes are the logarithms of
        the width and height, in places, of the object that a place is about: float32,
        (M, R, C, 2).
        """
        _, rows, columns = self._map_shape
        nothing = self._nothing
        shape = len(scenes.volumes), rows, columns
        target = np.full(shape, nothing, np.int64)
        weight = np.ones(shape, np.float32)
        sizes = np.zeros((*shape, 2), np.float32)
        nearest = np.full(shape, np.inf)  # the distance from each place to the nearest object
        # place (row, column) of a map is at (x0 + dx column, y0 + dy row), in sensor pixels
        x0, dx, y0, dy = self._places
        log_sizes = np.log(np.maximum(scenes.size, LEAST_SIZE_PX) / (dx, dy))
        for scene, label, (x, y), log_size in zip(
            scenes.scene, scenes.label, scenes.position, log_sizes, strict=True
        ):
            distance_x = np.abs(x0 + dx * np.arange(columns) - x)
            distance_y = np.abs(y0 + dy * np.arange(rows) - y)
            distance = np.maximum(distance_y[:, None], distance_x)  # (R, C)
            # the nearest place gets the object's class at any distance
            row, column = divmod(int(distance.argmin()), columns)
            distance[row, column] = 0.0
            is_nearer = distance < nearest[scene]
            nearest[scene][is_nearer] = distance[is_nearer]
            is_target = is_nearer & (distance <= REACH * self._shorter)
            target[scene][is_target] = label
            sizes[scene][is_target] = log_size
        weight[nearest <= LEFT_OUT * self._shorter] = 0.0
        weight[target < nothing] = OBJECT_WEIGHT
        return target, weight, sizes

    def validate(self, pipeline: Pipeline) -> dict[str, float]:
        """F1 in held-out scenes, for the history; empty if nothing is held out."""
        return {} if self._scorer is None else {"f1": self._scorer.after(pipeline, 1.0).f1}
