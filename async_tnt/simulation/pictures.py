"""Read a picture of an object: its luminance, and which pixels are the object.

Luminance is linear: sRGB is decoded, and colours are weighted as in Rec. 709. Which pixels belong
to the object depends on the picture:

with an alpha channel       the opaque pixels
on a plain ground           the pixels that differ from the ground. The ground is plain if the
                            picture's outermost pixels are alike. Their median is the luminance of
                            the ground
any other (a photograph)    all pixels
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from async_tnt.base.extras import needs_extra
from async_tnt.base.files import open_regular, refuse_git_lfs
from async_tnt.base.messages import one_line

SUFFIXES = (".bmp", ".gif", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")
FORMATS = ("BMP", "GIF", "JPEG", "PNG", "PPM", "TIFF", "WEBP")
"""Pillow's names of the formats with these suffixes. Pillow knows a format by a file's first bytes.
Without this list it would open files of other formats, too, and start programs for some of them."""
MAX_PIXELS = 50_000_000
"""Most pixels of a picture that is read. To decode more pixels takes more than a gigabyte."""
LARGEST_SIDE = 512
"""Longest side of a picture, in pixels. Larger pictures are made smaller, because no object is that
large on an event camera."""
ALIKE = 0.03
"""Largest standard deviation of the luminance of a plain ground."""
DIFFERS = 0.05
"""Least difference between the luminance of the ground and of a pixel of the object."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in the luminance."""


@dataclass(frozen=True)
class Picture:
    """An object, cut out of its picture.

    Parameters
    ----------
    light : float32, (h, w): linear luminance, from 0 to 1.
    cover : float32, (h, w): 1 on the object, 0 beside it.
    ground : luminance of a plain ground around the object; None if it has no plain ground.
    """

    light: np.ndarray
    cover: np.ndarray
    ground: float | None


def read_picture(path: Path) -> Picture:
    """Read the object of a picture file.

    Raises
    ------
    ValueError : the file is no picture of one of the `FORMATS`, is damaged, has more than
        `MAX_PIXELS`, is a pointer of Git LFS, or shows nothing.
    OSError : the file is no regular file, or cannot be read.
    """
    refuse_git_lfs(path)
    try:
        colours = _colours(path)
    except ImportError:
        raise
    except Exception as error:  # a damaged file raises one of a dozen types of errors
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise ValueError(f"not a picture: {one_line(error)}") from None

    rgb = colours[..., :3]
    alpha = colours[..., 3]
    # decode sRGB
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    light = (linear @ LUMINANCE).astype(np.float32)
    if min(light.shape) < 2:
        size = f"{light.shape[1]}x{light.shape[0]}, if at most {LARGEST_SIDE} are used"
        raise ValueError(f"a picture must have sides of at least 2 pixels, got {size}")

    if (alpha < 1).any():
        return _cut_out(light, alpha, None, alpha > 0.5)
    border = np.concatenate([light[0], light[-1], light[1:-1, 0], light[1:-1, -1]])
    if border.std() < ALIKE:
        ground = float(np.median(border))
        differs = np.abs(light - ground) / DIFFERS
        return _cut_out(light, np.minimum(differs, 1), ground, differs > 1)
    return Picture(light, np.ones_like(light), None)


def _colours(path: Path) -> np.ndarray:
    """Read red, green, blue and alpha: float32, (h, w, 4), from 0 to 1.

    The picture is upright, and its sides are at most `LARGEST_SIDE`.
    """
    with needs_extra("train", "pictures need Pillow"):
        from PIL import Image, ImageOps, UnidentifiedImageError
    with warnings.catch_warnings(), open_regular(path) as content:
        # Pillow warns of pictures above its own limit; `MAX_PIXELS` is lower
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            opened = Image.open(content, formats=FORMATS)
        except UnidentifiedImageError:
            raise ValueError(
                f"its first bytes are those of no known format ({', '.join(FORMATS)})"
            ) from None
        with opened as file:
            if file.width * file.height > MAX_PIXELS:
                raise ValueError(
                    f"it must have at most {MAX_PIXELS:,} pixels, got {file.width}x{file.height}; "
                    "make it smaller"
                )
            image: Image.Image = ImageOps.exif_transpose(file)
            # `convert` would cut off values of 16 bits and more, so they are scaled first
            if image.mode.startswith(("I", "F")):
                values = np.array(image, np.float32)
                if not np.isfinite(values).all():
                    raise ValueError("a picture must have finite values")
                values *= np.float32(255.0 / max(float(values.max()), 1e-12))
                image = Image.fromarray(np.clip(values, 0, 255, out=values).astype(np.uint8))
            # RGBA first, because Pillow makes a picture with a palette smaller without averaging.
            image = image.convert("RGBA")
            image.thumbnail((LARGEST_SIDE, LARGEST_SIDE))
            return np.asarray(image, np.float32) / 255.0


def _cut_out(
    light: np.ndarray, cover: np.ndarray, ground: float | None, is_object: np.ndarray
) -> Picture:
    """Cut a picture to the smallest rectangle around its object.

    Parameters
    ----------
    light, cover, ground : see `Picture`.
    is_object : bool, (h, w): which pixels must be in the rectangle.
    """
    if not is_object.any():
        raise ValueError("nothing is on this picture: all of it is transparent, or alike")
    rows = np.flatnonzero(is_object.any(1))
    columns = np.flatnonzero(is_object.any(0))
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    return Picture(light[part], cover[part], ground)
