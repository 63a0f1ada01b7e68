"""Log decisions to Rerun: the class or the objects now, probabilities, and a line for each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from async_tnt.streaming.decision import Decision, Object
from async_tnt.streaming.processor import Processor
from async_tnt.views.rerun_log import boxes_at, plain, points_at

# the names under which data is logged
OBJECTS = "events/objects"
PROBABILITIES = "probabilities"
CLASS = "class"
DECISIONS = "decisions"

MOST_NAMED = 12
"""Number of classes in the text about the open window, at most. They are the likeliest ones."""


class DecisionLog:
    """Logs decisions about classes or objects, as `rerun_log.AnswerLog` says.

    Parameters
    ----------
    rr : the module `rerun`.
    stream : a `rerun.RecordingStream`.
    processor : has the names of the classes.
    """

    def __init__(self, rr: Any, stream: Any, processor: Processor[Any]) -> None:
        self._rr = rr
        self._stream = stream
        self._processor = processor
        self._classes: tuple[str, ...] = ()
        self._has_boxes = False  # whether boxes were logged

    def panels(self, time_ranges: Any) -> tuple[list[Any], list[Any]]:
        """The class in the upper row, the probabilities and the decisions in the lower row."""
        blueprint = self._rr.blueprint
        now = blueprint.TextDocumentView(origin=CLASS, name="Class now")
        plots = blueprint.TimeSeriesView(
            origin=PROBABILITIES, name="Probabilities", time_ranges=time_ranges
        )
        lines = blueprint.TextLogView(origin=DECISIONS, name="Decisions")
        return [now], [plots, lines]

    def kept(self, decision: Decision) -> Decision:
        """The decision itself."""
        return decision

    def log_past(self, decision: Decision, n_left_out: int) -> None:
        """Log a decision since the previous picture, as a line and as probabilities."""
        self._name_classes()
        span = f"{decision.window_start_us / 1e3:,.3f} to {decision.time_us / 1e3:,.3f} ms"
        label = "nothing" if decision.label is None else decision.label
        outcome = f"{label}  {decision.probability:.3f}"
        text = f"{outcome}  {decision.trigger}: {decision.events:,} events, {span}"
        if n_left_out:
            text += f" ({n_left_out:,} decisions before it are not shown)"
        # The viewer can filter lines by level: it can hide the many early decisions, and still
        # show the last decision of each window.
        is_last = decision.complete or decision.trigger == "end"
        level = "INFO" if is_last else "TRACE"
        self._stream.log(DECISIONS, self._rr.TextLog(text, level=level))
        self._log_probabilities(decision)

    def log_now(self, decision: Decision) -> None:
        """Log the decision about the open window: its class or objects, and its probabilities."""
        rr = self._rr
        self._name_classes()
        if decision.objects is not None:
            self._log_objects(decision.objects)
        description = class_text(decision, self._classes)
        self._stream.log(CLASS, rr.TextDocument(description, media_type=rr.MediaType.MARKDOWN))
        if decision.events:
            self._log_probabilities(decision)

    def _log_objects(self, objects: Sequence[Object]) -> None:
        """Log the objects of the open window: their boxes, or points if the model says no sizes."""
        rr = self._rr
        boxes = [item.box for item in objects if item.box is not None]
        names = [f"{item.id}: {item.label} {item.probability:.2f}" for item in objects]
        if boxes:
            self._has_boxes = True
            self._stream.log(OBJECTS, boxes_at(rr, boxes, names))
        elif self._has_boxes:  # there are none now
            self._stream.log(OBJECTS, boxes_at(rr, [], []))
        else:
            places = [(item.x, item.y) for item in objects]
            self._stream.log(OBJECTS, points_at(rr, places, 6.0, names))

    def _name_classes(self) -> None:
        """Log the names of the classes, once they are known."""
        classes = self._processor.classes
        if classes is not None and classes != self._classes:
            self._classes = classes
            names = self._rr.SeriesLines(names=list(classes))
            self._stream.log(PROBABILITIES, names, static=True)

    def _log_probabilities(self, decision: Decision) -> None:
        """Log the probability of each class.

        A class of a map model has the probability of its likeliest object.
        """
        probabilities: Any = decision.probabilities
        if decision.objects is not None:
            likeliest = dict.fromkeys(self._classes, 0.0)
            for item in decision.objects:
                likeliest[item.label] = max(likeliest[item.label], item.probability)
            probabilities = list(likeliest.values())
        self._stream.log(PROBABILITIES, self._rr.Scalars(probabilities))


def class_text(decision: Decision, classes: Sequence[str]) -> str:
    """A text in Markdown about the open window: its class, and the likeliest classes.

    For a map model, the text lists the objects instead.
    """
    if decision.events == 0:
        return "# no event\n\nThe window has no event yet."
    if decision.objects is not None:
        lines = [f"# {len(decision.objects)} objects", ""]
        lines += ["| number | class | probability | place |", "|---|---|---|---|"]
        for item in decision.objects:
            place = f"{item.x:.0f}, {item.y:.0f}"
            if item.box is not None:
                place += f", {item.width:.0f} x {item.height:.0f}"
            lines.append(f"| {item.id} | {plain(item.label)} | {item.probability:.3f} | {place} |")
        return "\n".join(lines) + "\n"

    length_ms = (decision.time_us - decision.window_start_us) / 1e3
    evidence = f"from {decision.events:,} events in {length_ms:,.1f} ms"
    lines = [f"# {plain(decision.label or 'nothing')}", ""]
    lines += [f"with probability {decision.probability:.3f}, {evidence}", ""]
    lines += ["| class | probability |", "|---|---|"]
    for k in np.argsort(-decision.probabilities, kind="stable")[:MOST_NAMED]:
        lines.append(f"| {plain(classes[k])} | {decision.probabilities[k]:.3f} |")
    return "\n".join(lines) + "\n"
