"""Output: the tensors that a network of raw outputs has computed from a window at one moment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.base.box import Box
from async_tnt.streaming.decision import Decision, Trigger

if TYPE_CHECKING:
    from typing_extensions import TypeVar  # it has defaults, which `typing` has from 3.13 on

    AnswerT = TypeVar("AnswerT", bound="Decision | Output", default=Decision)
else:
    from typing import TypeVar

    AnswerT = TypeVar("AnswerT")
    """What a stream yields: `Decision`, or `Output` with a model of raw outputs."""


# eq=False, because a comparison of two arrays is an array, which has no truth value
@dataclass(slots=True, eq=False, repr=False)
class Output:
    """The tensors that a network has computed from a window at one moment.

    Examples
    --------
    >>> from torch import nn
    >>> from async_tnt import Model, Processor, TNTConfig
    >>> model = Model.from_torch(nn.Conv2d(9, 2, 3, padding=1), TNTConfig())
    >>> processor = Processor(model, every_events=1)
    >>> (output,) = processor.push((1_000, 17, 20, 1))
    >>> output["output"].shape
    (2, 34, 34)
    """

    arrays: tuple[np.ndarray, ...]
    """The outputs in order, float32, each (C, H, W) or (N,): read-only views, which the next call
    of the Processor, or another use of its network, changes. Copy them to keep them."""
    names: tuple[str, ...]
    """Their names."""
    changed: tuple[Box, ...]
    """For each output, the box of the places where it may differ from the network's last outputs. A
    vector (N,) is a map of one place."""
    window_start_us: int
    """Start of the window, in microseconds."""
    time_us: int
    """Time of the newest event in the window, in microseconds. If the window has no events, its
    start."""
    events: int
    """Events in the window so far."""
    complete: bool
    """Whether this answer closes the window. It is False at the end of the stream."""
    trigger: Trigger
    """The cause of the answer, see `Decision`; never `confidence`."""

    def __getitem__(self, name: str) -> np.ndarray:
        """The output of this name; a KeyError names those that there are."""
        if name not in self.names:
            raise KeyError(f"no output {name!r}: there are {', '.join(self.names)}")
        return self.arrays[self.names.index(name)]

    def copy(self) -> Output:
        """An Output with arrays of its own, which stay as they are."""
        return replace(self, arrays=tuple(array.copy() for array in self.arrays))

    __copy__ = copy

    def __repr__(self) -> str:
        """What was computed, why and when, on one line, without the numbers."""
        shapes = ", ".join(
            f"{name} {'x'.join(map(str, array.shape))}"
            for name, array in zip(self.names, self.arrays, strict=True)
        )
        return (
            f"Output({shapes}, trigger={self.trigger!r}, time_us={self.time_us}, "
            f"events={self.events})"
        )

    def to_dict(self) -> dict[str, Any]:
        """A dictionary of plain values, for JSON: of each array its shape and a summary.

        Least, mean and largest have six significant digits, and are None where a number of the
        array is not finite.
        """
        outputs = {
            name: _summary(array, box)
            for name, array, box in zip(self.names, self.arrays, self.changed, strict=True)
        }
        return {
            "time_us": self.time_us,
            "window_start_us": self.window_start_us,
            "outputs": outputs,
            "events": self.events,
            "complete": self.complete,
            "trigger": self.trigger,
        }


def _summary(array: np.ndarray, box: Box) -> dict[str, Any]:
    """What `to_dict` says of an array."""
    numbers = {"least": array.min(), "mean": array.mean(dtype=np.float64), "largest": array.max()}
    values: dict[str, Any] = {"shape": list(array.shape)}
    for name, number in numbers.items():
        values[name] = float(f"{number:.6g}") if np.isfinite(number) else None
    values["changed"] = list(box)
    return values
