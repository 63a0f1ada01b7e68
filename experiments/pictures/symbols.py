"""Folders of pictures by class: symbols drawn with fonts, or MNIST's digits."""

from __future__ import annotations

import contextlib
import string
from pathlib import Path
from typing import Any

from async_tnt.base.extras import needs_extra
from experiments.digit_data.mnist import load_mnist

PIPS = {"cl": "♣", "di": "♦", "he": "♥", "sp": "♠"}
"""Class of POKER-DVS -> its symbol."""

CHARACTERS = {character: character for character in string.digits + string.ascii_uppercase}
"""Class of HOTS' characters -> the character."""

UNFIT = ("LastResort", "FreeSerifBold")
"""Starts of names of fonts that are left out: they draw boxes, or a club as a spade."""

HEIGHT = 96
"""Approximate height of a drawn character, in pixels."""


def write_mnist(folder: Path, mnist: Path, n: int) -> None:
    """Write the first `n` training images of MNIST as `folder/<digit>/<number>.png`."""
    from PIL import Image

    images, labels = load_mnist(mnist, "train")
    for i, (image, label) in enumerate(zip(images[:n], labels[:n], strict=True)):
        path = folder / str(label) / f"{i:05}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            Image.fromarray(image).save(path)


def write_glyphs(folder: Path, glyphs: dict[str, str], fonts: Path | None) -> None:
    """Draw the character of each class, black on white, with each font that has all characters."""
    from PIL import Image, ImageDraw

    for old in folder.glob("*/*.png"):
        old.unlink()
    for k, (font_name, font) in enumerate(_fonts("".join(glyphs.values()), fonts)):
        for name, text in glyphs.items():
            (folder / name).mkdir(parents=True, exist_ok=True)
            left, top, right, bottom = font.getbbox(text)
            picture = Image.new("L", (right - left + HEIGHT, bottom - top + HEIGHT), 255)
            ImageDraw.Draw(picture).text((HEIGHT / 2 - left, HEIGHT / 2 - top), text, 0, font)
            picture.save(folder / name / f"{k:03} {font_name}.png")


def _fonts(text: str, folder: Path | None) -> list[tuple[str, Any]]:
    """The fonts of a folder, by default matplotlib's, that draw all characters of `text`.

    Each font comes with its name. It must draw each character in a shape of its own. If several
    fonts draw the same shapes, the first of these fonts is taken.
    """
    with needs_extra("plot", "fonts are matplotlib's"):
        from matplotlib import get_data_path
        from PIL import ImageFont
    fonts: dict[bytes, tuple[str, Any]] = {}
    for path in sorted((folder or Path(get_data_path(), "fonts/ttf")).rglob("*")):
        if path.suffix.lower() not in (".ttf", ".otf", ".ttc") or path.stem.startswith(UNFIT):
            continue
        # FreeType refuses some fonts
        with contextlib.suppress(OSError):
            font = ImageFont.truetype(str(path), HEIGHT)
            missing = bytes(font.getmask("\uffff"))
            drawn = [bytes(font.getmask(character)) for character in text]
            has_ink = all(map(any, drawn))
            # no two characters look the same, and none of them looks like a missing character
            all_differ = len({missing, *drawn}) > len(drawn)
            if has_ink and all_differ:
                fonts.setdefault(b"".join(drawn), (path.stem, font))
    return list(fonts.values())
