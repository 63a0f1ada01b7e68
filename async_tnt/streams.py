"""stream and astream: a source of events in, decisions out."""

from __future__ import annotations

from collections.abc import AsyncIterable, AsyncIterator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypedDict, Unpack

from async_tnt.config import TNTConfig
from async_tnt.decision import Decision
from async_tnt.events import Late
from async_tnt.networks.loading import load_model
from async_tnt.networks.model import Model
from async_tnt.processor import Processor
from async_tnt.triggers import LeakyIntegrator
from async_tnt.volume_state import Regressor
from async_tnt.window_classifier import Classifier
from async_tnt.windows import TimeUnitCheck


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
    activity: LeakyIntegrator | None
    late: Late
    replay_events: int


def stream(
    source: Iterable[Any], model: Model | TNTConfig | str | Path | Processor, **settings: Unpack[Settings]
) -> Iterator[Decision]:
    """Classify a source of events, lazily.

    Parameters
    ----------
    source : an iterable of packets, or of single events, in any form that `async_tnt.event_forms` lists.
    model : a Model, its name or path, a TNTConfig (with `classifier=`, and `regressor=` if its landmark needs one),
        or a Processor, which continues its stream.
    settings : keyword arguments of `Processor`: `every_us`, `every_events`, `hop_us`, `start_us`, `late`, ...

    Yields
    ------
    Decision : for each window that closes and each trigger; when the source ends, for the windows still open.

    Examples
    --------
    >>> from async_tnt.sources import open_recording, sample_recordings
    >>> [decision.label for decision in stream(open_recording(sample_recordings()[3]), "digits")]
    ['3', '3', '3']
    """
    if isinstance(source, (str, Path)):
        raise TypeError(f"`source` must yield events, got the path {source}; open_recording(path) reads a file")
    if not hasattr(source, "__iter__") and not hasattr(source, "__getitem__"):
        raise TypeError(f"`source` must be an iterable of packets or of events, got {type(source).__name__}")
    return _stream(source, as_processor(model, **settings))  # here: errors are raised before the first event


def _stream(source: Iterable[Any], processor: Processor) -> Iterator[Decision]:
    first = TimeUnitCheck(processor.config)
    for events in source:
        yield from first.watch(processor.push(events))
    yield from processor.finish()


def astream(
    source: AsyncIterable[Any], model: Model | TNTConfig | str | Path | Processor, **settings: Unpack[Settings]
) -> AsyncIterator[Decision]:
    """`stream` for an asynchronous `source`. The classifier runs in the event loop, for microseconds at a time.

    `model` and `settings` are those of `stream`.

    Raises
    ------
    TypeError : `source` is not asynchronous.
    """
    if not hasattr(source, "__aiter__"):
        raise TypeError(
            f"`source` must be asynchronous, got {type(source).__name__}; `stream` takes iterables that are not"
        )
    return _astream(source, as_processor(model, **settings))  # here: errors are raised before the first event


async def _astream(source: AsyncIterable[Any], processor: Processor) -> AsyncIterator[Decision]:
    first = TimeUnitCheck(processor.config)
    async for events in source:
        for decision in first.watch(processor.push(events)):
            yield decision
    for decision in processor.finish():
        yield decision


def as_processor(model: Model | TNTConfig | str | Path | Processor, **settings: Unpack[Settings]) -> Processor:
    """A Processor from the arguments of `stream`."""
    if isinstance(model, Processor):
        if settings:
            raise TypeError(f"a Processor has its settings already, got also {', '.join(settings)}")
        return model
    if isinstance(model, (str, Path)):
        model = load_model(model)
    return Processor(model, **settings)
