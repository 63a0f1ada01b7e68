"""async-tnt run: stream recordings event by event through a model."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np

from ..decision import Decision
from ..engines.choice import ENGINES, Engine, choose_engine
from ..processor import Processor
from ..recordings import Recording
from ..sources import replay
from ..warmup import warmup
from .files import add_files, add_start, complain, open_all, paths_of, positive_int
from .live_view import LiveView
from .run_source import run_source
from .trigger_options import add_triggers, triggers_of

DESCRIPTION = """Stream recordings event by event through a model and print each decision: when it fell, for which
window, the label and its probability, and the microseconds from the last event to the decision. A line
for each recording follows: the class of the highest mean probability over its closed windows.

  async-tnt run                              the ten bundled samples
  async-tnt run a.bin b.npz --every-us 5000  decide also every 5 ms
  async-tnt run --confidence 0.95            decide each window as soon as that is sure
  async-tnt run --activity 60:4000           decide when 60 events come within some 4 ms
  async-tnt run udp://127.0.0.1:3333         events from the network, until Ctrl-C
  async-tnt run --json | jq .label           one JSON object a line for each decision
  async-tnt run a.bin --live --speed 0.2     watch it, at a fifth of its pace (extra `view`)
  async-tnt run --engine onnx                the same network by onnxruntime (extra `onnx`), or torch
  async-tnt run --model digits.onnx          a file that `async-tnt export` wrote, by onnxruntime

Engines differ in the last digits of the probabilities and in the microseconds to a decision, not in the windows or the
events that count.
"""
HEADER = f"{'recording':<16} {'time ms':>9} {'window ms':>19}  {'label':<8} {'prob':>5} {'events':>7} {'us':>7}  why"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_files(parser, onnx=True, streams=True)
    add_start(parser)
    add_triggers(parser)
    parser.add_argument(
        "--hop-us", type=positive_int, metavar="US",
        help="distance between the starts of windows; smaller than a window: they overlap",
    )  # fmt: skip
    parser.add_argument(
        "--late", choices=("accept", "drop", "raise"), default="accept",
        help="what to do with an event older than the newest one (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--engine", choices=ENGINES,
        help="what runs the model's networks (default: compiled; onnx for an .onnx file, which runs by nothing else)",
    )  # fmt: skip
    parser.add_argument(
        "--live", action="store_true",
        help="a small view in the terminal, at the recording's pace: label, probabilities, rates (extra `view`)",
    )  # fmt: skip
    parser.add_argument("--speed", type=_speed, metavar="S", help="of --live: 2 is twice as fast (default: 1)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line for each decision")


def main(args: argparse.Namespace) -> int:
    if args.live and args.json:
        raise ValueError("--live draws for people and --json writes for programs: give one of them")
    if args.speed is not None and not args.live:
        raise ValueError("--speed belongs to --live; without it a recording is streamed as fast as it can be")
    engine = choose_engine(args.model, args.engine)
    processor = engine.processor(
        start_us=args.start_us, hop_us=args.hop_us, late=args.late, **triggers_of(args)
    )  # fmt: skip
    warmup(engine.model)
    processor.fire()  # of the empty window: changes nothing, but an engine's first call takes longer
    show = json_line if args.json else text_line
    failed = False
    header = "" if args.json or args.live else HEADER + "\n"
    for path in paths_of(args):
        try:
            if isinstance(path, str):
                if run_source(path, processor, engine, show, args.live):
                    return 130
                continue
            (recording,) = open_all([path], engine)
            print(end=header)
            header = ""
            if args.live:
                _watch(recording, processor, engine, args.speed or 1.0)
            else:
                _run(recording, processor, engine, args.json, sys.stdout)
        except BrokenPipeError:
            raise
        except (OSError, ValueError) as error:
            complain(error)
            failed = True
    return 2 if failed else 0


def _run(recording: Recording, processor: Processor, engine: Engine, as_json: bool, out: TextIO) -> None:
    processor.reset()
    closed = []
    for decision, latency_us in timed_decisions(recording, processor):
        print((json_line if as_json else text_line)(str(recording.path), decision, latency_us), file=out, flush=True)
        if decision.complete or decision.trigger == "end":
            closed.append(decision.probabilities)
    if closed and not as_json:
        mean = np.mean(closed, axis=0)
        best = int(mean.argmax())
        windows = "1 window" if len(closed) == 1 else f"{len(closed)} windows"
        print(f"{recording.path.name}: {engine.classes[best]} (mean probability {mean[best]:.3f} of {windows})")
    late = processor.counts.dropped_late
    if late:
        complain(
            f"{recording.path}: {late} of {recording.n_events} events dropped: they came late (see --late, --start-us)"
        )
    if not closed:
        raise ValueError(f"{recording.path}: no event in any window, nothing to decide")


def _watch(recording: Recording, processor: Processor, engine: Engine, speed: float) -> None:
    """Draw the stream at the recording's pace; a decision each 20 ms, where no trigger says when."""
    processor.reset()
    triggers = (processor.every_us, processor.every_events, processor.confidence, processor.activity)
    if triggers == (None, None, None, None):
        processor.every_us = 20_000
    with LiveView(engine.classes, recording.path.name) as view:
        for packet in replay(recording, speed):
            handed_over = time.perf_counter_ns()
            decisions = processor.push(packet)
            view.show(decisions, (time.perf_counter_ns() - handed_over) / 1e3, processor.counts)
        view.show(processor.finish(), 0.0, processor.counts)


def _speed(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not value > 0:
        raise argparse.ArgumentTypeError(f"must be a positive number, got {text!r}")
    return value


def timed_decisions(recording: Recording, processor: Processor) -> Iterator[tuple[Decision, float]]:
    """Each decision, and the microseconds from handing over the event that brought it about."""
    clock = time.perf_counter_ns
    for packet in recording:
        for t, x, y, p in zip(*(packet[field].tolist() for field in ("t", "x", "y", "p")), strict=True):
            handed_over = clock()
            decisions = processor.push_one(t, x, y, p)
            if decisions:
                latency_us = (clock() - handed_over) / 1e3
                for decision in decisions:
                    yield decision, latency_us
    handed_over = clock()
    decisions = processor.finish()
    latency_us = (clock() - handed_over) / 1e3
    for decision in decisions:
        yield decision, latency_us


def text_line(name: str, decision: Decision, latency_us: float) -> str:
    start_ms = decision.window_start_us / 1e3
    window = f"{start_ms:.3f}+{(decision.time_us - decision.window_start_us) / 1e3:.3f}"
    return (
        f"{Path(name).name:<16} {decision.time_us / 1e3:>9.3f} {window:>19}  {decision.label:<8} "
        f"{decision.probability:>5.3f} {decision.events:>7} {latency_us:>7.1f}  {decision.trigger}"
    )


def json_line(name: str, decision: Decision, latency_us: float) -> str:
    return json.dumps(
        {
            "recording": name,
            "time_us": decision.time_us,
            "window_start_us": decision.window_start_us,
            "label": decision.label,
            "probability": round(decision.probability, 6),
            "probabilities": [round(float(p), 6) for p in decision.probabilities],
            "events": decision.events,
            "complete": decision.complete,
            "trigger": decision.trigger,
            "latency_us": round(latency_us, 3),
        }
    )
