"""How well a map model finds objects in scenes of windows."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from async_tnt.config import TNTConfig
from async_tnt.evaluation.object_scores import ObjectScores, score_objects
from async_tnt.networks.model import Model
from async_tnt.networks.objects import ObjectReader, new_tracks
from async_tnt.training.augment import unchanged
from async_tnt.training.pipeline import Pipeline
from async_tnt.training.scenes import OBJECTS, SceneMaker
from async_tnt.training.windows import Windows

REACH = 0.15
"""Of a recording's shorter side: an object counts as found where one of its class is found so near."""
N_SCENES = 400
BATCH = 64
SHARES = 0.3, 0.5
"""Of a window, after which scenes are also scored."""


class SceneScores:
    """Scenes that are the same at each call.

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

    def f1(self, pipeline: Pipeline) -> float:
        """At the windows' ends."""
        return self.after(pipeline, 1.0).f1

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
                scores += score_objects(objects, scenes.label[inside], scenes.position[inside], self._within, n_classes)
        pipeline.train(was_training)
        return scores

    def to_dict(self, pipeline: Pipeline) -> dict[str, Any]:
        """Plain values, for JSON."""
        whole = self.after(pipeline, 1.0)
        early = {share: self.after(pipeline, share).f1 for share in SHARES}
        window_ms = self._maker.config.window_us / 1e3
        return {
            **whole.to_dict(self._classes),
            "f1_against_time_ms": {f"{share * window_ms:g}": round(f1, 5) for share, f1 in early.items()},
        }
