"""async-tnt view: show a stream in the Rerun viewer."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable
from typing import Any

from async_tnt.base.files import check_writable, user_path
from async_tnt.base.messages import printable
from async_tnt.base.progress import progress
from async_tnt.cli.options import (
    add_files,
    add_reading,
    add_start,
    add_triggers,
    check_reading,
    number,
    paths_of,
    positive_number,
    reading_of,
    refuse_graph,
    triggers_of,
)
from async_tnt.cli.output import complain, complain_late, say
from async_tnt.cli.packets import add_keep_up, check_keep_up, check_sources, follow
from async_tnt.cli.pixel_options import add_pixels, map_model_sensor, model_pixels_of, pixels_of
from async_tnt.networks.engines import choose_engine
from async_tnt.sources.files.playback import replay
from async_tnt.sources.files.recording import Recording
from async_tnt.streaming.compile_ahead import must_compile
from async_tnt.streaming.streams import pieces_for
from async_tnt.views.rerun_view import SUFFIXES, RerunView, import_rerun

DESCRIPTION = """\
Show a stream in the Rerun viewer while it is classified: the events and the landmark,
the raw and the transformed volume, the probability of each class, the decisions. A
model of raw outputs has a panel for each output instead of the last two, and a spiking
model one more, for the spikes of its layers. The timeline
is that of the recording, in microseconds. It can be played, stopped and scrubbed.

  async-tnt view a.bin                              play at the recorded speed
  async-tnt view a.bin --speed 0.1                  at a tenth of it
  async-tnt view a.bin --every-us 5000 --every-ms 5 decide and draw every 5 ms
  async-tnt view udp://127.0.0.1:3333 --keep-up 50  the network, until Ctrl-C
  async-tnt view camera --roi 400,200,34,34 --crop  a part of a camera's image

Without a display, write a file as fast as possible. Rerun opens it, here or elsewhere:

  async-tnt view a.bin --out a.rrd
  rerun a.rrd

Or show it in a viewer that is running elsewhere:

  async-tnt view a.bin --connect rerun+http://10.0.0.7:9876/proxy

A picture is taken every 20 ms of recorded time and at the end of each window, however
many events there are. An output of two channels is drawn as directions, one of one
channel as grey, one of more by its largest channel; numbers are curves or bars. Each
picture has its own range of colours, which is told beside it.

Rerun's viewer collects usage data; `rerun analytics disable` stops that. Needs
rerun-sdk (extra `view`); a camera needs the extra `cameras`.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_files(parser, live=True, single=True)
    add_start(parser)
    add_triggers(parser)
    add_pixels(parser)
    add_reading(parser)
    destination = parser.add_mutually_exclusive_group()
    destination.add_argument(
        "--out", type=user_path, metavar="FILE.rrd", help="write a file for the viewer instead"
    )
    destination.add_argument(
        "--connect", metavar="URL", help="show it in a running viewer: rerun+http://HOST:9876/proxy"
    )
    parser.add_argument(
        "--speed",
        type=positive_number,
        metavar="S",
        help="speed of playback; 2 is twice as fast, inf does not wait (default: 1, with --out "
        "inf)",
    )
    parser.add_argument(
        "--every-ms",
        type=_milliseconds,
        default=20_000,
        dest="picture_us",
        metavar="MS",
        help="recorded milliseconds between pictures (default: 20)",
    )
    add_keep_up(parser)


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt view`. Returns the exit code."""
    check_keep_up(args)
    check_reading(args)
    path = paths_of(args)[0]
    is_live = isinstance(path, str)
    if args.speed is not None and is_live:
        raise ValueError(
            "--speed belongs to recordings; a camera or the network has a pace of its own"
        )
    # imported before any work, in case rerun-sdk is missing
    import_rerun()
    if args.out is not None:
        check_writable(args.out, SUFFIXES)

    selection = pixels_of(args)
    refuse_graph(args.model)
    engine = choose_engine(args.model, map_model_sensor(selection, args), args.config)
    pixels = model_pixels_of(selection, engine.model)
    recording_and_select = None if is_live else pixels.open(path, **reading_of(args))
    speed = args.speed
    if speed is None:
        speed = 1.0 if args.out is None else math.inf
    if must_compile():
        # A missing source is reported before the wait for the compilation.
        check_sources([path], pixels)

    view: RerunView[Any] = RerunView(
        engine.model,
        out=args.out,
        connect=args.connect,
        picture_us=args.picture_us,
        live=is_live,
        name=path if is_live else path.name,
        classes=engine.classes,
        start_us=args.start_us,
        classifier=engine.classifier,
        **triggers_of(args, engine.config),
    )
    stopped = False
    with view:
        if recording_and_select is None:
            stopped = follow(
                path,
                pixels,
                view.processor,
                args.keep_up,
                lambda packets, _: _push_all(packets, view),
            )
        else:
            _show(*recording_and_select, view, speed)

    n_events = view.processor.counts.received
    if not n_events and not stopped:
        raise ValueError(f"{path}: {pixels.no_events_message}, nothing to show")
    # a file without events is not written
    if args.out is not None and n_events:
        say(
            f"{args.out}: {n_events:,} events, {view.log.n_pictures:,} pictures; open it with: "
            f"rerun {args.out}"
        )
    if pixels.summary():
        complain(f"left out: {pixels.summary()}")
    return 130 if stopped else 0


def _show(
    recording: Recording, select: Callable[[Any], Any], view: RerunView[Any], speed: float
) -> None:
    """Play a recording at `speed` times its own speed; `select` chooses the pixels."""
    with progress(recording.n_events, printable(recording.path.name)) as bar:
        for packet in replay(map(select, recording), speed):
            _push(packet, view)
            bar.update(len(packet))
    counts = view.processor.counts
    complain_late(str(recording.path), counts.dropped_late, counts.received, "--start-us")


def _push_all(packets: Iterable[Any], view: RerunView[Any]) -> None:
    for packet in packets:
        _push(packet, view)


def _push(packet: Any, view: RerunView[Any]) -> None:
    """Push a packet in pieces, so that few outputs lie in memory together."""
    for piece in pieces_for(view.processor, packet):
        view.push(piece)


def _milliseconds(text: str) -> int:
    """Read milliseconds, and return them as microseconds. This is an argparse type."""
    ms = number(text, lambda value: 0.001 <= value < 1e9, "a number from 0.001 to 1e9")
    return round(1000 * ms)
