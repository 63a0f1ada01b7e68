"""Make a moving picture of objects of many sizes, found after every event.

    python -m experiments.figure_scales MODEL --picture FILE.gif

MODEL is one of `experiments.object_scales`. The scenes are made ones (`objects/scenes.py`), of the
tuning seed. Events of the last 10 ms are orange (ON) and blue (OFF). A frame has the boxes of the
decision after its last event, each with its class and the number that it keeps.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt import Model, Processor, load_model
from async_tnt.base.extras import needs_extra
from async_tnt.base.files import check_writable, replacing
from async_tnt.views.figure_style import OFF, ON
from experiments.objects.scenes import SENSORS, TUNING_SEED, WINDOW_US, made_scene
from experiments.scripts.options import exit_with, plain_parser

if TYPE_CHECKING:
    from PIL import Image

SCENES = (1, 2)
"""Numbers of the scenes, one after the other."""

STEP_US = 4_000
"""Time between two frames, in microseconds."""

SHOWN_US = 10_000
"""How long an event is shown, in microseconds."""

SCALE = 2
"""Width and height of one pixel of the sensor, in pixels of the picture."""

INK = "#333333"
"""Colour of boxes and words."""

COLOURS = 8
"""Number of colours of the picture."""

FRAME_MS = 120
"""How long a frame is shown, in milliseconds."""


def frames(model: Model) -> Iterator[Image.Image]:
    """The frames of all scenes."""
    sensor = SENSORS[0]
    processor = Processor(model.for_sensor(sensor), start_us=0, every_events=1)
    for number in SCENES:
        columns = [made_scene(TUNING_SEED, sensor, number).columns[name] for name in "txyp"]
        t = columns[0]
        processor.reset()
        for end_us in range(STEP_US, WINDOW_US + 1, STEP_US):
            first, last = np.searchsorted(t, [end_us - STEP_US, end_us])
            decisions = processor.push(tuple(column[first:last] for column in columns))
            shown = slice(int(np.searchsorted(t, end_us - SHOWN_US)), int(last))
            objects = decisions[-1].objects if decisions else ()
            yield frame([column[shown] for column in columns], objects, sensor)


def frame(columns: list[np.ndarray], objects: Any, sensor: tuple[int, int]) -> Image.Image:
    """One frame: events, and the boxes of objects."""
    from PIL import Image, ImageColor, ImageDraw, ImageFont

    width, height = sensor
    pixels = np.full((height, width, 3), 255, np.uint8)
    _, x, y, p = columns
    for polarity, colour in ((0, OFF), (1, ON)):
        chosen = p == polarity
        pixels[y[chosen], x[chosen]] = ImageColor.getrgb(colour)
    image = Image.fromarray(pixels).resize(
        (SCALE * width, SCALE * height), Image.Resampling.NEAREST
    )
    draw: Any = ImageDraw.Draw(image)
    font = ImageFont.load_default(13)
    for one in objects or ():
        x0, y0, x1, y1 = (SCALE * side for side in one.box)
        draw.rectangle((x0, y0, x1, y1), outline=INK)
        draw.text((x0 + 2, y1 + 1), f"{one.label} {one.id}", fill=INK, font=font)
    return image


def main(argv: list[str] | None = None) -> int:
    """Write the picture."""
    parser = plain_parser("figure_scales", __doc__)
    parser.add_argument("model", metavar="MODEL", help="a model of objects with boxes")
    parser.add_argument(
        "--picture", type=Path, metavar="FILE.gif", required=True, help="the moving picture"
    )
    args = parser.parse_args(argv)
    check_writable(args.picture, (".gif",))
    with needs_extra("train", "pictures need Pillow"):
        from PIL import Image
    images = [
        image.quantize(COLOURS, dither=Image.Dither.NONE)
        for image in frames(load_model(args.model))
    ]
    with replacing(args.picture) as part, part.open("wb") as file:
        images[0].save(
            file,
            "GIF",
            save_all=True,
            append_images=images[1:],
            duration=FRAME_MS,
            loop=0,
            optimize=True,
        )
    return 0


if __name__ == "__main__":
    exit_with(main)
