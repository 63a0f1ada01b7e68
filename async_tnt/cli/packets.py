"""The packets of a recording, a camera or a network stream, by the options of a command."""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from async_tnt.cli.options import paths_of, positive_int
from async_tnt.cli.output import complain
from async_tnt.decision import Decision
from async_tnt.processor import Processor
from async_tnt.sources.files.recording import Recording
from async_tnt.sources.opening import open_source
from async_tnt.sources.pixel_selection import PixelSelector
from async_tnt.windows import TimeUnitCheck

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


def check_pace(args: argparse.Namespace) -> None:
    """Refuse --latest where all sources are recordings, and --speed where none is."""
    n_recordings, n_sources = sum(isinstance(path, Path) for path in paths_of(args)), len(paths_of(args))
    if args.latest is not None and n_recordings == n_sources:
        raise ValueError("--latest belongs to a camera or the network; a recording is never skipped")
    if args.speed is not None and n_recordings == 0:
        raise ValueError("--speed belongs to recordings; a camera or the network has a pace of its own")


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

    name: str
    source: Camera | UdpSource
    packets: Iterable[Any]
    reader: BackgroundReader | None
    """The queue in which they wait; None: nothing is skipped here, but the source's own buffer may overflow."""

    def announce(self) -> None:
        """Print that the source is open; from now on Ctrl-C stops it."""
        complain(f"listening at {self.name}; Ctrl-C stops")

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
        yield LivePackets(name, source, packets, reader)


def timed_packets(packets: Iterable[Any], processor: Processor) -> Iterator[tuple[list[Decision], float]]:
    """The decisions of each packet, and the microseconds that they took."""
    first = TimeUnitCheck(processor.config)
    for packet in packets:
        handed_over = time.perf_counter_ns()
        decisions = processor.push(packet)
        yield first.watch(decisions), (time.perf_counter_ns() - handed_over) / 1e3
