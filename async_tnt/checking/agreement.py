"""Whether a model's exported classifier agrees with its compiled one, on volumes like those they will see."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from async_tnt.checking.equality import LOGIT_BOUND, Comparison, closed_volumes, same_class
from async_tnt.events import EVENT_DTYPE
from async_tnt.networks.compiled import CompiledClassifier, CompiledRegressor
from async_tnt.networks.model import Model
from async_tnt.progress import progress
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.window_classifier import Classifier

N_WINDOWS = 3  # of a recording
N_MADE = 2  # streams for sensors other than the samples'


@dataclass
class Agreement:
    """How far two engines differ on some windows."""

    recordings: str
    """`bundled samples`, or `made streams` for sensors of another size."""
    logits: Comparison = field(default_factory=lambda: Comparison("logits", "", LOGIT_BOUND))
    """Differences, as a share of the window's largest logit where that is above 1."""
    plain_logits: Comparison = field(default_factory=lambda: Comparison("logits", "", math.inf))
    """The same differences, absolute, for the report."""
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
    streams, recordings = list(_samples(model)), "bundled samples"
    if not streams:
        streams, recordings = list(_made(model)), "made streams"
    agreement = Agreement(recordings)
    compiled = CompiledClassifier(model)
    regressor = CompiledRegressor(model) if config.needs_regressor else None
    with progress(len(streams), "checking") as bar:
        for events in streams:
            for _, volume in closed_volumes(events, config, 0, None, regressor):
                ours, theirs = compiled(volume), np.asarray(classifier(volume))
                difference = float(np.abs(ours - theirs).max())
                agreement.plain_logits.add(difference)
                largest = max(1.0, float(np.abs(ours).max()))
                agreement.logits.add(difference / largest)
                agreement.n_differ += not same_class(ours, theirs, LOGIT_BOUND * largest)
            bar.update()
    return agreement


def _samples(model: Model) -> Iterator[np.ndarray]:
    """The first windows of each bundled sample, where they are of the model's sensor."""
    for path in sample_recordings().values():
        recording = open_recording(path)
        if recording.sensor == model.config.sensor:
            events = recording.read()
            yield events[events["t"] < events["t"][0] + N_WINDOWS * model.config.window_us]


def _made(model: Model) -> Iterator[np.ndarray]:
    """An edge that moves over the sensor, among noise; seeded."""
    (width, height), n = model.config.sensor, 4000
    for seed in range(N_MADE):
        rng = np.random.default_rng(seed)
        events = np.zeros(n, EVENT_DTYPE)
        events["t"] = np.sort(rng.integers(0, N_WINDOWS * model.config.window_us, n))
        along = events["t"] / (N_WINDOWS * model.config.window_us)
        edge = (0.25 + 0.5 * along + rng.normal(0, 0.02, n)) * (width - 1)
        noise = rng.random(n) < 0.3
        events["x"] = np.where(noise, rng.integers(0, width, n), edge.round().clip(0, width - 1))
        events["y"] = rng.integers(0, height, n)
        events["p"] = np.where(noise, rng.integers(0, 2, n), events["x"] > edge)
        yield events
