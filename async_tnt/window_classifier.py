"""WindowClassifier: any classifier, its class names, and its decisions about windows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from async_tnt.checks import one_line, short
from async_tnt.config import TNTConfig
from async_tnt.decision import Decision, Trigger
from async_tnt.events import Columns
from async_tnt.kernels import trigger as T
from async_tnt.kernels.classify import DECISION_FIELDS, FULL, NOT_FINITE, softmax
from async_tnt.networks.compiled import CompiledClassifier, CompiledRegressor
from async_tnt.networks.model import Model
from async_tnt.volume import TNTVolume

Classifier = Callable[[np.ndarray], Any]
TRIGGER_NAMES: dict[int, Any] = {
    T.LOOK: "",
    T.BY_EVENTS: "every_events",
    T.BY_ACTIVITY: "activity",
    T.BY_CONFIDENCE: "confidence",
}
ROWS = 256  # decisions made in one compiled call, at most


def networks_of(
    model: Model | TNTConfig, classifier: Classifier | None, regressor: Any, classes: Sequence[str] | None
) -> tuple[TNTConfig, Classifier, Any, Sequence[str] | None]:
    """Configuration, classifier, regressor and class names: those passed, otherwise those of the model."""
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


class WindowClassifier:
    """A classifier and its class names.

    Parameters
    ----------
    config : TNTConfig of the volumes.
    classifier, classes : see `Processor`.

    Attributes
    ----------
    classes : class names; if none were given, "0", "1", ... after the first answer.
    decides_in_stretches : whether `decide_stretch` can be called.
    """

    def __init__(self, config: TNTConfig, classifier: Classifier, classes: Sequence[str] | None) -> None:
        if isinstance(classes, str):
            raise TypeError(f"`classes` must be a sequence of names, got the single string {short(classes)}")
        self._config = config
        self.classes = None if classes is None else tuple(classes)
        self.classifier = classifier

    @property
    def classifier(self) -> Classifier:
        """The callable from a volume to logits; a new one must take volumes of the configuration's shape."""
        return self._classifier

    @classifier.setter
    def classifier(self, classifier: Classifier) -> None:
        if not callable(classifier):
            raise TypeError(f"`classifier` must be callable, got {type(classifier).__name__}")
        compiled = classifier if type(classifier) is CompiledClassifier else None  # subclasses may behave differently
        if compiled is not None and compiled.shape != self._config.shape:
            shape = compiled.shape
            raise ValueError(f"`classifier` must take volumes of shape {self._config.shape}, got one for {shape}")
        self._classifier, self._compiled = classifier, compiled
        self.decides_in_stretches = compiled is not None and not self._config.needs_replay

    def decide(
        self, volume: TNTVolume, trigger: Trigger, complete: bool = False, confidence: float | None = None
    ) -> Decision:
        """The decision about a volume's open window.

        Parameters
        ----------
        confidence : if the likeliest class has this probability, the decision is complete, its trigger `confidence`.

        Raises
        ------
        ValueError : there is not one finite logit for each class. What the classifier raises passes through.
        """
        if self._compiled is not None:
            index, logits, probabilities = self._compiled.answer(volume)
        else:
            try:
                logits = np.asarray(self._classifier(volume.array)).astype(np.float32).reshape(-1)  # a copy
            except Exception as error:
                if not hasattr(self._classifier, "state_dict"):
                    raise
                raise TypeError(
                    "`classifier` must take an array (C, H, W); a torch module is wrapped, TorchClassifier(module), or "
                    f"compiled, Model.from_torch(module, config, classes): it failed with {one_line(error)!r}"
                ) from error
            probabilities = np.empty(logits.size)
            index = softmax(logits, probabilities) if logits.size else -1
        classes = self._classes_for(logits.size)
        if index < 0:
            raise _not_finite(logits)
        if confidence is not None and probabilities[index] >= confidence:
            trigger, complete = "confidence", True
        n_events, start_us = volume.n_events, volume.start_us
        time_us = volume.newest_us if n_events else start_us
        return Decision(classes[index], index, probabilities, logits, start_us, time_us, n_events, complete, trigger)

    def decide_stretch(
        self, volume: TNTVolume, triggers: np.ndarray, columns: Columns, first: int, last: int
    ) -> tuple[int, list[Decision], ValueError | None]:
        """Add events to a volume and decide whenever one of them makes that due, in compiled code, without the GIL.

        Parameters
        ----------
        triggers : float64, see `kernels.trigger`.
        columns, first, last : the events `first <= i < last`.

        Returns
        -------
        absorbed : int. The first event not added: `last`, the first past the volume's limit, or the one after a
            decision that reached the level of confidence.
        decisions : list. In order.
        error : where the next decision would have had logits that are not finite.
        """
        assert self._compiled is not None
        classes = self._classes_for(self._compiled.n_classes)
        n_classes = len(classes)
        blocks = []
        absorbed, end = first, FULL
        while end == FULL:
            n_rows = last - absorbed
            every_events = int(triggers.view(np.int64)[T.EVERY_EVENTS])
            if triggers[T.THRESHOLD] == np.inf and every_events:
                n_rows = n_rows // every_events + 1
            logits = np.empty((min(ROWS, n_rows), n_classes), np.float32)
            probabilities = np.empty(logits.shape)
            notes = np.empty((len(logits), DECISION_FIELDS), np.int64)
            absorbed, n, end = self._compiled.decide_stretch(
                volume.buffer, columns, absorbed, last, triggers, logits, probabilities, notes
            )
            blocks.append((notes[:n].tolist(), probabilities, logits))
        start_us, trigger_names = volume.start_us, TRIGGER_NAMES
        decisions = [
            Decision(
                classes[index],
                index,
                block_probabilities[k],
                block_logits[k],
                start_us,
                time_us,
                n_events,
                why == T.BY_CONFIDENCE,
                trigger_names[why],
            )
            for rows, block_probabilities, block_logits in blocks
            for k, (n_events, time_us, why, index) in enumerate(rows)
        ]
        return absorbed, decisions, _not_finite(logits[n]) if end == NOT_FINITE else None

    def _classes_for(self, n: int) -> tuple[str, ...]:
        if n == 0:
            raise ValueError("`classifier` must return logits, got none")
        if self.classes is None:
            self.classes = tuple(str(k) for k in range(n))
        if n != len(self.classes):
            raise ValueError(f"`classifier` must return {len(self.classes)} logits, one for each class, got {n}")
        return self.classes


def _not_finite(logits: np.ndarray) -> ValueError:
    return ValueError(f"`classifier` must return finite logits, got {short(logits.tolist())}")
