"""What commands print: decisions as lines for people and for programs, and errors on stderr."""

from __future__ import annotations

import errno
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from async_tnt.base.checks import ParameterError
from async_tnt.base.messages import printable
from async_tnt.streaming.decision import Decision, Object
from async_tnt.streaming.output import Output

if TYPE_CHECKING:
    from async_tnt.networks.layers.reach import Work
    from async_tnt.sources.queues.background_reader import BackgroundReader

EXPECTED_ERRORS = (OSError, ValueError, ImportError, MemoryError, NotImplementedError)
"""Errors that a command reports in one line: something that came from outside is wrong, cannot be
read, or contains what this release cannot do."""

# -- text ------------------------------------------------------------------------------------------
# Everything that a command prints passes through `say` or `note`. Names of files and classes come
# from outside, so they may contain line breaks, and control characters that a terminal would obey.
# `printable` escapes both.


def say(*lines: str) -> None:
    """Print lines on stdout, at once."""
    print("\n".join(map(printable, lines)), flush=True)


def note(*lines: str) -> None:
    """Print lines on stderr, at once."""
    print("\n".join(map(printable, lines)), file=sys.stderr, flush=True)


def can_print(text: str, stream: TextIO) -> bool:
    """Whether a stream can print all characters of a text.

    A character that the stream's encoding lacks is printed as an escape.
    """
    try:
        text.encode(getattr(stream, "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        return False
    return True


MUCH = 1 / 3
"""If one event reaches a larger share of a whole pass, little is gained by deciding event by event.
"""


def reach_text(work: Work) -> str:
    """What one event makes a network do again, and what to expect of it, in words."""
    share = f"{work.share:.0%}" if work.share >= 0.01 else f"{work.share:.1%}"
    text = f"reaches at most {work.touched:,} multiplications, {share} of a whole pass"
    if work.share > MUCH:
        text += ": a decision after each event costs about as much as a whole pass"
    return text


# -- errors ----------------------------------------------------------------------------------------


def complain(
    error: BaseException | str, option_names: Mapping[str, str] | None = None, *, prefix: str = ""
) -> None:
    """Print an error, a warning or a remark on stderr, as one line.

    Parameters
    ----------
    error, option_names : see `message_of`.
    prefix : text that comes before the message.
    """
    note(f"async-tnt: {prefix}{message_of(error, option_names)}")


def message_of(error: BaseException | str, option_names: Mapping[str, str] | None = None) -> str:
    """The message of an error, in which parameters have the names of their options.

    Parameters
    ----------
    option_names : name of a parameter -> the option that gives it, such as `args.option_names`.

    Examples
    --------
    >>> from async_tnt.base.checks import ParameterValueError
    >>> error = ParameterValueError("every_us", "must be at least 1")
    >>> message_of(error, {"every_us": "--every-us"})
    '--every-us must be at least 1'
    """
    if isinstance(error, ParameterError):
        return error.text(option_names)
    if isinstance(error, MemoryError):
        # NumPy says what the memory was for, Python says nothing
        return f"not enough memory. {error}".strip()
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        # an error about a file that we write names the file, so this error is about stdout
        return f"stdout: {error.strerror}"
    return str(error)


def complain_late(name: str, n_late: int, n_events: int, see: str) -> None:
    """Report events that were dropped because they were too late, if there are any.

    `see` names the option or the field that tells the user more.
    """
    if n_late:
        complain(f"{name}: {n_late} of {n_events} events were too late and dropped (see {see})")


# -- decisions -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DecisionLines:
    """Prints decisions, or raw outputs, on stdout, one a line, for people or for programs.

    Parameters
    ----------
    as_json : whether each line is a JSON object.
    with_latency : whether each line has the latency of its decision.
    of_outputs : whether the model has raw outputs.
    """

    as_json: bool
    with_latency: bool
    of_outputs: bool = False

    def print_header(self) -> None:
        """Print the names of the columns. With `as_json`, print nothing."""
        if not self.as_json:
            latency = f" {'us':>7}" if self.with_latency else ""
            answer = "" if self.of_outputs else f"{'label':<8} {'prob':>5} "
            outputs = "           outputs, least to largest" if self.of_outputs else ""
            say(
                f"{'recording':<16} {'time ms':>9} {'window ms':>19}  {answer}"
                f"{'events':>7}{latency}  why{outputs}"
            )

    def print(
        self,
        name: str,
        decision: Decision | Output,
        latency_us: float,
        queue: BackgroundReader | None = None,
    ) -> None:
        """Print a decision or an output.

        Parameters
        ----------
        name : name of the recording or of another source.
        latency_us : microseconds of the call that made the decision.
        queue : the queue in which the packets waited, if there is one.
        """
        if self.as_json:
            say(self._json(name, decision, latency_us, queue))
        else:
            say(self._text(name, decision, latency_us))

    def _text(self, name: str, decision: Decision | Output, latency_us: float) -> str:
        """A decision or an output as a line for people."""
        start_ms = decision.window_start_us / 1e3
        length_ms = (decision.time_us - decision.window_start_us) / 1e3
        window = f"{start_ms:.3f}+{length_ms:.3f}"
        latency = f" {latency_us:>7.1f}" if self.with_latency else ""
        if isinstance(decision, Output):
            answer = ""
            details = "  ".join(
                f"{output} {array.min():.4g} to {array.max():.4g}"
                for output, array in zip(decision.names, decision.arrays, strict=True)
            )
            ending = f"{decision.trigger:<12}  {details}"
        else:
            answer = f"{decision.label or '-':<8} {decision.probability:>5.3f} "
            objects = "".join(
                f"  {item.id}: {item.label} ({item.x:.0f}, {item.y:.0f}{_size_of(item)})"
                for item in decision.objects or ()
            )
            ending = f"{decision.trigger}{objects}"
        return (
            f"{Path(name).name:<16} {decision.time_us / 1e3:>9.3f} {window:>19}  "
            f"{answer}{decision.events:>7}{latency}  {ending}"
        )

    def _json(
        self,
        name: str,
        decision: Decision | Output,
        latency_us: float,
        queue: BackgroundReader | None,
    ) -> str:
        """A decision or an output as a line of JSON."""
        fields = {"recording": name, **decision.to_dict()}
        if self.with_latency:
            fields["latency_us"] = round(latency_us, 3)
        if queue is not None:
            fields["delay_us"] = queue.delay_us
            fields["backlog"] = queue.backlog
            fields["n_skipped"] = queue.n_skipped
        return json.dumps(fields)


def _size_of(item: Object) -> str:
    """The size of an object's box, as text behind its place; empty without a box."""
    if item.width is None or item.height is None:
        return ""
    return f", {item.width:.0f} x {item.height:.0f}"
