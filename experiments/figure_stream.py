"""Make README's moving picture of a stream.

The picture shows recordings, and what `digits` decides every millisecond.

    python -m experiments.figure_stream --picture docs/images/stream.gif

Left: the events of the last 15 ms, ON orange, OFF blue. Right: the probabilities of the classes at
that moment.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt import Decision, Processor, load_model
from async_tnt.base.extras import needs_extra
from async_tnt.base.files import check_writable, replacing
from async_tnt.sources import open_recording, sample_recordings
from async_tnt.views.figure_style import OFF, ON
from experiments.scripts.options import exit_with, plain_parser

if TYPE_CHECKING:
    from PIL import Image

DIGITS = (3, 7, 8)
"""Digits whose recordings follow each other."""

STEP_US = 5_000
"""Time between two frames, in microseconds."""

SHOWN_US = 15_000
"""How long an event is shown, in microseconds."""

DURATION_US = 315_000
"""How long each recording lasts, in microseconds."""

SIDE = 7
"""Width and height of one pixel of the sensor, in pixels of the picture."""

WIDTH = 560
"""Width of the picture, in pixels."""

HEIGHT = 264
"""Height of the picture, in pixels."""

INK = "#333333"
"""Colour of words."""

PALE = "#d8d8d8"
"""Colour of frames."""


def moments() -> Iterator[tuple[np.ndarray, Decision | None, float]]:
    """For each frame, the events that it shows, the newest decision, and the seconds so far."""
    processor = Processor(load_model("digits"), every_us=1_000, start_us=0)
    offset_us = 0
    for digit in DIGITS:
        events = open_recording(sample_recordings()[digit]).read()
        events = events[events["t"] < DURATION_US]
        events["t"] += offset_us
        for start_us in range(offset_us, offset_us + DURATION_US, STEP_US):
            end_us = start_us + STEP_US
            decisions = processor.push(events[(events["t"] >= start_us) & (events["t"] < end_us)])
            shown_events = events[(events["t"] >= end_us - SHOWN_US) & (events["t"] < end_us)]
            yield shown_events, decisions[-1] if decisions else None, end_us * 1e-6
        offset_us += DURATION_US


def frame(events: np.ndarray, decision: Decision | None, seconds: float) -> Image.Image:
    """One frame of the moving picture."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("RGB", (WIDTH, HEIGHT), "white")
    draw: Any = ImageDraw.Draw(image)
    small = ImageFont.load_default(13)
    large = ImageFont.load_default(44)
    draw.rectangle((12, 12, 12 + 34 * SIDE, 12 + 34 * SIDE), outline=PALE)
    for event in events:
        x = 12 + SIDE * int(event["x"])
        y = 12 + SIDE * int(event["y"])
        draw.rectangle((x + 1, y + 1, x + SIDE - 1, y + SIDE - 1), fill=ON if event["p"] else OFF)
    classes = load_model("digits").classes
    left = 290
    top = 52
    if decision is None:
        probabilities = np.full(len(classes), 1 / len(classes))
    else:
        probabilities = decision.probabilities
    best = int(probabilities.argmax())
    for k, (name, probability) in enumerate(zip(classes, probabilities, strict=True)):
        y = top + 20 * k
        is_sure = k == best and probability >= 0.5
        draw.text((left, y), name, fill=INK, font=small)
        bar = (left + 18, y + 3, left + 18 + int(170 * probability), y + 14)
        draw.rectangle(bar, fill=INK if is_sure else PALE)
    time = f"{1e3 * seconds:.0f} ms, a decision every millisecond"
    draw.text((left, 16), time, fill=INK, font=small)
    if probabilities[best] >= 0.5:
        draw.text((left + 210, top + 60), classes[best], fill=INK, font=large)
    return image


def main(argv: list[str] | None = None) -> int:
    """Write the picture."""
    parser = plain_parser("figure_stream", __doc__)
    parser.add_argument(
        "--picture", type=Path, metavar="FILE.gif", required=True, help="the moving picture"
    )
    args = parser.parse_args(argv)
    check_writable(args.picture, (".gif",))
    with needs_extra("train", "pictures need Pillow"):
        from PIL import Image
    frames = [frame(*moment).quantize(16, dither=Image.Dither.NONE) for moment in moments()]
    with replacing(args.picture) as part, part.open("wb") as file:
        frames[0].save(
            file, "GIF", save_all=True, append_images=frames[1:], duration=60, loop=0, optimize=True
        )
    return 0


if __name__ == "__main__":
    exit_with(main)
