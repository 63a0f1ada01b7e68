"""async-tnt run: stream recordings event by event through a model."""

from __future__ import annotations

import argparse
import errno
import time
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.cli.options import (
    add_files,
    add_reading,
    add_start,
    add_triggers,
    check_reading,
    paths_of,
    positive_int,
    reading_of,
    triggers_of,
)
from async_tnt.cli.output import HEADER, Line, complain, complain_late, json_line, say, text_line
from async_tnt.cli.packets import add_keep_up, check_keep_up, find_sources, follow
from async_tnt.cli.pixel_options import add_pixels, model_pixels_of, pixels_of, sensor_to_read
from async_tnt.networks.engines import Engine, choose_engine
from async_tnt.sources.files.recording import Recording
from async_tnt.sources.pixels.model_pixels import ModelPixels
from async_tnt.streaming.compile_ahead import fill_cache
from async_tnt.streaming.decision import Decision, class_of_recording
from async_tnt.streaming.processor import Processor
from async_tnt.streaming.windows import TimeUnitCheck

if TYPE_CHECKING:
    from async_tnt.sources.queues.background_reader import BackgroundReader

DESCRIPTION = """Stream recordings event by event through a model and print each decision: its time and window, the
label and its probability, and the microseconds from the last event to the decision. After each recording a line names
the class of the highest mean probability over its closed windows.

  async-tnt run                              the ten bundled samples
  async-tnt run a.bin b.npz --every-us 5000  decide also every 5 ms
  async-tnt run --confidence 0.95            decide each window as soon as the class is certain
  async-tnt run udp://127.0.0.1:3333         events from the network, until Ctrl-C
  async-tnt run camera --every-us 2000 --keep-up 20    a camera, at most 20 ms behind (extra `cameras`)
  async-tnt run camera --roi 400,200,34,34 --crop --mask mask.npy    a part of it, without hot pixels
  async-tnt run --json | jq .label           one JSON object a line for each decision
  async-tnt run --model digits.onnx          a file of `async-tnt export`, run by onnxruntime (extra `onnx`)
  async-tnt run a.npz --model net.onnx --config net.json    any other ONNX network, compiled if it can be

An .onnx file differs in the last digits of the probabilities and in latency, not in windows or counted events.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_files(parser, live=True)
    add_start(parser)
    add_triggers(parser)
    parser.add_argument(
        "--hop-us",
        type=positive_int,
        metavar="US",
        help="time between the starts of windows; they overlap if it is shorter than a window",
    )
    parser.add_argument(
        "--late",
        choices=("accept", "drop", "raise"),
        default="accept",
        help="what to do with an event older than the newest one (default: %(default)s)",
    )
    add_pixels(parser)
    add_reading(parser)
    add_keep_up(parser)
    parser.add_argument(
        "--json", action="store_true", help="one JSON object a line for each decision"
    )


def main(args: argparse.Namespace) -> int:
    check_keep_up(args)
    check_reading(args)
    selection = pixels_of(args)
    engine = choose_engine(args.model, sensor_to_read(selection, args), args.config)
    pixels = model_pixels_of(selection, engine.model)
    fill_cache(model=engine.model, first=lambda: find_sources(paths_of(args), pixels))
    settings = {
        "start_us": args.start_us,
        "hop_us": args.hop_us,
        "late": args.late,
        **triggers_of(args),
    }
    processor = Processor(
        engine.model, classes=engine.classes, classifier=engine.classifier, **settings
    )
    processor.fire()  # the empty window changes nothing, but an engine's first call takes longer
    line = json_line if args.json else text_line
    failed = stopped = False
    headers = [] if args.json else [HEADER]
    for path in paths_of(args):
        try:
            if isinstance(path, str):
                stopped = run_source(path, processor, pixels, line, args.keep_up)
                if stopped:
                    break
                continue
            recording, select = pixels.open(path, **reading_of(args))
            if headers:
                say(headers.pop())
            print_decisions(
                recording,
                map(select, recording),
                processor,
                engine,
                pixels,
                line,
                summary=not args.json,
            )
        except BrokenPipeError:
            raise
        except (OSError, ValueError, ImportError) as error:
            # of our output, not of a recording
            if isinstance(error, OSError) and error.errno == errno.ENOSPC:
                raise
            complain(error if str(path) in str(error) else f"{path}: {error}")
            failed = True
    if pixels.summary():
        complain(f"left out: {pixels.summary()}")
    return 130 if stopped else 2 if failed else 0


def print_decisions(
    recording: Recording,
    packets: Iterable[np.ndarray],
    processor: Processor,
    engine: Engine,
    pixels: ModelPixels,
    line: Line,
    *,
    summary: bool,
) -> None:
    """A line for each decision and, with `summary`, one for the recording: the best mean
    probability of its windows.

    Raises
    ------
    ValueError : no window had an event.
    """
    processor.reset()
    closed = []
    for decision, latency_us in timed_decisions(packets, processor):
        say(line(str(recording.path), decision, latency_us))
        if decision.complete or decision.trigger == "end":
            closed.append(decision.probabilities)
    if closed and summary and decision.objects is None:
        label, words = class_of_recording(engine.classes, closed)
        say(f"{recording.path.name}: {label} ({words})")
    counts = processor.counts
    complain_late(str(recording.path), counts.dropped_late, counts.received, "--late, --start-us")
    if not closed:
        why = "no event in any window" if counts.received else pixels.nothing
        raise ValueError(f"{recording.path}: {why}")


def timed_decisions(
    packets: Iterable[Any], processor: Processor
) -> Iterator[tuple[Decision, float]]:
    """Each decision, and its latency in microseconds, from the call with the event that caused
    it."""
    clock, time_unit = time.perf_counter_ns, TimeUnitCheck(processor.config)
    for packet in packets:
        for t, x, y, p in zip(
            *(packet[field].tolist() for field in ("t", "x", "y", "p")), strict=True
        ):
            handed_over = clock()
            decisions = processor.push_one(t, x, y, p)
            if decisions:
                latency_us = (clock() - handed_over) / 1e3
                for decision in time_unit.watch(decisions):
                    yield decision, latency_us
    handed_over = clock()
    decisions = processor.finish()
    latency_us = (clock() - handed_over) / 1e3
    for decision in decisions:
        yield decision, latency_us


def run_source(
    name: str, processor: Processor, pixels: ModelPixels, line: Line, keep_up_ms: int | None
) -> bool:
    """Print decisions until the source ends or Ctrl-C; then print the counts. Returns whether
    Ctrl-C ended it.

    Parameters
    ----------
    name : of the source, as `open_source` takes it.
    keep_up_ms : see `follow`.
    """
    processor.reset()

    def print_all(packets: Iterable[Any], reader: BackgroundReader | None) -> None:
        for decision, latency_us in _timed_packets(packets, processor):
            say(line(name, decision, latency_us, reader))

    def end(reader: BackgroundReader | None) -> str:
        for decision in processor.finish():
            say(line(name, decision, 0.0, reader))
        counts = processor.counts
        moved_off = counts.dropped_outside + counts.dropped_tau_zero
        return (
            f"; {counts.kept:,} kept, {moved_off:,} moved off the grid by the transform, "
            f"{counts.dropped_late:,} too late for their window, {counts.dropped_decided:,} after "
            "it was decided"
        )

    return follow(name, pixels, processor, keep_up_ms, print_all, end)


def _timed_packets(
    packets: Iterable[np.ndarray], processor: Processor
) -> Iterator[tuple[Decision, float]]:
    """Each decision, and the microseconds that the decisions of its packet took."""
    time_unit = TimeUnitCheck(processor.config)
    for packet in packets:
        handed_over = time.perf_counter_ns()
        decisions = processor.push(packet)
        latency_us = (time.perf_counter_ns() - handed_over) / 1e3
        for decision in time_unit.watch(decisions):
            yield decision, latency_us
