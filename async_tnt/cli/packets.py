"""The packets of a recording, a camera or a network stream, by the options of a command."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from async_tnt.cli.options import paths_of, positive_int
from async_tnt.cli.output import EXPECTED_ERRORS, complain
from async_tnt.sources.opening import open_source
from async_tnt.sources.pixels.model_pixels import ModelPixels

if TYPE_CHECKING:
    from async_tnt.sources.queues.keep_up import KeepUp
    from async_tnt.streaming.processor import Processor


def add_keep_up(parser: argparse.ArgumentParser) -> None:
    """Add --keep-up."""
    parser.add_argument(
        "--keep-up",
        type=positive_int,
        metavar="MS",
        help="camera or network: if decisions are slower than events, decide less often "
        "(--every-us, --every-events), then skip and count packets; only the newest packet may be "
        "more than MS milliseconds old",
    )


def check_keep_up(args: argparse.Namespace) -> None:
    """Refuse --keep-up if all sources are recordings."""
    if args.keep_up is not None and all(isinstance(path, Path) for path in paths_of(args)):
        raise ValueError(
            "--keep-up belongs to a camera or the network; a recording is never skipped"
        )


def check_sources(
    paths: Sequence[Path | str], pixels: ModelPixels, option_names: Mapping[str, str] | None = None
) -> None:
    """Check that at least one of these sources can be opened.

    The sources are tried in order until one can be opened. It is closed again.

    Parameters
    ----------
    paths : paths of recordings, and names of cameras and network streams.
    pixels : the pixels that the model sees; they must suit the source, too.
    option_names : parameter -> the option that gives it, for the errors that are printed.

    Raises
    ------
    ValueError, OSError, ImportError, MemoryError : no source can be opened. The error is that of
        the last source; the errors of all earlier sources are printed.
    """
    problems: list[Exception] = []
    for path in paths:
        try:
            if isinstance(path, Path):
                pixels.open(path)
            else:
                with contextlib.closing(open_source(path, pixels.expected)) as source:
                    pixels.filter_of(path, source.sensor)
        except EXPECTED_ERRORS as error:
            problems.append(error)
        else:
            return
    for problem in problems[:-1]:
        complain(problem, option_names)
    raise problems[-1]


def follow(
    name: str,
    pixels: ModelPixels,
    processor: Processor,
    keep_up_ms: int | None,
    take: Callable[[Iterable[Any], KeepUp | None], object],
    end_text: Callable[[KeepUp | None], str] = lambda queue: "",
) -> bool:
    """Let `take` read a camera or a network stream, and print the source's counts at the end.

    Reading ends when the source ends, or at Ctrl-C. Returns whether Ctrl-C ended it.

    Parameters
    ----------
    name : name of the source, as `open_source` takes it.
    processor : the Processor to which `take` gives the packets.
    keep_up_ms : the value of --keep-up. None: no packet is skipped here, but the source's own
        buffer may overflow.
    take : called once, with the packets and with the queue in which they wait; None without
        --keep-up. The packets hold only events of the pixels that the model sees.
    end_text : called with the same queue at the end. Its text is printed after the counts.
    """
    with contextlib.ExitStack() as stack:
        source = open_source(name, pixels.expected)
        stack.callback(source.close)
        packets: Iterable[Any] = map(pixels.filter_of(name, source.sensor), source)
        queue = None
        if keep_up_ms is not None:
            from async_tnt.sources.queues.keep_up import KeepUp  # imports asyncio

            queue = KeepUp(
                packets,
                processor,
                max_delay_us=1_000 * keep_up_ms,
                copy=False,  # cameras and the network put each packet in new memory
                on_close=source.close,
            )
            packets = stack.enter_context(queue)
        try:
            complain(f"listening at {source.name}; Ctrl-C stops")
            take(packets, queue)
        except KeyboardInterrupt:
            return True
        finally:  # the counts are printed even if a camera was unplugged
            counts = source.summary()
            if queue is not None:
                queue.close()  # packets that still wait are skipped
                counts += _queue_text(queue)
            complain(f"{source.name}: {counts}{end_text(queue)}")
    return False


def _queue_text(queue: KeepUp) -> str:
    """Text for the counts: what a queue did so that decisions keep up with the events."""
    counters = queue.counters
    waited_ms = counters.longest_wait_us / 1e3
    text = f"; {counters.skipped:,} skipped to stay fresh, at most {waited_ms:,.1f} ms waited"
    if queue.slowest > 1:
        text += f", decisions up to {queue.slowest} times rarer"
    return text
