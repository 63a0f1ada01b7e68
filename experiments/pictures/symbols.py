"""Pictures of symbols and digits as class folders: drawn with fonts, or MNIST's."""

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
"""Names of fonts that draw boxes, or a club as a spade."""

HEIGHT = 96
"""Height of a drawn glyph, about, in pixels."""


def write_mnist(folder: Path, mnist: Path, n: int) -> None:
    """Write the first `n` training images of MNIST, `folder/<digit>/<number>.png`."""
    from PIL import Image

    images, labels = load_mnist(mnist, "train")
    for i, (image, label) in enumerate(zip(images[:n], labels[:n], strict=True)):
        path = folder / str(label) / f"{i:05}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            Image.fromarray(image).save(path)


def write_glyphs(folder: Path, glyphs: dict[str, str], fonts: Path | None) -> None:
    """Draw the character of each class, black on white, by each font that has them all."""
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
    """Fonts beneath a folder, by default matplotlib's, that draw each of these characters.

    A font must draw each character with another shape, and not as an earlier font draws it.
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
            if all(map(any, drawn)) and len({missing, *drawn}) > len(drawn):
                fonts.setdefault(b"".join(drawn), (path.stem, font))
    return list(fonts.values())
