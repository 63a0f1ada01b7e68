"""Whether a model's exported classifier agrees with its compiled one, on volumes like those they will see."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from async_tnt.checking.equality import LOGIT_BOUND, Comparison, closed_volumes, same_class
from async_tnt.config import TNTConfig
from async_tnt.events import EVENT_DTYPE
from async_tnt.networks.compiled import CompiledClassifier, CompiledRegressor
from async_tnt.networks.model import Model
from async_tnt.progress import progress
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.window_classifier import Classifier

N_WINDOWS = 3  # of a recording
N_MADE = 3  # streams for sensors other than the samples'


@dataclass
class Agreement:
    """How far two engines differ on some windows."""

    recordings: str
    """`bundled samples`, or `made streams` for sensors of another size."""
    logits: Comparison = field(default_factory=lambda: Comparison("logits", "", LOGIT_BOUND))
    """Differences, as a share of the window's largest logit where that is above 1."""
    n_differ: int = 0
    """Windows of another class, but for ties within the bound."""

    @property
    def holds(self) -> bool:
        return self.logits.holds and self.n_differ == 0


def compare_engines(model: Model, classifier: Classifier) -> Agreement:
    """Compare a classifier with the model's compiled one, on windows of the bundled samples, or of made streams if the
    model is for another sensor.
    """
    config = model.config
    streams, recordings = streams_for(config)
    agreement = Agreement(recordings)
    compiled = CompiledClassifier(model)
    regressor = CompiledRegressor(model) if config.needs_regressor else None
    with progress(len(streams), "checking") as bar:
        for events in streams:
            first = events[events["t"] < events["t"][0] + N_WINDOWS * config.window_us]
            for _, volume in closed_volumes(first, config, 0, None, regressor):
                ours, theirs = compiled(volume), np.asarray(classifier(volume))
                largest = max(1.0, float(np.abs(ours).max()))
                agreement.logits.add(float(np.abs(ours - theirs).max()) / largest)
                agreement.n_differ += not same_class(ours, theirs, LOGIT_BOUND * largest)
            bar.update()
    return agreement


def streams_for(config: TNTConfig) -> tuple[list[np.ndarray], str]:
    """Events of the bundled samples, or of made streams where the sensor is another; and which of both."""
    opened = [open_recording(path) for path in sample_recordings().values()]
    if all(recording.sensor == config.sensor for recording in opened):
        return [recording.read() for recording in opened], "bundled samples"
    return [_made(config, seed) for seed in range(N_MADE)], "made streams"


def _made(config: TNTConfig, seed: int) -> np.ndarray:
    """An edge that moves over the sensor, among noise; seeded."""
    (width, height), n, duration_us = config.sensor, 4000, N_WINDOWS * config.window_us
    rng = np.random.default_rng(seed)
    events = np.zeros(n, EVENT_DTYPE)
    events["t"] = np.sort(rng.integers(0, duration_us, n))
    edge = (0.25 + 0.5 * events["t"] / duration_us + rng.normal(0, 0.02, n)) * (width - 1)
    noise = rng.random(n) < 0.3
    events["x"] = np.where(noise, rng.integers(0, width, n), edge.round().clip(0, width - 1))
    events["y"] = rng.integers(0, height, n)
    events["p"] = np.where(noise, rng.integers(0, 2, n), events["x"] > edge)
    return events
