"""async-tnt run: stream recordings event by event through a model."""

from __future__ import annotations

import argparse
import errno

from async_tnt.cli.archive_options import add_archive, check_no_archive
from async_tnt.cli.live_packets import add_latest, check_pace
from async_tnt.cli.live_view import draw_stream
from async_tnt.cli.options import (
    add_files,
    add_start,
    add_triggers,
    paths_of,
    positive_int,
    positive_number,
    triggers_of,
)
from async_tnt.cli.output import HEADER, complain, json_line, say, text_line
from async_tnt.cli.pixel_options import add_pixels, selector_of
from async_tnt.cli.run_recording import open_selected, print_decisions
from async_tnt.compile_ahead import fill_cache
from async_tnt.networks.engines import ENGINES, choose_engine
from async_tnt.processor import Processor
from async_tnt.sources.playback import replay

DESCRIPTION = """Stream recordings event by event through a model and print each decision: its time and window, the
label and its probability, and the microseconds from the last event to the decision. After each recording a line names
the class of the highest mean probability over its closed windows.

  async-tnt run                              the ten bundled samples
  async-tnt run a.bin b.npz --every-us 5000  decide also every 5 ms
  async-tnt run --confidence 0.95            decide each window as soon as the class is certain
  async-tnt run --activity 60:4000           decide when 60 events arrive within about 4 ms
  async-tnt run udp://127.0.0.1:3333         events from the network, until Ctrl-C
  async-tnt run camera --live --latest 64    a camera, shown in the terminal without delay (extra `cameras`)
  async-tnt run camera --roi 400,200,34,34 --crop --mask mask.npy    a part of it, without hot pixels
  async-tnt run --json | jq .label           one JSON object a line for each decision
  async-tnt run archive --out r.jsonl --workers 4    all recordings under a folder, resumable (docs/guide.md)
  async-tnt run archive --out r.jsonl --mask mask.npy  without the events of hot pixels
  async-tnt run a.bin --live --speed 0.2     watch it at a fifth of the recorded speed (extra `view`)
  async-tnt run --engine onnx                the same network run by onnxruntime (extra `onnx`), or torch
  async-tnt run --model digits.onnx          a file written by `async-tnt export`, run by onnxruntime

Engines differ in the last digits of the probabilities and in latency, not in windows or counted events.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_files(parser, onnx=True, streams=True)
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
    parser.add_argument(
        "--engine",
        choices=ENGINES,
        help="what runs the model's networks (default: compiled; always onnx for an .onnx file)",
    )
    parser.add_argument(
        "--live",
        action="store_true",
        help="a small view in the terminal, at the recorded speed: label, probabilities, rates (extra `view`)",
    )
    parser.add_argument("--speed", type=positive_number, metavar="S", help="of --live: 2 is twice as fast (default: 1)")
    add_pixels(parser)
    add_latest(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object a line for each decision")
    add_archive(parser, needs_out=True)


def main(args: argparse.Namespace) -> int:
    if args.out is not None:
        from async_tnt.cli.archives import run_archive  # here, so that other runs do not wait for its imports

        return run_archive(args)
    _check(args)
    engine = choose_engine(args.model, args.engine)
    fill_cache()
    settings = {"start_us": args.start_us, "hop_us": args.hop_us, "late": args.late, **triggers_of(args)}
    processor = Processor(engine.model, classes=engine.classes, **engine.networks, **settings)
    pixels = selector_of(args, engine.model)
    processor.fire()  # the empty window changes nothing, but an engine's first call takes longer
    line = json_line if args.json else text_line
    failed = stopped = False
    headers = [] if args.json or args.live else [HEADER]
    for path in paths_of(args):
        try:
            if isinstance(path, str):
                from async_tnt.cli.run_source import run_source

                stopped = run_source(path, processor, engine, pixels, line, latest=args.latest, live=args.live)
                if stopped:
                    break
                continue
            recording, packets = open_selected(path, pixels)
            if headers:
                say(headers.pop())
            if args.live:
                processor.reset()
                packets = replay(packets, args.speed or 1.0)
                draw_stream(recording.path.name, engine.classes, packets, processor, None)
            else:
                print_decisions(recording, packets, processor, engine, pixels, line, summary=not args.json)
        except BrokenPipeError:
            raise
        except (OSError, ValueError) as error:
            if isinstance(error, OSError) and error.errno == errno.ENOSPC:  # of our output, not of a recording
                raise
            complain(error)
            failed = True
    if pixels.summary():
        complain(f"left out: {pixels.summary()}")
    return 130 if stopped else 2 if failed else 0


def _check(args: argparse.Namespace) -> None:
    """Refuse options that do not go together."""
    check_no_archive(args)
    if args.live and args.json:
        raise ValueError("--live and --json exclude each other")
    check_pace(args)
    if args.speed is not None and not args.live:
        raise ValueError("--speed belongs to --live; otherwise a recording is streamed as fast as possible")
