"""async-tnt run: stream recordings through a model."""

from __future__ import annotations

import argparse
import errno
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.base.files import check_writable, user_path
from async_tnt.cli.lessons import check_teachable
from async_tnt.cli.options import (
    add_files,
    add_reading,
    add_start,
    add_triggers,
    check_reading,
    paths_of,
    reading_of,
    refuse_graph,
    triggers_of,
)
from async_tnt.cli.output import (
    EXPECTED_ERRORS,
    DecisionLines,
    complain,
    complain_late,
    message_of,
    say,
)
from async_tnt.cli.packets import add_keep_up, check_keep_up, check_sources, follow
from async_tnt.cli.pixel_options import add_pixels, map_model_sensor, model_pixels_of, pixels_of
from async_tnt.networks.engines import Engine, choose_engine
from async_tnt.networks.models.model import Model
from async_tnt.sources.pixels.model_pixels import ModelPixels
from async_tnt.streaming.compile_ahead import must_compile
from async_tnt.streaming.decision import Decision, class_of_recording
from async_tnt.streaming.output import Output
from async_tnt.streaming.processor import Processor
from async_tnt.streaming.streams import pieces_for
from async_tnt.streaming.windows import TimeUnitCheck

if TYPE_CHECKING:
    from async_tnt.cli.live_lessons import LiveLessons
    from async_tnt.sources.queues.background_reader import BackgroundReader

DESCRIPTION = """\
Stream recordings through a model and print each decision: its time and window, the label and its
probability, and the number of events. After each recording a line names the class of the highest
mean probability over its closed windows. For a model of raw outputs, each line has the least and
the largest number of each output.

  async-tnt run                              the ten bundled samples
  async-tnt run a.bin b.npz --every-us 5000  decide also every 5 ms
  async-tnt run --confidence 0.95            decide each window as soon as the class is certain
  async-tnt run udp://127.0.0.1:3333         events from the network, until Ctrl-C
  async-tnt run camera --every-us 2000 --keep-up 20
                                             a camera, at most 20 ms behind (extra `cameras`)
  async-tnt run camera --roi 400,200,34,34 --crop --mask mask.npy
                                             a part of it, without hot pixels
  async-tnt run camera --model mine.safetensors --teach more.safetensors
                                             type a name and Enter: what is shown for the
                                             next ten seconds becomes a class of this name
  async-tnt run --json | jq .label           one JSON object a line for each decision
  async-tnt run --latency                    say also how long each decision took
  async-tnt run --model digits.onnx          a file of `async-tnt export`, run by onnxruntime
                                             (extra `onnx`)
  async-tnt run a.npz --model net.onnx --config net.json
                                             any other ONNX network, compiled if it can be

With an .onnx file the last digits of the probabilities and the latency differ, but not the windows
or the counted events.
"""
REMOVED = {
    "--late": "late events are used; in Python, Processor(model, late=...) drops or refuses them",
    "--hop-us": "in Python, Processor(model, hop_us=...) has overlapping windows",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_files(parser, live=True)
    add_start(parser)
    add_triggers(parser)
    add_pixels(parser)
    add_reading(parser)
    add_keep_up(parser)
    parser.add_argument(
        "--latency",
        action="store_true",
        help="print also the microseconds from the call with an event to its decision. Recordings "
        "are then pushed event by event, which takes ten times as long; events of a camera or the "
        "network are pushed packet by packet",
    )
    parser.add_argument(
        "--teach",
        type=user_path,
        metavar="FILE",
        help="on a terminal, with a camera or the network: each line that you type is the name of "
        "a class, which is taught by the next ten seconds of the stream; the model is written to "
        "FILE then",
    )
    parser.add_argument(
        "--json", action="store_true", help="one JSON object a line for each decision"
    )


@dataclass(frozen=True)
class _Run:
    """The objects that the events of all sources pass through.

    Attributes
    ----------
    engine : the model, and what computes it.
    processor : the Processor, which is reset before each source.
    pixels : the pixels whose events count.
    lines : prints the decisions.
    lessons : teaches classes meanwhile, with --teach.
    """

    engine: Engine
    processor: Processor[Any]
    pixels: ModelPixels
    lines: DecisionLines
    lessons: LiveLessons | None = None


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt run`. Returns the exit code."""
    check_keep_up(args)
    check_reading(args)
    _check_teach(args)
    run = _prepare(args)

    stopped = False
    failed = False
    has_header = False
    for path in paths_of(args):
        try:
            if isinstance(path, str):
                stopped = _run_live(run, path, args.keep_up)
                if stopped:
                    break
            else:
                recording, select = run.pixels.open(path, **reading_of(args))
                if not has_header:
                    run.lines.print_header()
                    has_header = True
                _run_recording(run, path, map(select, recording))
        except BrokenPipeError:
            raise
        except EXPECTED_ERRORS as error:
            if isinstance(error, OSError) and error.errno == errno.ENOSPC:
                # our output does not fit on its disk, so the error is not about this recording
                raise
            message = message_of(error, args.option_names)
            complain(message if str(path) in message else f"{path}: {message}")
            failed = True

    if run.pixels.summary():
        complain(f"left out: {run.pixels.summary()}")
    if stopped:
        return 130
    return 2 if failed else 0


def _check_teach(args: argparse.Namespace) -> None:
    """Refuse --teach without one live source, and a file that cannot be written."""
    if args.teach is None:
        return
    check_writable(args.teach, (".safetensors",))
    paths = paths_of(args)
    if len(paths) != 1 or isinstance(paths[0], Path):
        raise ValueError(
            "--teach needs one camera or network stream; async-tnt teach learns from recordings"
        )


def _prepare(args: argparse.Namespace) -> _Run:
    """Load the model and make the Processor.

    If kernels must still be compiled, check before this wait that a source can be opened.

    Raises
    ------
    ValueError, OSError, ImportError, MemoryError : the model cannot be read, or does not suit the
        options; or kernels must still be compiled, and no source can be opened.
    """
    selection = pixels_of(args)
    refuse_graph(args.model)
    engine = choose_engine(args.model, map_model_sensor(selection, args), args.config)
    pixels = model_pixels_of(selection, engine.model)
    if must_compile():
        # A missing source is reported before the wait for the compilation.
        check_sources(paths_of(args), pixels, args.option_names)
    processor = Processor(
        engine.model,
        classes=engine.classes,
        classifier=engine.classifier,
        start_us=args.start_us,
        **triggers_of(args, engine.config),
    )
    # The first call of an engine takes longer, so it is made now. A decision about an empty window
    # changes nothing.
    processor.fire()
    lines = DecisionLines(args.json, args.latency, of_outputs=processor.answers_are_views)
    lessons = None if args.teach is None else _lessons(args, engine)
    return _Run(engine, processor, pixels, lines, lessons)


def _lessons(args: argparse.Namespace, engine: Engine) -> LiveLessons:
    """What teaches classes meanwhile, with --teach.

    Raises
    ------
    ValueError : no class can be taught to the model, or stdin is no terminal.
    """
    from async_tnt.cli.live_lessons import LiveLessons, typed_names  # imports threads' pools

    if not isinstance(engine.model, Model) or engine.classifier is not None:
        raise ValueError(f"--teach needs a .safetensors model, got {args.model}")
    check_teachable(engine.model, str(args.model))
    return LiveLessons(engine.model, args.teach, typed_names())


# -- recordings ------------------------------------------------------------------------------------


def _run_recording(run: _Run, path: Path, packets: Iterable[np.ndarray]) -> None:
    """Print the decisions of a recording, then the recording's class.

    The class of the recording is the one with the highest mean probability over the closed windows.
    With --json, for a model that finds objects, and for raw outputs, the class is left out.

    Raises
    ------
    ValueError : no window had an event.
    """
    run.processor.reset()
    push = _push_events if run.lines.with_latency else _push_packets
    n_windows = 0
    window_probabilities = []
    for answer, latency_us in _with_last_decisions(push(packets, run.processor), run.processor):
        run.lines.print(str(path), answer, latency_us)
        if answer.complete or answer.trigger == "end":
            n_windows += 1
            if isinstance(answer, Decision) and answer.objects is None:
                window_probabilities.append(answer.probabilities)

    if window_probabilities and not run.lines.as_json:
        label, details = class_of_recording(run.engine.classes, window_probabilities)
        say(f"{path.name}: {label} ({details})")
    counts = run.processor.counts
    complain_late(str(path), counts.dropped_late, counts.received, "--start-us")
    if not n_windows:
        reason = "no event in any window" if counts.received else run.pixels.no_events_message
        raise ValueError(f"{path}: {reason}")


def _push_packets(
    packets: Iterable[np.ndarray], processor: Processor[Any]
) -> Iterator[tuple[Decision | Output, float]]:
    """Push packets. Yields each decision, and the microseconds of the call that made it."""
    time_unit = TimeUnitCheck(processor.config)
    for packet in packets:
        for piece in pieces_for(processor, packet):
            started_ns = time.perf_counter_ns()
            decisions = processor.push(piece)
            latency_us = (time.perf_counter_ns() - started_ns) / 1e3
            for decision in time_unit.watch(decisions):
                yield decision, latency_us


def _push_events(
    packets: Iterable[np.ndarray], processor: Processor[Any]
) -> Iterator[tuple[Decision | Output, float]]:
    """Push single events. Yields each decision, and the microseconds of the call that made it."""
    clock_ns = time.perf_counter_ns
    time_unit = TimeUnitCheck(processor.config)
    for packet in packets:
        columns = [packet[field].tolist() for field in ("t", "x", "y", "p")]
        for t, x, y, p in zip(*columns, strict=True):
            started_ns = clock_ns()
            decisions = processor.push_one(t, x, y, p)
            if decisions:
                latency_us = (clock_ns() - started_ns) / 1e3
                for decision in time_unit.watch(decisions):
                    yield decision, latency_us


def _with_last_decisions(
    earlier_decisions: Iterable[tuple[Decision | Output, float]], processor: Processor[Any]
) -> Iterator[tuple[Decision | Output, float]]:
    """Yield the earlier decisions, then those of `finish`, with the microseconds of its call."""
    yield from earlier_decisions
    started_ns = time.perf_counter_ns()
    last_decisions = processor.finish()
    latency_us = (time.perf_counter_ns() - started_ns) / 1e3
    for decision in last_decisions:
        yield decision, latency_us


# -- a camera or the network -----------------------------------------------------------------------


def _run_live(run: _Run, name: str, keep_up_ms: int | None) -> bool:
    """Print the decisions of a camera or a network stream, and the counts at the end.

    Reading ends when the source ends, or at Ctrl-C. Returns whether Ctrl-C ended it.

    Parameters
    ----------
    name : name of the source, as `open_source` takes it.
    keep_up_ms : see `follow`.
    """
    run.processor.reset()

    def print_all(packets: Iterable[Any], queue: BackgroundReader | None) -> None:
        if run.lessons is not None:
            packets = run.lessons.watch(packets, run.processor)
        for decision, latency_us in _push_packets(packets, run.processor):
            run.lines.print(name, decision, latency_us, queue)

    def print_last_decisions(queue: BackgroundReader | None) -> str:
        for decision, latency_us in _with_last_decisions((), run.processor):
            run.lines.print(name, decision, latency_us, queue)
        counts = run.processor.counts
        n_moved_off = counts.dropped_outside + counts.dropped_tau_zero
        return (
            f"; {counts.kept:,} kept, {n_moved_off:,} moved off the grid by the transform, "
            f"{counts.dropped_late:,} too late for their window, {counts.dropped_decided:,} after "
            "it was decided"
        )

    return follow(name, run.pixels, run.processor, keep_up_ms, print_all, print_last_decisions)
