"""WindowClassifier: makes the decisions about windows, with any classifier and its class names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterTypeError, ParameterValueError
from async_tnt.base.messages import one_line, short
from async_tnt.kernels.decisions.classify import softmax
from async_tnt.kernels.decisions.objects import N_KNOWN, NEXT_NUMBER, locate_on_map
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.volume.readout import cells_to_float32
from async_tnt.networks.models.compiled import CompiledClassifier
from async_tnt.networks.models.compiled_network import CompiledNetwork
from async_tnt.networks.models.objects import (
    LOGITS_SHAPES,
    ObjectReader,
    even_places,
    logits_shape,
    n_of_boxes,
    new_tracks,
)
from async_tnt.streaming.decision import Decision, Object, Trigger
from async_tnt.streaming.stretches import decide_stretch, not_finite_error
from async_tnt.volume.config import WINDOW_US, TNTConfig
from async_tnt.volume.events import Columns
from async_tnt.volume.volume import TNTVolume

Classifier = Callable[[np.ndarray], Any]


class WindowClassifier:
    """A classifier with its class names, which decides about windows.

    Parameters
    ----------
    config : TNTConfig of the volumes.
    classifier, classes, confidence : see `Processor`.

    Attributes
    ----------
    classifier : the callable from a volume to logits.
    classes : class names; if none were given, "0", "1", ... after the first answer.
    decides_in_stretches : whether `decide_stretch` can be called.
    answers_are_views : False.
    """

    answers_are_views = False

    def __init__(
        self,
        config: TNTConfig,
        classifier: Classifier,
        classes: Sequence[str] | None,
        confidence: float | None = None,
    ) -> None:
        if isinstance(classes, str):
            got = f"the single string {short(classes)}"
            raise ParameterTypeError("classes", "must be a sequence of names", got)
        self._config = config
        self.classes = None if classes is None else tuple(classes)
        self._reader: ObjectReader | None = None
        self._tracks = np.empty((0, 4))
        self.exchange(classifier, confidence)

    def exchange(
        self,
        classifier: Classifier,
        confidence: float | None = None,
        classes: Sequence[str] | None = None,
    ) -> None:
        """Use another callable from now on.

        The callable must take volumes of the configuration's shape. If `confidence` is set, the
        callable must not find objects. It decides about other `classes` if they are given.
        """
        if isinstance(classifier, CompiledNetwork):
            rule = "must return logits; a CompiledNetwork has raw outputs"
            raise ParameterTypeError("classifier", rule)
        if not callable(classifier):
            raise ParameterTypeError("classifier", "must be callable", type(classifier).__name__)
        reader: ObjectReader | None = None
        # a subclass may behave differently, so it is called as any other callable
        compiled = classifier if type(classifier) is CompiledClassifier else None
        names = self.classes if classes is None else tuple(classes)
        if compiled is not None:
            self._check_compiled(compiled, names)
            reader = compiled.reader
        else:
            shape: Any = getattr(classifier, "logits_shape", ())
            if len(shape) == 3:
                reader = self._new_reader(shape)
        _check_confidence(reader, confidence)
        tracks = self._new_tracks(reader, classifier)
        decides_in_stretches = (
            compiled is not None and reader is None and not self._config.needs_replay
        )

        # plain assignments in a row: no exception, such as Ctrl-C, can come between them
        self.classifier = classifier
        self.classes = names
        self._compiled = compiled
        self._reader = reader
        self._tracks = tracks
        self.decides_in_stretches = decides_in_stretches
        self._prepare()

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._prepare()  # perhaps in another process

    def _prepare(self) -> None:
        """Compile the kernels that a foreign classifier needs, so that no event waits for them."""
        if self._compiled is None:
            prepare(softmax, cells_to_float32)
            if self._reader is not None:
                prepare(locate_on_map)

    def prepare_stretches(self) -> None:
        """Compile the kernel of `decide_stretch`, so that no event waits for the compiler."""
        assert self._compiled is not None
        self._compiled.prepare_stretches()

    def _check_compiled(
        self, compiled: CompiledClassifier, classes: tuple[str, ...] | None
    ) -> None:
        """Refuse a compiled classifier of another shape, other classes or another sensor."""
        config = self._config
        if compiled.shape != config.shape:
            rule = f"must take volumes of shape {config.shape}"
            raise ParameterValueError("classifier", rule, f"one for {compiled.shape}")
        if classes is not None:
            _check_number(classes, compiled.n_classes)
        if compiled.places is not None and compiled.sensor != config.sensor:
            rule = f"must be for the sensor {config.sensor}, in whose pixels objects stand"
            raise ParameterValueError("classifier", rule, f"one for {compiled.sensor}")

    def check_confidence(self, confidence: float | None) -> None:
        """Refuse a level of confidence if the classifier is known to find objects.

        For some classifiers, only the first answer shows that they find objects.
        """
        _check_confidence(self._reader, confidence)

    @property
    def finds_objects(self) -> bool:
        """Whether the classifier is known to find objects."""
        return self._reader is not None

    def forget(self) -> None:
        """Forget the objects of earlier decisions, and number them from 0 on."""
        if self._reader is not None:
            self._tracks[0, [N_KNOWN, NEXT_NUMBER]] = 0

    def _new_tracks(self, reader: ObjectReader | None, classifier: Classifier) -> np.ndarray:
        """Memory for the objects of earlier decisions; no object is known yet."""
        if reader is None:
            return np.empty((0, 4))
        shape = reader.shape
        places = getattr(classifier, "places", None) or even_places(shape, self._config.sensor)
        config = self._config
        # a window of the last events has no length in time
        memory_us = WINDOW_US if config.last_events is not None else config.window_us
        tracks = new_tracks(places, shape, memory_us)
        # The numbering goes on, so that no number is given twice in a stream.
        if len(self._tracks):
            tracks[0, NEXT_NUMBER] = self._tracks[0, NEXT_NUMBER]
        return tracks

    def decide(
        self,
        volume: TNTVolume,
        trigger: Trigger,
        complete: bool = False,
    ) -> Decision:
        """The decision about a volume's open window.

        Parameters
        ----------
        trigger : why the decision is made.
        complete : whether the decision closes the window.

        Raises
        ------
        ParameterValueError : there is not one finite logit for each class.
        Exception : what the classifier raises passes through.
        """
        window = volume.moment()
        start_us, time_us, n_events = window

        compiled = self._compiled
        if compiled is not None and compiled.reader is not None:
            n = compiled.locate(volume, self._tracks, time_us, trigger != "fire")
            return self._decision_of_map(n, compiled.map, window, trigger, complete)
        if compiled is not None:
            index, logits, probabilities = compiled.answer(volume)
        else:
            logits = self._call(volume)
            if logits.ndim == 3:
                reader = self._reader_for(logits.shape)
                n = reader.read(logits, self._tracks, time_us, trigger != "fire")
                return self._decision_of_map(n, logits, window, trigger, complete)
            probabilities = np.empty(logits.size)
            index = softmax.call(logits, probabilities) if logits.size else -1

        if index < 0 and logits.size:
            raise not_finite_error(logits)
        classes = self._classes_for(logits.size)
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
        """A copy of another classifier's answer: logits (n,), or a map (n_classes + 1, R, C)."""
        try:
            logits = np.asarray(self.classifier(volume.array)).astype(np.float32)
        except Exception as error:
            if not hasattr(self.classifier, "state_dict"):
                raise
            raise TypeError(
                "`classifier` must take an array (C, H, W); a torch module is wrapped, "
                "TorchClassifier(module), or compiled, "
                "Model.from_torch(module, config, classes): it failed with "
                f"{one_line(error)!r}"
            ) from error
        if logits.ndim == 1:
            return logits
        if not logits.size:
            return logits.reshape(-1)
        shape = logits_shape(logits.shape)
        if shape is None:
            rule = f"must return logits {LOGITS_SHAPES}"
            raise ParameterValueError("classifier", rule, f"shape {logits.shape}")
        return logits.reshape(shape)

    def _new_reader(self, shape: tuple[int, ...]) -> ObjectReader:
        """A reader of maps of this shape. Maps have boxes if they have as many channels more."""
        n_classes = None if self.classes is None else len(self.classes)
        has_sizes = n_classes is not None and n_of_boxes(shape[0], n_classes) > 0
        return ObjectReader(shape, n_classes if has_sizes else None)

    def _reader_for(self, shape: tuple[int, ...]) -> ObjectReader:
        """The reader of maps of this shape."""
        if self._reader is None or self._reader.shape != shape:
            reader = self._new_reader(shape)
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
        """The decision of a map on which the reader has found `n` objects.

        n : number of objects; -1 if a logit is not finite.
        window : start of the window, time of the newest event, number of events.
        """
        if n < 0:
            got = "some on its map that are not"
            raise ParameterValueError("classifier", "must return finite logits", got)
        reader = self._reader
        assert reader is not None
        classes = self._classes_for(reader.n_classes, is_map=True)
        rows = reader.found[:n].tolist()
        if reader.has_sizes:
            objects = tuple(
                Object(classes[int(k)], int(k), probability, x, y, int(number), width, height)
                for x, y, probability, k, number, width, height in rows
            )
        else:
            objects = tuple(
                Object(classes[int(k)], int(k), probability, x, y, int(number))
                for x, y, probability, k, number, _, _ in rows
            )
        label = None
        index = -1
        if objects:
            label = objects[0].label
            index = objects[0].index
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
        """Add events to a volume, and decide whenever one of them makes a decision due.

        All of it is compiled code, and runs without the GIL.

        Parameters
        ----------
        volume : the open window.
        triggers : float64, see `kernels.decisions.trigger`.
        columns, first, last : the events `first <= i < last`.

        Returns
        -------
        See `stretches.decide_stretch`.
        """
        compiled = self._compiled
        assert compiled is not None

        def call(absorbed: int, *answers: np.ndarray) -> tuple[int, int, int]:
            return compiled.decide_stretch(
                volume.buffer, columns, absorbed, last, triggers, *answers
            )

        classes = self._classes_for(compiled.n_classes)
        slides = self._config.slides
        return decide_stretch(call, classes, triggers, first, last, slides=slides)

    def _classes_for(self, n: int, *, is_map: bool = False) -> tuple[str, ...]:
        """The class names of `n` logits; made at the first answer if none were given.

        is_map : whether the answer is a map. A map has one channel more than there are classes.
        """
        if n == 0:
            raise ParameterValueError("classifier", "must return logits", "none")
        if self.classes is None:
            self.classes = tuple(str(k) for k in range(n))
        _check_number(self.classes, n, is_map=is_map)
        return self.classes


def _check_number(classes: Sequence[str], n: int, *, is_map: bool = False) -> None:
    """Refuse `n` logits that are not one for each class."""
    n_expected = len(classes)
    if n == n_expected:
        return
    if is_map:
        rule = (
            f"must return {n_expected + 1} channels, one more than classes, or "
            f"{n_expected + 3} or {n_expected + 5}"
        )
        raise ParameterValueError("classifier", rule, n + 1)
    rule = f"must return {n_expected} logits, one for each class"
    raise ParameterValueError("classifier", rule, n)


def _check_confidence(reader: ObjectReader | None, confidence: float | None) -> None:
    """Refuse a level of confidence for a classifier that finds objects."""
    if reader is not None and confidence is not None:
        rule = "needs one answer for the window; a map model finds objects"
        raise ParameterValueError("confidence", rule)
