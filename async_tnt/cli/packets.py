"""The packets of a recording, a camera or a network stream, by the options of a command."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from async_tnt.cli.options import paths_of, positive_int
from async_tnt.cli.output import complain
from async_tnt.sources.files.recording import Recording
from async_tnt.sources.opening import open_source
from async_tnt.sources.pixel_selection import PixelSelector

if TYPE_CHECKING:
    from async_tnt.sources.background_reader import BackgroundReader


def add_latest(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--latest",
        type=positive_int,
        metavar="PACKETS",
        help="camera or network: read in the background and keep at most this many packets waiting; if decisions are "
        "slower than events, the oldest packets are skipped and counted",
    )


def check_latest(args: argparse.Namespace) -> None:
    """Refuse --latest where all sources are recordings."""
    if args.latest is not None and all(isinstance(path, Path) for path in paths_of(args)):
        raise ValueError("--latest belongs to a camera or the network; a recording is never skipped")


def open_selected(path: Any, pixels: PixelSelector) -> tuple[Recording, Iterator[Any]]:
    """A recording, and its packets without the pixels to leave out.

    Raises
    ------
    ValueError, OSError : unreadable, or recorded with another sensor than the model's.
    """
    recording, sensor = pixels.open(path)
    if recording.stated_sensor is None:
        pixels.check_events(recording, path, sensor)
    return recording, map(pixels.filter_of(path, sensor), recording)


def follow(
    name: str,
    pixels: PixelSelector,
    latest: int | None,
    take: Callable[[Iterable[Any], BackgroundReader | None], object],
    end: Callable[[], str] = lambda: "",
) -> bool:
    """Let `take` read a source until that ends or Ctrl-C; then print its counts. Returns whether Ctrl-C ended it.

    Parameters
    ----------
    name : of the source, as `open_source` knows it.
    latest : largest number of waiting packets; None for no queue: nothing is skipped here, but the source's own buffer
        may overflow.
    take : gets the packets without the pixels to leave out, and the queue in which they wait.
    end : what it returns is printed behind the counts.
    """
    with contextlib.ExitStack() as stack:
        source = open_source(name, pixels.expected)
        stack.callback(source.close)
        select = pixels.filter_of(name, pixels.sensor_of(name, source.sensor))
        packets: Iterable[Any] = map(select, source)
        reader = None
        if latest is not None:
            from async_tnt.sources.background_reader import BackgroundReader  # imports asyncio

            # copy=False: cameras and the network put each packet in new memory
            reader = BackgroundReader(packets, latest=True, max_packets=latest, copy=False, on_close=source.close)
            packets = stack.enter_context(reader)
        try:
            complain(f"listening at {name}; Ctrl-C stops")
            take(packets, reader)
        except KeyboardInterrupt:
            return True
        finally:  # also if a camera was unplugged
            counts = source.summary()
            if reader is not None:
                queue = reader.counters
                waited_ms = queue.longest_wait_us / 1e3
                counts += f"; {queue.skipped:,} skipped to stay fresh, at most {waited_ms:,.1f} ms waited"
            complain(f"{name}: {counts}{end()}")
    return False
