"""Decisions of a live stream: from a camera or the network."""

from __future__ import annotations

from async_tnt.cli.live_packets import live_packets, timed_packets
from async_tnt.cli.live_view import draw_stream
from async_tnt.cli.output import Line, complain, say
from async_tnt.networks.engines import Engine
from async_tnt.processor import Processor
from async_tnt.sources.pixel_selector import PixelSelector


def run_source(
    name: str,
    processor: Processor,
    engine: Engine,
    pixels: PixelSelector,
    line: Line,
    *,
    latest: int | None,
    live: bool,
) -> bool:
    """Print or draw decisions until the source ends or Ctrl-C; then print the counts. Returns whether Ctrl-C ended it.

    Parameters
    ----------
    name : of the source, as `open_source` takes it.
    latest : see `live_packets`.
    """
    processor.reset()
    stopped = False
    with live_packets(name, pixels, latest) as stream:
        try:
            stream.announce()
            if live:
                draw_stream(name, engine.classes, stream.packets, processor, stream.reader)
            else:
                for decisions, latency_us in timed_packets(stream.packets, processor):
                    for decision in decisions:
                        say(line(name, decision, latency_us, stream.reader))
        except KeyboardInterrupt:
            stopped = True
        finally:  # also if a camera was unplugged
            for decision in processor.finish():
                if not live:
                    say(line(name, decision, 0.0))
            counts = processor.counts
            took = (
                f"{counts.kept:,} kept, {counts.moved_off:,} moved off the grid by the transform, "
                f"{counts.dropped_late:,} too late for their window"
            )
            complain(f"{name}: {stream.summary()}; {took}")
    return stopped
