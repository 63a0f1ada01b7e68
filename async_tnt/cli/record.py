"""async-tnt record: a camera or a network stream into class folders."""

from __future__ import annotations

import argparse
import contextlib
import io
import itertools
import json
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType
from typing import Any

import numpy as np

from async_tnt.base.files import check_folder, user_path, write_text
from async_tnt.base.messages import short
from async_tnt.base.package import __version__
from async_tnt.cli.options import size_of
from async_tnt.cli.output import can_print, complain, say
from async_tnt.cli.signals import handled_by
from async_tnt.sources.files.dat_writer import DatFile, DatWriter
from async_tnt.sources.files.prophesee import DAT_SIDE
from async_tnt.sources.opening import is_live, open_source
from async_tnt.volume.events import EVENT_DTYPE, as_events
from async_tnt.volume.sensor import format_size

DESCRIPTION = """\
Record a camera or a network stream into the folder of a class, to train on.

  async-tnt record camera --class wave --seconds 20 --out gestures
  async-tnt record camera --class clap --seconds 20 --out gestures
  async-tnt record udp://127.0.0.1:3333 --sensor 346x260 --class wave --out gestures
                                                         until Ctrl-C
  async-tnt train gestures --out gestures.safetensors

Each run writes a new file, gestures/wave/DATE_TIME.dat, in Prophesee's DAT format, which faery and
Metavision read, too. No file is replaced. Times count from the file's first event. Beside the file,
DATE_TIME.json says what recorded it, with a camera's settings. Times in DAT files end after 71.6
minutes: then, and after 35.8 minutes without an event, the recording goes on in a new file.

After Ctrl-C (exit code 130) the recording is complete up to then. In a terminal the last events are
shown meanwhile. Exit code 2 if no event came, the camera was unplugged, or the disk is full: what
came before is kept. An event is in the file as soon as it has come, even if the program is killed.
"""
LONGEST_NAME = 255
"""Bytes of the longest file name that most file systems allow."""
EVERY_S = 0.1
"""Seconds between two pictures of the last events."""
MOST_COLUMNS = 64
"""Characters in a row of the picture, at most."""
MOST_ROWS = 20
"""Rows of characters in the picture, at most. A character is two pixels high."""
LEAST_COLUMNS = 9
"""A picture with fewer characters in a row is not shown."""
LEAST_ROWS = 5
"""A picture with fewer rows is not shown."""
BLOCKS = " ▀▄█"
"""Characters that show two pixels, one above the other. The lit pixels are: neither, the upper one,
the lower one, both."""
ASCII_BLOCKS = " '.#"
"""Characters that replace `BLOCKS` if the terminal's encoding lacks them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "source", metavar="SOURCE", help="camera[:KIND[:SERIAL]] or udp://HOST:PORT"
    )
    parser.add_argument(
        "--class",
        dest="label",
        type=_class_name,
        metavar="NAME",
        required=True,
        help="what the camera sees: the class, a folder in --out",
    )
    parser.add_argument(
        "--out", type=_folder, metavar="FOLDER", required=True, help="the data set; made if missing"
    )
    parser.add_argument(
        "--seconds", type=float, metavar="S", help="how long to record (default: until Ctrl-C)"
    )
    parser.add_argument(
        "--sensor", type=size_of, metavar="WxH", help="the pixels of a network stream's camera"
    )


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt record`. Returns the exit code."""
    if not is_live(args.source):
        raise ValueError(f"SOURCE must be a camera or udp://HOST:PORT, got {args.source}")
    if args.sensor and args.source.startswith("camera"):
        raise ValueError("--sensor belongs to a network stream; a camera states its own")
    if args.seconds is not None and not 0 < args.seconds < threading.TIMEOUT_MAX:
        raise ValueError(f"--seconds must be a positive number, got {args.seconds}")

    folder = args.out / args.label
    check_folder(folder)
    source = open_source(args.source, args.sensor)
    try:
        if source.sensor is None:
            raise ValueError(f"{source.name} does not state its sensor; give --sensor WxH")
        if max(source.sensor) > DAT_SIDE:
            raise ValueError(
                f"{source.name}: DAT files hold {DAT_SIDE} pixels a side, got "
                f"{format_size(source.sensor)}"
            )
        folder.mkdir(parents=True, exist_ok=True)
        return _record(source, args.label, folder, args.seconds)
    finally:
        source.close()
        # An empty folder is removed, because `train` would refuse a class without recordings. A
        # folder with files stays, because `rmdir` refuses it.
        with contextlib.suppress(OSError):
            folder.rmdir()


def _class_name(text: str) -> str:
    """Read the name of a class. This is an argparse type.

    The name becomes the name of a folder that `train` reads. It must not begin with a dot, because
    `train` leaves out such folders.
    """
    is_plain = text != "" and Path(text).name == text and text.isprintable()
    is_listed = text == text.strip() and not text.startswith(".")
    if not is_plain or not is_listed or len(text.encode()) > LONGEST_NAME:
        raise argparse.ArgumentTypeError(
            f"must be the name of a folder: printable, of at most {LONGEST_NAME} bytes, without "
            f"slashes, and with no dot or blank before it; got {short(text)}"
        )
    return text


def _folder(text: str) -> Path:
    """Read the path of a folder. This is an argparse type."""
    if not text.strip() or "\0" in text:
        raise argparse.ArgumentTypeError(f"must be a folder, got {text!r}")
    return user_path(text)


def _record(source: Any, label: str, folder: Path, seconds: float | None) -> int:
    """Record until the source ends. Returns the exit code.

    A JSON file beside each recording describes it, as soon as the recording is complete.
    """
    picture = _Picture(source.sensor, label)
    started = time.strftime("%Y-%m-%dT%H:%M:%S%z")
    lines: list[str] = []
    problems: list[OSError] = []

    def on_complete(file: DatFile) -> None:
        """Write the description of a recording, and keep the line to print about it at the end."""
        about = {
            "source": source.name,
            "class": label,
            "sensor": list(source.sensor),
            "started": started,
            "first_us": file.first_us,
            "events": file.events,
            "counts": source.summary(),
            "settings": getattr(source, "settings", {}),
            "async_tnt": __version__,
        }
        share_on = file.on / file.events
        lines.append(f"{file.path}: {file.events:,} events, {share_on:.0%} ON; {source.summary()}")
        text = json.dumps(about, indent=1, default=str) + "\n"
        try:
            write_text(file.path.with_suffix(".json"), text)
        except OSError as error:  # the recording goes on
            problems.append(error)

    as_events(np.empty(0, EVENT_DTYPE), source.sensor)  # compile before the time begins
    with _closed_in_time(source, seconds):
        complain(f"recording {label} from {source.name} into {folder}; Ctrl-C stops")
        try:
            with DatWriter(source.sensor, lambda: _new_file(folder), on_complete) as writer:
                for packet in source:
                    events = as_events(packet, source.sensor)
                    writer.write(events)
                    picture.show(events)
        except OSError as error:
            # The camera was unplugged, or the disk is full. What came before is kept.
            problems.append(error)
        finally:
            # The lines are printed last, so that a terminal that is gone does not end the
            # recording.
            if lines:
                say(*lines)
        for problem in problems:
            complain(problem)
        if not writer.n_events and not problems:
            complain(f"{source.name}: no event came; nothing was written")
            return 2
    return 2 if problems else 0


@contextlib.contextmanager
def _closed_in_time(source: Any, seconds: float | None) -> Iterator[None]:
    """Close the source after `seconds`, or at a signal such as Ctrl-C.

    Signals do not interrupt the block. After the block, the first signal that came has its usual
    effect. If `seconds` is None, only a signal closes the source.
    """
    # a SimpleQueue, because a signal handler may call `put` while another call of `put` is running
    requests: SimpleQueue[int] = SimpleQueue()
    signal_numbers: list[int] = []

    def close_at_request() -> None:
        with contextlib.suppress(Empty):
            requests.get(timeout=seconds)
        source.close()

    def request_close(number: int, frame: FrameType | None) -> None:
        signal_numbers.append(number)
        requests.put(number)

    # `close` waits until a running read has ended. A signal handler may run in the middle of that
    # read, and would wait forever. So a thread closes the source.
    thread = threading.Thread(target=close_at_request, name="async_tnt.record", daemon=True)
    thread.start()
    try:
        with handled_by(request_close):
            try:
                yield
            finally:
                requests.put(0)
                thread.join()
    finally:
        if signal_numbers:
            signal.raise_signal(signal_numbers[0])


def _new_file(folder: Path) -> io.FileIO:
    """Create a file named by the time, and open it. No other process gets the same file."""
    time_text = time.strftime("%Y%m%d_%H%M%S")
    for n in itertools.count(1):
        stem = time_text if n == 1 else f"{time_text}_{n}"
        is_free = not any(folder.glob(f"{stem}.*"))
        if is_free:
            # another process may have created this file meanwhile
            with contextlib.suppress(FileExistsError):
                return (folder / f"{stem}.dat").open("xb", buffering=0)
    raise AssertionError("unreachable")


class _Picture:
    """Draws the last events and their rate on a terminal, again and again.

    If stderr is not a terminal, or the terminal is too small, nothing is drawn.

    Parameters
    ----------
    sensor : (width, height) in pixels.
    label : the class that is recorded.
    """

    def __init__(self, sensor: tuple[int, int], label: str) -> None:
        self._sensor = sensor
        self._label = label
        self._blocks = BLOCKS if can_print(BLOCKS, sys.stderr) else ASCII_BLOCKS

        size = shutil.get_terminal_size()
        self._columns = max(0, min(MOST_COLUMNS, size.columns - 1))
        self._rows = max(0, min(MOST_ROWS, size.lines - 2))
        has_room = self._columns >= LEAST_COLUMNS and self._rows >= LEAST_ROWS
        self._is_shown = has_room and sys.stderr.isatty()

        # The number of events since the last picture, at each pixel of the picture. A character
        # shows two pixels, one above the other.
        self._counts = np.zeros((2 * self._rows, self._columns), np.int64)
        self._n_events = 0
        self._has_picture = False
        self._started_s = time.monotonic()
        self._drawn_s = self._started_s

    def show(self, events: np.ndarray) -> None:
        """Count these events, and draw a picture if `EVERY_S` have passed since the last one."""
        if not self._is_shown:
            return
        width, height = self._sensor
        rows = events["y"].astype(np.int64) * 2 * self._rows // height
        columns = events["x"].astype(np.int64) * self._columns // width
        np.add.at(self._counts, (rows, columns), 1)
        self._n_events += len(events)

        now_s = time.monotonic()
        if now_s >= self._drawn_s + EVERY_S:
            self._draw(now_s)
            self._has_picture = True
            self._drawn_s = now_s
            self._n_events = 0
            self._counts[:] = 0

    def _draw(self, now_s: float) -> None:
        """Write a picture over the previous one."""
        # A lit pixel has more events than the mean pixel, and more than one.
        lit = self._counts > max(1.0, self._counts.mean())
        upper = lit[::2]
        lower = lit[1::2]
        blocks = (upper + 2 * lower).tolist()  # indices of `BLOCKS`
        lines = ["".join(self._blocks[block] for block in row) for row in blocks]

        rate = self._n_events / (now_s - self._drawn_s)
        seconds = now_s - self._started_s
        caption = f"{self._label}: {seconds:.1f} s, {rate:,.0f} events a second"
        lines.append(caption.ljust(self._columns))

        # moves the cursor up to the first line of the previous picture
        cursor_up = f"\x1b[{len(lines)}A" if self._has_picture else ""
        # the recording goes on if the terminal is gone
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.write(cursor_up + "".join(f"\r{line}\n" for line in lines))
            sys.stderr.flush()
