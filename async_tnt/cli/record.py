"""async-tnt record: a camera or a network stream into class folders."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.cli.options import size_of
from async_tnt.cli.output import complain, say
from async_tnt.events import as_events
from async_tnt.files import check_folder, replacing, user_path, write_text
from async_tnt.package import __version__
from async_tnt.sources.files.prophesee import DAT_EVENT_BYTES, DAT_SIDE, dat_header, dat_records
from async_tnt.sources.opening import is_live, open_source
from async_tnt.sources.sensor import format_size

DESCRIPTION = """Record a camera or a network stream, a file of its class at a time, to train on.

  async-tnt record camera --class wave --seconds 20 --out gestures
  async-tnt record camera --class clap --seconds 20 --out gestures
  async-tnt record udp://127.0.0.1:3333 --sensor 346x260 --class wave --out gestures     until Ctrl-C
  async-tnt train gestures --out gestures.safetensors

Each run writes a new file, gestures/wave/DATE_TIME.dat, in Prophesee's DAT format, which faery and Metavision read,
too; what is there is never replaced. Times count from its first event. Beside it, DATE_TIME.json says what recorded it,
with a camera's settings. After Ctrl-C (exit code 130) the recording is complete up to then. In a terminal the last
events are shown meanwhile. Exit code 2 if no event came, or the camera was unplugged: what came before is kept.
"""
EVERY_S = 0.1
COLUMNS, ROWS = 64, 20
"""Of the picture, at most; a character is two pixels high."""
BLOCKS = " ▀▄█"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="SOURCE", help="camera[:KIND[:SERIAL]] or udp://HOST:PORT")
    parser.add_argument("--class", dest="label", metavar="NAME", required=True, help="what is shown: a folder of --out")
    parser.add_argument("--out", type=user_path, metavar="FOLDER", required=True, help="the data set; made if missing")
    parser.add_argument("--seconds", type=float, metavar="S", help="how long to record (default: until Ctrl-C)")
    parser.add_argument("--sensor", type=size_of, metavar="WxH", help="the sender's pixels, of a network stream")


def main(args: argparse.Namespace) -> int:
    if not is_live(args.source):
        raise ValueError(f"SOURCE must be a camera or udp://HOST:PORT, got {args.source}")
    if args.sensor and args.source.startswith("camera"):
        raise ValueError("--sensor belongs to a network stream; a camera states its own")
    if args.label in ("", ".", "..") or Path(args.label).name != args.label or args.label.startswith("."):
        raise ValueError(f"--class must be the name of a folder, got {args.label!r}")
    if args.seconds is not None and not 0 < args.seconds < threading.TIMEOUT_MAX:
        raise ValueError(f"--seconds must be a positive number, got {args.seconds}")
    folder = args.out / args.label
    check_folder(folder)
    source = open_source(args.source, args.sensor)
    try:
        if source.sensor is None:
            raise ValueError(f"{args.source} does not state its sensor; give --sensor WxH")
        if max(source.sensor) > DAT_SIDE:
            raise ValueError(
                f"{args.source}: DAT files hold {DAT_SIDE} pixels a side, got {format_size(source.sensor)}"
            )
        folder.mkdir(parents=True, exist_ok=True)
        path = _claim_name(folder)
        try:
            return _record(args, source, path)
        finally:
            if not path.exists():
                path.with_suffix(".json").unlink(missing_ok=True)
    finally:
        source.close()
        with contextlib.suppress(OSError):  # a class without recordings would be an error of `train`
            folder.rmdir()


def _claim_name(folder: Path) -> Path:
    """A file that is not there yet, named by the time. No other process gets the same: the file beside it is made."""
    now, n = time.strftime("%Y%m%d_%H%M%S"), 1
    while True:
        path = folder / f"{now}{f'_{n}' if n > 1 else ''}.dat"
        if not any(folder.glob(f"{path.name}*")):
            with contextlib.suppress(FileExistsError):
                path.with_suffix(".json").touch(exist_ok=False)
                return path
        n += 1


def _record(args: argparse.Namespace, source: Any, path: Path) -> int:
    picture, started = _Picture(source.sensor, args.label), time.strftime("%Y-%m-%dT%H:%M:%S%z")
    lost: OSError | None = None
    ending = threading.Timer(args.seconds or threading.TIMEOUT_MAX, source.close)
    ending.daemon = True
    first_us, n_events, n_on, n_early = -1, 0, 0, 0
    header = dat_header(source.sensor)
    with replacing(path) as part:
        with part.open("wb") as file:
            file.write(header)
            complain(f"recording {args.label} from {args.source} into {path}; Ctrl-C stops")
            ending.start()
            try:
                with contextlib.suppress(KeyboardInterrupt):
                    for packet in source:  # never an empty one
                        events = as_events(packet, source.sensor)
                        first_us = int(events["t"].min()) if first_us < 0 else first_us
                        n_early += int((events["t"] < first_us).sum())
                        events = events[events["t"] >= first_us]
                        file.write(dat_records(events, first_us))
                        n_events, n_on = n_events + len(events), n_on + int(events["p"].sum())
                        picture.show(events)
                file.flush()
            except OSError as error:  # the camera was unplugged, or the disk is full: what came before is kept
                lost = error
                with contextlib.suppress(OSError):
                    file.close()
                n_events = max(0, part.stat().st_size - len(header)) // DAT_EVENT_BYTES
                n_on = min(n_on, n_events)
                os.truncate(part, len(header) + n_events * DAT_EVENT_BYTES)
            finally:
                ending.cancel()
        if not n_events:
            raise lost or ValueError(f"{args.source}: no event came; nothing was written")
    about = {
        "source": getattr(source, "name", args.source),
        "class": args.label,
        "sensor": list(source.sensor),
        "started": started,
        "first_us": first_us,
        "events": n_events,
        "left_out_as_earlier": n_early,
        "counts": source.summary(),
        "settings": getattr(source, "settings", {}),
        "async_tnt": __version__,
    }
    write_text(path.with_suffix(".json"), json.dumps(about, indent=1, default=str) + "\n")
    say(f"{path}: {n_events:,} events, {n_on / n_events:.0%} ON; {source.summary()}")
    if n_early:
        complain(f"{path}: {n_early:,} events were earlier than the first packet, and are left out")
    if lost is not None:
        complain(lost)
    return 0 if lost is None else 2


class _Picture:
    """The last events and their rate, drawn over and over on a terminal; nothing elsewhere."""

    def __init__(self, sensor: tuple[int, int], label: str) -> None:
        self._sensor, self._label = sensor, label
        size = shutil.get_terminal_size()
        self._columns, self._rows = min(COLUMNS, size.columns - 1), max(0, min(ROWS, size.lines - 2))
        self._counts = np.zeros((2 * self._rows, self._columns), np.int64)
        self._is_shown = sys.stderr.isatty() and self._columns > 8 and self._rows > 4
        self._drawn = False
        self._n_events, self._before = 0, time.monotonic()
        self._started = self._before

    def show(self, events: np.ndarray) -> None:
        """Count these events, and draw if it is time."""
        if not self._is_shown:
            return
        width, height = self._sensor
        rows = events["y"].astype(np.int64) * 2 * self._rows // height
        np.add.at(self._counts, (rows, events["x"].astype(np.int64) * self._columns // width), 1)
        self._n_events += len(events)
        if (now := time.monotonic()) < self._before + EVERY_S:
            return
        lit = self._counts > max(1.0, self._counts.mean())
        blocks = lit[::2] + 2 * lit[1::2]  # the upper and the lower pixel of a character
        lines = ["".join(BLOCKS[block] for block in row) for row in blocks.tolist()]
        rate = self._n_events / (now - self._before)
        lines.append(f"{self._label}: {now - self._started:.1f} s, {rate:,.0f} events a second".ljust(self._columns))
        sys.stderr.write((f"\x1b[{len(lines)}A" if self._drawn else "") + "".join(f"\r{line}\n" for line in lines))
        sys.stderr.flush()
        self._drawn, self._n_events, self._before = True, 0, now
        self._counts[:] = 0
