"""The packets of a recording, a camera or a network stream, by the options of a command."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from async_tnt.cli.options import paths_of, positive_int
from async_tnt.cli.output import complain
from async_tnt.sources.files.recording import Recording
from async_tnt.sources.opening import open_source
from async_tnt.sources.pixel_selection import PixelSelector

if TYPE_CHECKING:
    from async_tnt.sources.background_reader import BackgroundReader
    from async_tnt.sources.cameras import Camera
    from async_tnt.sources.udp import UdpSource


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


@dataclass(frozen=True)
class LivePackets:
    """An open source, and its packets without the pixels to leave out."""

    source: Camera | UdpSource
    packets: Iterable[Any]
    reader: BackgroundReader | None
    """The queue in which they wait; None: nothing is skipped here, but the source's own buffer may overflow."""

    def summary(self) -> str:
        """Received and skipped events in one line of text."""
        if self.reader is None:
            return self.source.summary()
        queue = self.reader.counters
        fresh = f"{queue.skipped:,} skipped to stay fresh, at most {queue.longest_wait_us / 1e3:,.1f} ms waited"
        return f"{self.source.summary()}; {fresh}"


@contextlib.contextmanager
def live_packets(name: str, pixels: PixelSelector, latest: int | None) -> Iterator[LivePackets]:
    """Open what `open_source` knows by this name, and close it at the end.

    Parameters
    ----------
    latest : largest number of waiting packets; None for no queue.
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
        yield LivePackets(source, packets, reader)


def follow(
    name: str,
    pixels: PixelSelector,
    latest: int | None,
    take: Callable[[LivePackets], object],
    end: Callable[[], str] = lambda: "",
) -> bool:
    """Let `take` read a source until that ends or Ctrl-C; then print its counts, and what `end` adds to them.

    Returns whether Ctrl-C ended it.
    """
    with live_packets(name, pixels, latest) as stream:
        try:
            complain(f"listening at {name}; Ctrl-C stops")
            take(stream)
        except KeyboardInterrupt:
            return True
        finally:  # also if a camera was unplugged
            complain(f"{name}: {stream.summary()}{end()}")
    return False
