"""Streams of whole sources: `stream` and `astream` yield decisions, `volumes` yields volumes."""

from __future__ import annotations

from collections.abc import AsyncIterable, AsyncIterator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypedDict, Unpack, overload

import numpy as np

from async_tnt.base.checks import ParameterTypeError
from async_tnt.base.messages import short
from async_tnt.networks.loading import load_model
from async_tnt.networks.models.model import Model
from async_tnt.streaming.decision import Decision
from async_tnt.streaming.output import AnswerT
from async_tnt.streaming.processor import Processor
from async_tnt.streaming.restarts import OnRestart, part_of
from async_tnt.streaming.window_classifier import Classifier
from async_tnt.streaming.windows import TimeUnitCheck
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.events import LARGER_CAMERA, EventDecoder, Late
from async_tnt.volume.regressor import Regressor

PIECE = 256
"""Number of events that `volumes` pushes at once.

The volumes of all windows that one push closes lie in memory together, and those of a long packet
might not fit. A piece is short, because few events close few windows."""


class Settings(TypedDict, total=False):
    """The keyword arguments of `Processor`, for type checkers."""

    classifier: Classifier | None
    regressor: Regressor | None
    classes: Sequence[str] | None
    start_us: int | None
    hop_us: int | None
    every_us: int | None
    every_events: int | None
    confidence: float | None
    late: Late
    on_restart: OnRestart
    keep_neurons: bool


@overload
def stream(
    source: Iterable[Any], model: Processor[AnswerT], *, finish: bool = ...
) -> Iterator[AnswerT]: ...


@overload
def stream(
    source: Iterable[Any],
    model: Model | TNTConfig | str | Path,
    *,
    finish: bool = ...,
    **settings: Unpack[Settings],
) -> Iterator[Decision]: ...


def stream(
    source: Iterable[Any],
    model: Model | TNTConfig | str | Path | Processor[Any],
    *,
    finish: bool = True,
    **settings: Unpack[Settings],
) -> Iterator[Any]:
    """The decisions about a source of events, made while the source is read.

    Parameters
    ----------
    source : an iterable of packets, or of single events, in any form that
        `async_tnt.volume.event_forms` lists.
    model : a Model, its name or path, a TNTConfig (with `classifier=`, and `regressor=` if its
        landmark needs one), or a Processor, which continues its stream.
    finish : decide about the windows that are still open when the source ends, and close them.
        Events of these windows that come later are late. False: leave the windows open for the next
        source that goes to the same Processor.
    settings : keyword arguments of `Processor`: `every_us`, `every_events`, `hop_us`, `start_us`,
        `late`, `on_restart`, ...

    Yields
    ------
    Decision : one for each window that closes and for each trigger; when the source ends, one for
        each window that is still open. With a model of raw outputs an Output, whose arrays are
        valid until the next one; for type checkers, pass a `Processor[Output](model)`.

    Examples
    --------
    >>> from async_tnt.sources import open_recording, sample_recordings
    >>> [decision.label for decision in stream(open_recording(sample_recordings()[3]), "digits")]
    ['3', '3', '3']
    """
    _check_source(source)
    # The Processor is made here, not in the generator, so that errors come before the first event.
    processor = as_processor(model, **settings)
    return _stream(source, processor, finish)


def _check_source(source: Any) -> None:
    if isinstance(source, (str, Path)):
        got = f"the path {source}; open_recording(path) reads a file"
        raise ParameterTypeError("source", "must yield events", got)
    if not hasattr(source, "__iter__") and not hasattr(source, "__getitem__"):
        rule = "must be an iterable of packets or of events"
        raise ParameterTypeError("source", rule, type(source).__name__)


def _stream(source: Iterable[Any], processor: Processor[Any], finish: bool) -> Iterator[Any]:
    time_unit = TimeUnitCheck(processor.config)
    for events in source:
        for piece in pieces_for(processor, events):
            yield from time_unit.watch(processor.push(piece))
    if finish:
        yield from processor.finish()


def pieces_for(processor: Processor[Any], events: Any) -> Iterable[Any]:
    """A packet, or pieces of it if answers are views.

    The answers that one push makes due lie in memory together, and a network's outputs may be
    large. So no piece has more events than make one answer due by their number.
    """
    if not processor.answers_are_views:
        return (events,)
    decoder = EventDecoder(processor.config.sensor, "accept", LARGER_CAMERA)
    return _pieces((events,), decoder, min(PIECE, processor.every_events or PIECE))


@overload
def astream(
    source: AsyncIterable[Any], model: Processor[AnswerT], *, finish: bool = ...
) -> AsyncIterator[AnswerT]: ...


@overload
def astream(
    source: AsyncIterable[Any],
    model: Model | TNTConfig | str | Path,
    *,
    finish: bool = ...,
    **settings: Unpack[Settings],
) -> AsyncIterator[Decision]: ...


def astream(
    source: AsyncIterable[Any],
    model: Model | TNTConfig | str | Path | Processor[Any],
    *,
    finish: bool = True,
    **settings: Unpack[Settings],
) -> AsyncIterator[Any]:
    """Do what `stream` does, for an asynchronous `source`.

    The classifier runs in the event loop, for microseconds at a time.

    `model`, `finish` and `settings` are those of `stream`.

    Raises
    ------
    TypeError : `source` is not asynchronous.
    """
    if not hasattr(source, "__aiter__"):
        got = f"{type(source).__name__}; `stream` takes iterables that are not"
        raise ParameterTypeError("source", "must be asynchronous", got)
    # The Processor is made here, not in the generator, so that errors come before the first event.
    processor = as_processor(model, **settings)
    return _astream(source, processor, finish)


async def _astream(
    source: AsyncIterable[Any], processor: Processor[Any], finish: bool
) -> AsyncIterator[Any]:
    time_unit = TimeUnitCheck(processor.config)
    async for events in source:
        for piece in pieces_for(processor, events):
            for decision in time_unit.watch(processor.push(piece)):
                yield decision
    if finish:
        for decision in processor.finish():
            yield decision


class WindowVolume(NamedTuple):
    """The volume of one window, as `volumes` yields it."""

    volume: np.ndarray
    """Float32, shape (C, H, W)."""
    start_us: int
    """Start of the window, in microseconds."""
    events: int
    """Events in the window so far."""


def volumes(
    source: Iterable[Any], config: TNTConfig, **settings: Unpack[Settings]
) -> Iterator[WindowVolume]:
    """The volumes of a source's windows, for the caller's own networks and programs.

    Parameters
    ----------
    source : see `stream`.
    config : how events become volumes.
    settings : the settings of `stream` without `classifier`, `classes` and `confidence`. With a
        trigger such as `every_us`, the volume of the window so far is also yielded whenever the
        trigger fires.

    Examples
    --------
    >>> from async_tnt.sources import open_recording, sample_recordings
    >>> for window in volumes(open_recording(sample_recordings()[3]), TNTConfig(bins=5)):
    ...     print(window.volume.shape, window.start_us, window.events)
    (5, 34, 34) 3075 1887
    (5, 34, 34) 108075 1721
    (5, 34, 34) 213075 1344
    """
    if not isinstance(config, TNTConfig):
        got = f"{short(config)}; a model has one as `config`"
        raise ParameterTypeError("config", "must be a TNTConfig", got)
    if settings.keys() & {"classifier", "classes", "confidence"}:
        raise TypeError(
            "`classifier`, `classes` and `confidence` are for decisions; volumes have none"
        )
    _check_source(source)
    late = settings.pop("late", "accept")
    decoder = EventDecoder(config.sensor, late, LARGER_CAMERA)
    kept_volumes: list[np.ndarray] = []

    def keep(volume: np.ndarray) -> list[float]:
        """Keep a copy of the volume. The function takes the place of a classifier.

        Its one logit is the same for all windows, so it decides nothing.
        """
        kept_volumes.append(volume.copy())
        return [0.0]

    settings["classifier"] = keep
    # `stream` makes the Processor here, not in the generator, so that errors come before the first
    # event.
    decisions = stream(_pieces(source, decoder), config, **settings)
    return (
        WindowVolume(kept_volumes.pop(0), decision.window_start_us, decision.events)
        for decision in decisions
    )


def _pieces(
    source: Iterable[Any], decoder: EventDecoder, size: int = PIECE
) -> Iterator[tuple[Any, ...]]:
    """The events of a source, at most `size` of them at once."""
    accepts_late = decoder.late == "accept"
    for packet in source:
        # a single event of Python integers is pushed as it is, which is quick
        has_four = type(packet) is tuple and len(packet) == 4
        if has_four and accepts_late and type(packet[0]) is int:
            yield packet
            continue
        columns = decoder.decode(packet)
        for first in range(0, columns.n, size):
            piece = part_of(columns, first, min(first + size, columns.n))
            yield piece[:4]


def as_processor(
    model: Model | TNTConfig | str | Path | Processor[Any], **settings: Unpack[Settings]
) -> Processor[Any]:
    """A Processor from the arguments of `stream`."""
    if isinstance(model, Processor):
        if settings:
            raise TypeError(f"a Processor has its settings already, got also {', '.join(settings)}")
        return model
    if isinstance(model, (str, Path)):
        model = load_model(model)
    return Processor(model, **settings)
