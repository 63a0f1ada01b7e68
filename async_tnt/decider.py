"""Decider: asks the classifier, and makes decisions of its answers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.decision import Decision
from async_tnt.events import Columns
from async_tnt.kernels import trigger as T
from async_tnt.kernels.classify import DECISION_FIELDS, FULL, NOT_FINITE, absorb_and_decide, softmax
from async_tnt.landmark_at_read import Regressor
from async_tnt.networks.classifier import CompiledClassifier
from async_tnt.networks.model import Model
from async_tnt.networks.regressor import CompiledRegressor
from async_tnt.triggers import Triggers
from async_tnt.volume import TNTVolume
from async_tnt.windows import OpenWindows

Classifier = Callable[[np.ndarray], Any]
WHY = {T.BY_EVENTS: "every_events", T.BY_ACTIVITY: "activity", T.BY_CONFIDENCE: "confidence"}
ROWS = 256  # decisions made in one compiled call, at most


def networks_of(
    model: Model | TNTConfig, classifier: Classifier | None, regressor: Regressor | None, classes: Sequence[str] | None
) -> tuple[TNTConfig, Classifier, Regressor | None, Sequence[str] | None]:
    """What decides: what was passed, and else the model's own."""
    if isinstance(model, Model):
        classes = model.classes if classes is None else classes
        classifier = CompiledClassifier(model) if classifier is None else classifier
        if regressor is None and model.config.needs_regressor:
            regressor = CompiledRegressor(model)
        return model.config, classifier, regressor, classes
    if not isinstance(model, TNTConfig):
        raise TypeError(
            f"`model` must be a Model or a TNTConfig, got {type(model).__name__}; load_model(name) loads one"
        )
    if classifier is None:
        raise TypeError("`classifier` is missing: a TNTConfig alone cannot decide; pass a Model or a callable")
    return model, classifier, regressor, classes


class Decider:
    """A classifier and its class names.

    Parameters
    ----------
    config : TNTConfig of the volumes to come.
    classifier, classes : see `Processor`.
    """

    def __init__(self, config: TNTConfig, classifier: Classifier, classes: Sequence[str] | None) -> None:
        self._config = config
        self._classes = None if classes is None else tuple(classes)
        self.classifier = classifier

    @property
    def classifier(self) -> Classifier:
        return self._classifier

    @classifier.setter
    def classifier(self, classifier: Classifier) -> None:
        if not callable(classifier):
            raise TypeError(f"`classifier` must be callable, got {type(classifier).__name__}")
        compiled = classifier if type(classifier) is CompiledClassifier else None  # a subclass may do otherwise
        if compiled is not None and compiled.shape != self._config.shape:
            shape = compiled.shape
            raise ValueError(f"`classifier` must take volumes of shape {self._config.shape}, got one for {shape}")
        self._classifier, self._compiled = classifier, compiled

    @property
    def classes(self) -> tuple[str, ...] | None:
        """As named, or else known from the first answer on."""
        return self._classes

    def decide(self, volume: TNTVolume, trigger: str, complete: bool = False, level: float | None = None) -> Decision:
        """What the classifier says of a volume's open window.

        level : of confidence. Where the likeliest class has this probability, the decision is complete, and its
            trigger `confidence`.

        Raises
        ------
        ValueError : there is not one finite logit for each class. What the classifier raises passes through.
        """
        if self._compiled is not None:
            index, logits, probabilities = self._compiled.answer(volume)
        else:
            logits = np.asarray(self._classifier(volume.array)).astype(np.float32).reshape(-1)  # a copy
            probabilities = np.empty(logits.size)
            index = softmax(logits, probabilities) if logits.size else -1
        classes = self._classes_for(logits.size)
        if index < 0:
            raise _not_finite(logits)
        if level is not None and probabilities[index] >= level:
            trigger, complete = "confidence", True
        n_events, start_us = volume.n_events, volume.start_us
        time_us = volume.newest_us if n_events else start_us
        return Decision(classes[index], index, probabilities, logits, start_us, time_us, n_events, complete, trigger)

    def take(
        self, windows: OpenWindows, triggers: Triggers, columns: Columns, first: int, last: int
    ) -> tuple[int, list[Decision]]:
        """Add events to all open windows and decide where a trigger that looks at each event makes that due, up to
        the moment when something else has to happen.

        Returns
        -------
        taken : int. The first event not added.
        decisions : list. The last one is complete if it reached the level of confidence: its window is to be closed.
        """
        if self._compiled is not None and not self._config.needs_replay:
            return self._take_compiled(self._compiled, windows, triggers, columns, first, last)
        oldest = windows.oldest
        n_before = oldest.n_events
        stop, fires = T.advance_triggers(triggers.state, oldest.buffer, columns.t, first, last)
        taken = windows.take(columns, first, stop)
        n_events = oldest.n_events
        trigger = "activity" if fires else ""
        if triggers.every_events is not None and n_events % triggers.every_events == 0:
            trigger = "every_events"
        if n_events == n_before or not (trigger or triggers.each_event):
            return taken, []
        decision = self.decide(oldest, trigger, level=triggers.confidence)
        return taken, [decision] if decision.trigger else []

    def _take_compiled(
        self,
        classifier: CompiledClassifier,
        windows: OpenWindows,
        triggers: Triggers,
        columns: Columns,
        first: int,
        last: int,
    ) -> tuple[int, list[Decision]]:
        """The same in compiled code, from decision to decision, with the GIL released."""
        classes = self._classes_for(classifier.n_classes)
        oldest = windows.oldest
        before = oldest.n_late, oldest.n_decided
        made = []
        taken, end = first, FULL
        while end == FULL:
            n_rows = last - taken
            if triggers.activity is None and triggers.every_events is not None:
                n_rows = n_rows // triggers.every_events + 1
            logits = np.empty((min(ROWS, n_rows), classifier.n_classes), np.float32)
            probabilities = np.empty(logits.shape)
            notes = np.empty((len(logits), DECISION_FIELDS), np.int64)
            taken, n, end = absorb_and_decide(
                oldest.buffer,
                *columns[:4],
                taken,
                last,
                triggers.state,
                *classifier.network,
                logits,
                probabilities,
                notes,
            )
            made.append((notes[:n].tolist(), probabilities, logits))
        if windows.overlap:
            windows.note_taken(columns, first, taken, before)
        if end == NOT_FINITE:
            raise _not_finite(logits[n])
        start_us = oldest.start_us
        return taken, [
            Decision(
                classes[index],
                index,
                chunk_probabilities[k],
                chunk_logits[k],
                start_us,
                time_us,
                n_events,
                why == T.BY_CONFIDENCE,
                WHY[why],
            )
            for rows, chunk_probabilities, chunk_logits in made
            for k, (n_events, time_us, why, index) in enumerate(rows)
        ]

    def _classes_for(self, n: int) -> tuple[str, ...]:
        """The names of n classes, from the first answer on where nobody named them."""
        if n == 0:
            raise ValueError("`classifier` must return logits, got none")
        if self._classes is None:
            self._classes = tuple(str(k) for k in range(n))
        if n != len(self._classes):
            raise ValueError(f"`classifier` must return {len(self._classes)} logits, one for each class, got {n}")
        return self._classes


def _not_finite(logits: np.ndarray) -> ValueError:
    return ValueError(f"`classifier` must return finite logits, got {logits.tolist()}")
