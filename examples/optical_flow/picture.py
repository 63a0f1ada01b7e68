"""A moving picture: events, the network's flow and the true flow, side by side."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from async_tnt import Model, Output, Processor
from async_tnt.base.files import replacing
from async_tnt.base.progress import progress
from async_tnt.simulation import PixelModel
from async_tnt.views.figure_style import OFF, ON
from examples.optical_flow.drawing import FINENESS, blurred, texture
from examples.optical_flow.network import HOP_US
from examples.optical_flow.scenes import Kinds, Motion, Scene, ground_of, random_object

SENSOR = (160, 120)
"""Width and height of the sensor, in pixels."""

DURATION_US = 640_000
"""How long the scene is seen, in microseconds."""

STEP_US = 10_000
"""Time between two frames, in microseconds."""

SIZES_PX = (48.0, 48.0, 36.0, 36.0)
"""Diameters of the objects, in pixels."""

SHOWN_US = 10_000
"""How long an event is shown, in microseconds. Flow is shown within a pixel of these
events."""

FASTEST_PX = 250.0
"""Speed that has the strongest colour, in pixels per second."""

SCALE = 2
"""Width and height of a pixel of the sensor, in pixels of the picture."""

GAP = 8
"""Distance between the panels, in pixels of the picture."""

TITLES = ("events", "flow after the newest event", "true flow")

N_COLOURS = 40
"""Number of colours of the picture: more make its file larger."""

INK = "#333333"
"""Colour of words."""

Shown = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Events that are shown, the network's flow (2, H, W), and the true flow (2, H, W)."""


def shown_scene(rng: np.random.Generator) -> Scene:
    """A dark ground that passes slowly, and objects that go round in front of it."""
    ground = blurred(0.35 * texture("patches", FINENESS * 256, rng), 0.6)
    layers = [ground_of(ground, Motion(complex(80, 60), complex(-40, 15)), SENSOR)]
    paths = (
        circling(complex(46, 42), 20.0, 1, 0.0),
        circling(complex(116, 76), 20.0, -1, 2.0),
        circling(complex(44, 96), 12.0, 1, 4.0),
        circling(complex(122, 24), 12.0, -1, 1.0),
    )
    shapes = ("star", "letter", "ellipse", "polygon")
    for motion, shape, size_px in zip(paths, shapes, SIZES_PX, strict=True):
        kinds = Kinds(("patches",), (shape,))
        layers.append(random_object(SENSOR, 1e-6 * DURATION_US, size_px, motion, kinds, 0.6, rng))
    return Scene(SENSOR, tuple(layers), 10.0, PixelModel())


def circling(centre: complex, radius: float, sign: int, phase: float) -> Motion:
    """A motion once around a circle, in pixels, from an angle in radians on."""
    bend = sign * 2 * np.pi / (1e-6 * DURATION_US)
    from_centre = radius * np.exp(1j * phase)
    return Motion(complex(centre + from_centre), complex(1j * bend * from_centre), bend=bend)


def draw_picture(path: Path, model: Model, seed: int = 0) -> None:
    """Write the picture: a moving .gif, or its last frame as a .png."""
    rng = np.random.default_rng(seed)
    scene = shown_scene(rng)
    events = scene.events(DURATION_US, rng)
    drawn = []
    with progress((DURATION_US - HOP_US) // STEP_US, "frames") as bar:
        for shown in moments(model, scene, events):
            drawn.append(frame(*shown))
            bar.update()
    # one palette for all frames, so that words keep their colour
    sample = np.concatenate([np.asarray(image) for image in drawn[::8]])
    palette = Image.fromarray(sample).quantize(N_COLOURS, dither=Image.Dither.NONE)
    frames = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in drawn]
    with replacing(path) as part, part.open("wb") as file:
        if path.suffix == ".png":
            frames[-1].save(file, "PNG")
        else:
            more: dict[str, Any] = {"save_all": True, "append_images": frames[1:]}
            frames[0].save(file, "GIF", duration=60, loop=0, optimize=True, **more)


def moments(model: Model, scene: Scene, events: np.ndarray) -> Iterator[Shown]:
    """What each frame shows. The first frames are left out, until a window is half full."""
    processor = Processor[Output](model.for_sensor(SENSOR), hop_us=HOP_US, start_us=0)
    width, height = SENSOR
    for start_us in range(0, DURATION_US, STEP_US):
        end_us = start_us + STEP_US
        first, middle, last = np.searchsorted(events["t"], (end_us - SHOWN_US, start_us, end_us))
        processor.push(events[middle:last])
        if start_us >= HOP_US:
            flow = processor.fire().arrays[0][:, :height, :width]
            yield events[first:last], flow, scene.flow(1e-6 * end_us)


def frame(events: np.ndarray, flow: np.ndarray, true: np.ndarray) -> Image.Image:
    """One frame of the moving picture."""
    width, height = SENSOR
    of_events = np.full((height, width, 3), 255, np.uint8)
    colours = np.array([_rgb(OFF), _rgb(ON)], np.uint8)
    of_events[events["y"], events["x"]] = colours[events["p"]]
    is_near = np.zeros((height + 2, width + 2), bool)
    for i, j in np.ndindex(3, 3):
        is_near[events["y"] + i, events["x"] + j] = True
    is_near = is_near[1:-1, 1:-1]
    panels = [of_events]
    for shown in (flow, true):
        panels.append(np.where(is_near[..., None], flow_colours(shown), np.uint8(255)))

    top = 24
    image = Image.new("RGB", (3 * SCALE * width + 4 * GAP, SCALE * height + top + GAP), "white")
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(14)
    for k, (title, panel) in enumerate(zip(TITLES, panels, strict=True)):
        left = GAP + k * (SCALE * width + GAP)
        enlarged = Image.fromarray(panel).resize(
            (SCALE * width, SCALE * height), Image.Resampling.NEAREST
        )
        image.paste(enlarged, (left, top))
        draw.rectangle(
            (left - 1, top - 1, left + SCALE * width, top + SCALE * height), outline="#d8d8d8"
        )
        draw.text((left, 4), title, fill=INK, font=font)
    _draw_wheel(image, image.width - GAP - 22, 0)
    return image


def flow_colours(flow: np.ndarray) -> np.ndarray:
    """Colours of flow (2, H, W): uint8, (H, W, 3).

    The hue is the direction. The colour is pale where the flow is slow.
    """
    x, y = flow
    hue = np.arctan2(y, x) / (2 * np.pi) % 1.0
    strength = np.clip(0.15 + 0.85 * np.hypot(x, y) / FASTEST_PX, 0.0, 1.0)
    # each colour's share at full strength: HSV with value 0.9
    shares = np.stack([(hue + shift) % 1.0 for shift in (0.0, 2 / 3, 1 / 3)], axis=-1)
    full = np.clip(np.abs(6.0 * shares - 3.0) - 1.0, 0.0, 1.0)
    brightness = 0.9 * (1.0 - strength[..., None] * (1.0 - full))
    return (255 * brightness).astype(np.uint8)


def _draw_wheel(image: Image.Image, left: int, top: int) -> None:
    """Draw the colours of all directions, 22 pixels wide."""
    place = (np.arange(22) - 10.5) / 10.5 * FASTEST_PX
    flow = np.stack(np.broadcast_arrays(place, place[:, None]))
    colours = np.where(np.hypot(*flow)[..., None] <= FASTEST_PX, flow_colours(flow), np.uint8(255))
    image.paste(Image.fromarray(colours), (left, top))


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(colour.removeprefix("#")))
