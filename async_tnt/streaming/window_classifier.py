"""WindowClassifier: any classifier, its class names, and its decisions about windows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.checks import one_line, short
from async_tnt.kernels.decisions import trigger as T
from async_tnt.kernels.decisions.classify import DECISION_FIELDS, FULL, NOT_FINITE, softmax
from async_tnt.kernels.decisions.objects import N_KNOWN, NEXT_NUMBER
from async_tnt.networks.loading import load_model
from async_tnt.networks.models.compiled import CompiledClassifier, CompiledRegressor
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.objects import (
    LOGITS,
    ObjectReader,
    even_places,
    logits_shape,
    new_tracks,
)
from async_tnt.streaming.decision import Decision, Object, Trigger
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.events import Columns
from async_tnt.volume.volume import TNTVolume

Classifier = Callable[[np.ndarray], Any]
TRIGGER_NAMES: dict[int, Any] = {
    T.ONLY_IF_SURE: "",  # decided BY_CONFIDENCE, or not at all
    T.BY_EVENTS: "every_events",
    T.BY_CONFIDENCE: "confidence",
    T.BY_TIME: "every_us",
}
ROWS = 256  # decisions made in one compiled call, at most
# events for which such a call is worth its time where decisions are due by time alone
STRETCH = 500


def networks_of(
    model: Model | TNTConfig | str | Path,
    classifier: Classifier | None,
    regressor: Any,
    classes: Sequence[str] | None,
) -> tuple[TNTConfig, Classifier, Any, Sequence[str] | None]:
    """Configuration, classifier, regressor and class names: those passed, otherwise those of the
    model."""
    if isinstance(model, (str, Path)):
        model = load_model(model)
    if isinstance(model, Model):
        classes = model.classes if classes is None else classes
        classifier = CompiledClassifier(model) if classifier is None else classifier
        if regressor is None and model.config.needs_regressor:
            regressor = CompiledRegressor(model)
        return model.config, classifier, regressor, classes
    if not isinstance(model, TNTConfig):
        raise TypeError(
            f"`model` must be a Model, the name or path of one, or a TNTConfig, got "
            f"{type(model).__name__}"
        )
    if classifier is None:
        raise TypeError(
            "`classifier` is missing: a TNTConfig alone cannot decide; pass a Model or a callable"
        )
    return model, classifier, regressor, classes


class WindowClassifier:
    """A classifier and its class names.

    Parameters
    ----------
    config : TNTConfig of the volumes.
    classifier, classes, confidence : see `Processor`.

    Attributes
    ----------
    classifier : the callable from a volume to logits.
    classes : class names; if none were given, "0", "1", ... after the first answer.
    decides_in_stretches : whether `decide_stretch` can be called.
    """

    def __init__(
        self,
        config: TNTConfig,
        classifier: Classifier,
        classes: Sequence[str] | None,
        confidence: float | None = None,
    ) -> None:
        if isinstance(classes, str):
            raise TypeError(
                f"`classes` must be a sequence of names, got the single string {short(classes)}"
            )
        self._config = config
        self.classes = None if classes is None else tuple(classes)
        self._reader: ObjectReader | None = None
        self._tracks = np.empty((0, 4))
        self.exchange(classifier, confidence)

    def exchange(self, classifier: Classifier, confidence: float | None = None) -> None:
        """Use another callable: one that takes volumes of the configuration's shape, and fits
        `confidence`, if set."""
        if not callable(classifier):
            raise TypeError(f"`classifier` must be callable, got {type(classifier).__name__}")
        # subclasses may behave differently
        compiled = classifier if type(classifier) is CompiledClassifier else None
        if compiled is not None and compiled.shape != self._config.shape:
            shape = compiled.shape
            raise ValueError(
                f"`classifier` must take volumes of shape {self._config.shape}, got one for {shape}"
            )
        if compiled is not None and self.classes is not None:
            self._classes_for(compiled.n_classes)
        if (
            compiled is not None
            and compiled.places is not None
            and compiled.sensor != self._config.sensor
        ):
            raise ValueError(
                f"`classifier` must be for the sensor {self._config.sensor}, in whose pixels "
                "objects stand, got one "
                f"for {compiled.sensor}"
            )
        of_map: Any = () if compiled is not None else getattr(classifier, "logits_shape", ())
        reader = (
            compiled.reader
            if compiled is not None
            else ObjectReader(of_map)
            if len(of_map) == 3
            else None
        )
        _check_confidence(reader, confidence)
        tracks = self._new_tracks(reader, classifier)
        # plain assignments in a row: no exception, such as Ctrl-C, can come between them
        self.classifier = classifier
        self._compiled = compiled
        self._reader = reader
        self._tracks = tracks
        self.decides_in_stretches = (
            compiled is not None and reader is None and not self._config.needs_replay
        )

    def check_confidence(self, confidence: float | None) -> None:
        """Refuse a level of confidence where objects are found, as far as that is known before the
        first answer."""
        _check_confidence(self._reader, confidence)

    def forget(self) -> None:
        """Forget the objects of earlier decisions, and number them from 0 on."""
        if self._reader is not None:
            self._tracks[0, [N_KNOWN, NEXT_NUMBER]] = 0

    def _new_tracks(self, reader: ObjectReader | None, classifier: Classifier) -> np.ndarray:
        if reader is None:
            return np.empty((0, 4))
        shape = reader.shape
        places = getattr(classifier, "places", None) or even_places(shape, self._config.sensor)
        tracks = new_tracks(places, shape, self._config.window_us)
        if len(self._tracks):  # no number is given twice in a stream
            tracks[0, NEXT_NUMBER] = self._tracks[0, NEXT_NUMBER]
        return tracks

    def decide(
        self,
        volume: TNTVolume,
        trigger: Trigger,
        complete: bool = False,
        confidence: float | None = None,
    ) -> Decision:
        """The decision about a volume's open window.

        Parameters
        ----------
        confidence : if the likeliest class has this probability, the decision is complete, its
            trigger `confidence`.

        Raises
        ------
        ValueError : there is not one finite logit for each class. What the classifier raises passes
            through.
        """
        n_events, start_us = volume.n_events, volume.start_us
        time_us = volume.newest_us if n_events else start_us
        window = start_us, time_us, n_events
        if self._compiled is not None and self._compiled.reader is not None:
            n = self._compiled.locate(volume, self._tracks, time_us, trigger != "fire")
            return self._decision_of_map(n, self._compiled.map, window, trigger, complete)
        if self._compiled is not None:
            index, logits, probabilities = self._compiled.answer(volume)
        else:
            logits = self._call(volume)
            shape = logits_shape(logits.shape)
            if shape is None and logits.size:
                raise ValueError(
                    f"`classifier` must return logits {LOGITS}, got shape {logits.shape}"
                )
            if shape is not None and len(shape) == 3:
                logits = logits.reshape(shape)
                reader = self._reader_for(logits.shape)
                _check_confidence(reader, confidence)
                n = reader.read(logits, self._tracks, time_us, trigger != "fire")
                return self._decision_of_map(n, logits, window, trigger, complete)
            logits = logits.reshape(-1)
            probabilities = np.empty(logits.size)
            index = softmax(logits, probabilities) if logits.size else -1
        if index < 0 and logits.size:
            raise _not_finite(logits)
        classes = self._classes_for(logits.size)
        if confidence is not None and probabilities[index] >= confidence:
            trigger, complete = "confidence", True
        return Decision(
            classes[index],
            index,
            probabilities,
            logits,
            start_us,
            time_us,
            n_events,
            complete,
            trigger,
        )

    def _call(self, volume: TNTVolume) -> np.ndarray:
        """What another classifier answers, a copy."""
        try:
            return np.asarray(self.classifier(volume.array)).astype(np.float32)
        except Exception as error:
            if not hasattr(self.classifier, "state_dict"):
                raise
            raise TypeError(
                "`classifier` must take an array (C, H, W); a torch module is wrapped, "
                "TorchClassifier(module), or "
                f"compiled, Model.from_torch(module, config, classes): it failed with "
                f"{one_line(error)!r}"
            ) from error

    def _reader_for(self, shape: tuple[int, ...]) -> ObjectReader:
        """What reads maps of this shape."""
        if self._reader is None or self._reader.shape != shape:
            reader = ObjectReader(shape)
            self._tracks = self._new_tracks(reader, self.classifier)
            self._reader = reader
        return self._reader

    def _decision_of_map(
        self,
        n: int,
        logits: np.ndarray,
        window: tuple[int, int, int],
        trigger: Trigger,
        complete: bool,
    ) -> Decision:
        """The decision of a map on which the reader has found n objects; window: start, newest
        time, events."""
        if n < 0:
            raise ValueError(
                "`classifier` must return finite logits, got some on its map that are not"
            )
        reader, classes = self._reader, self._classes_for(logits.shape[0] - 1, is_map=True)
        assert reader is not None
        objects = tuple(
            Object(classes[int(k)], int(k), probability, x, y, int(number))
            for x, y, probability, k, number in reader.found[:n].tolist()
        )
        label, index = (objects[0].label, objects[0].index) if n else (None, -1)
        return Decision(
            label,
            index,
            reader.probabilities[:n].copy(),
            logits,
            *window,
            complete,
            trigger,
            objects,
        )

    def decide_stretch(
        self, volume: TNTVolume, triggers: np.ndarray, columns: Columns, first: int, last: int
    ) -> tuple[int, list[Decision], ValueError | None]:
        """Add events to a volume and decide whenever one of them makes that due, in compiled code,
        without the GIL.

        Parameters
        ----------
        triggers : float64, see `kernels.trigger`.
        columns, first, last : the events `first <= i < last`.

        Returns
        -------
        absorbed : int. The first event not added: `last`, the first past the volume's limit, or the
            one after a decision that reached the level of confidence.
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
            if every_events := int(triggers.view(np.int64)[T.EVERY_EVENTS]):
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

    def _classes_for(self, n: int, *, is_map: bool = False) -> tuple[str, ...]:
        if n == 0:
            raise ValueError("`classifier` must return logits, got none")
        if self.classes is None:
            self.classes = tuple(str(k) for k in range(n))
        if n != len(self.classes):
            what = "channels, one more than classes" if is_map else "logits, one for each class"
            raise ValueError(
                f"`classifier` must return {len(self.classes) + is_map} {what}, got {n + is_map}"
            )
        return self.classes


def _check_confidence(reader: ObjectReader | None, confidence: float | None) -> None:
    if reader is not None and confidence is not None:
        raise ValueError("`confidence` needs one answer for the window; a map model finds objects")


def _not_finite(logits: np.ndarray) -> ValueError:
    return ValueError(f"`classifier` must return finite logits, got {short(logits.tolist())}")
