"""Log the spikes of a spiking network's layers to Rerun, beside its answers."""

from __future__ import annotations

from typing import Any

from async_tnt.streaming.processor import Processor
from async_tnt.views.rerun_log import AnswerLog

SPIKES = "spikes"
"""The name under which spikes are logged."""


class SpikesLog:
    """Logs what another log does, and the spikes of each layer, as `rerun_log.AnswerLog` says.

    Parameters
    ----------
    rr : the module `rerun`.
    stream : a `rerun.RecordingStream`.
    processor : a Processor of a spiking model.
    answers : logs the processor's answers.
    """

    def __init__(self, rr: Any, stream: Any, processor: Processor[Any], answers: AnswerLog) -> None:
        self._rr = rr
        self._stream = stream
        self._processor = processor
        self._answers = answers
        names = rr.SeriesLines(names=list(processor.layer_spikes))
        stream.log(SPIKES, names, static=True)

    def panels(self, time_ranges: Any) -> tuple[list[Any], list[Any]]:
        """The other log's views, and the layers' spikes in the lower row."""
        upper, lower = self._answers.panels(time_ranges)
        spikes = self._rr.blueprint.TimeSeriesView(
            origin=SPIKES, name="Spikes of each layer in the window", time_ranges=time_ranges
        )
        return upper, [*lower, spikes]

    def kept(self, answer: Any) -> Any:
        """What the other log keeps."""
        return self._answers.kept(answer)

    def log_past(self, kept: Any, n_left_out: int) -> None:
        """Log an answer since the previous picture."""
        self._answers.log_past(kept, n_left_out)

    def log_now(self, answer: Any) -> None:
        """Log the answer about the open window, and the spikes of its layers so far."""
        self._answers.log_now(answer)
        self._stream.log(SPIKES, self._rr.Scalars(list(self._processor.layer_spikes.values())))
