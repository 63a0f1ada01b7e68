"""The scene: an image on a screen, seen by a sensor through a lens, as frames of log luminance.

With v = image^gamma in [0, 1] (1 = stroke), blurred by the lens,

    luminance = 1 - (1 - 1/contrast) v              dark strokes on a bright background
    luminance = 1/contrast + (1 - 1/contrast) v     bright strokes on a dark background

so `contrast` is the ratio of the brighter to the darker of the two, and log luminance spans
[-log contrast, 0].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from async_tnt.base.checks import plain_array
from async_tnt.kernels.jit import cached


@dataclass(frozen=True)
class Scene:
    """What the sensor looks at.

    The defaults are fitted to N-MNIST: `experiments/RESULTS.md` compares them.

    Attributes
    ----------
    contrast : ratio of the brighter to the darker luminance, above 1.
    gamma : exponent from the image's values to the screen's luminance; above 1 makes strokes
        thinner.
    blur_px : standard deviation of the lens' Gaussian point spread, in sensor pixels.
    dark_on_bright : True shows dark strokes on a bright background, so ON events trail the motion
        and OFF events lead it, as in N-MNIST. False shows bright strokes on a dark background,
        with opposite polarities.
    """

    contrast: float = 5.0
    gamma: float = 1.25
    blur_px: float = 0.53
    dark_on_bright: bool = True

    def __post_init__(self) -> None:
        if not (math.isfinite(self.contrast) and self.contrast > 1):
            raise ValueError(f"`contrast` must be a finite ratio above 1, got {self.contrast}")
        if not (math.isfinite(self.gamma) and self.gamma > 0):
            raise ValueError(f"`gamma` must be a finite exponent above 0, got {self.gamma}")
        if not (math.isfinite(self.blur_px) and self.blur_px >= 0):
            raise ValueError(
                f"`blur_px` must be a finite number of pixels, at least 0, got {self.blur_px}"
            )


def render(
    image: np.ndarray,
    dx: np.ndarray,
    dy: np.ndarray,
    *,
    scene: Scene | None = None,
    sensor: tuple[int, int] = (34, 34),
) -> np.ndarray:
    """Frames of log luminance of an image displaced by (dx, dy) pixels.

    Frame k at sensor pixel (x, y) shows the blurred image at (x - dx[k], y - dy[k]), interpolated
    bilinearly. Places beyond the image show the background.

    Parameters
    ----------
    image : shape (h, w); uint8 in 0-255, or floating in [0, 1]; 0 is the background.
    dx, dy : shape (K,), in pixels.
    scene : contrast, blur and polarity; `Scene()` by default.
    sensor : (width, height) in pixels.

    Returns
    -------
    float64, shape (K, height, width), natural log of the luminance relative to the brighter part.

    Raises
    ------
    ValueError : wrong shapes, values out of range, or a displacement that is not finite.
    """
    scene = Scene() if scene is None else scene
    strokes = _checked_image(image) ** scene.gamma
    dx = np.ascontiguousarray(plain_array("dx", dx), np.float64)
    dy = np.ascontiguousarray(plain_array("dy", dy), np.float64)
    if dx.ndim != 1 or dx.shape != dy.shape:
        raise ValueError(
            f"`dx` and `dy` must be 1-D and equally long, got shapes {dx.shape} and {dy.shape}"
        )
    if not (np.isfinite(dx).all() and np.isfinite(dy).all()):
        raise ValueError("`dx` and `dy` must be finite")
    width, height = sensor
    if width < 1 or height < 1:
        raise ValueError(f"`sensor` must be a positive (width, height), got {sensor}")

    # room for 3 standard deviations of blur, and for one pixel of background
    margin = math.ceil(3.0 * scene.blur_px) + 1
    blurred = _blur(np.pad(strokes, margin), scene.blur_px)
    frames = np.empty((len(dx), height, width))
    translate(frames, blurred, dx - margin, dy - margin)
    depth = 1.0 - 1.0 / scene.contrast
    if scene.dark_on_bright:
        return np.log(1.0 - depth * frames)
    return np.log(1.0 / scene.contrast + depth * frames)


def _checked_image(image: np.ndarray) -> np.ndarray:
    image = plain_array("image", image)
    if image.ndim != 2 or image.size == 0:
        raise ValueError(f"`image` must be 2-D and not empty, got shape {image.shape}")
    if image.dtype == np.uint8:
        return image / 255.0
    if image.dtype.kind != "f":
        raise ValueError(f"`image` must be uint8 (0-255) or floating (0-1), got {image.dtype}")
    if not ((image >= 0) & (image <= 1)).all():  # also refuses nan
        raise ValueError(
            f"a floating `image` must lie in [0, 1], got {image.min()} to {image.max()}"
        )
    return image.astype(np.float64)


def _blur(image: np.ndarray, sigma: float) -> np.ndarray:
    """An image after a separable Gaussian blur. Beyond the border is background (zero)."""
    if sigma == 0:
        return image
    radius = math.ceil(3.0 * sigma)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    weights /= weights.sum()
    rows, columns = image.shape
    padded = np.pad(image, radius)
    down = sum(w * padded[i : i + rows] for i, w in enumerate(weights))
    return np.ascontiguousarray(sum(w * down[:, j : j + columns] for j, w in enumerate(weights)))


@cached
def translate(frames: np.ndarray, image: np.ndarray, dx: np.ndarray, dy: np.ndarray) -> None:
    """Shift an image by a fraction of pixels, bilinearly.

        frames[k, y, x] = sum_ij image[i, j] weight(y - dy[k] - i) weight(x - dx[k] - j)
        weight(a) = max(0, 1 - |a|)

    Parameters
    ----------
    frames : float64, shape (K, H, W). Overwritten.
    image : float64, shape (h, w); 0 beyond it.
    dx, dy : float64, shape (K,), in pixels, finite.
    """
    n_rows, n_columns = image.shape
    for k in range(frames.shape[0]):
        left = np.floor(-dx[k])
        top = np.floor(-dy[k])
        x_frac = -dx[k] - left
        y_frac = -dy[k] - top
        # clamped before the integer cast, which is undefined for huge values
        first_column = int(min(max(left, -1e6), 1e6))
        first_row = int(min(max(top, -1e6), 1e6))
        for y in range(frames.shape[1]):
            i = first_row + y
            for x in range(frames.shape[2]):
                j = first_column + x
                value = 0.0
                if 0 <= i < n_rows:
                    if 0 <= j < n_columns:
                        value += (1.0 - y_frac) * (1.0 - x_frac) * image[i, j]
                    if 0 <= j + 1 < n_columns:
                        value += (1.0 - y_frac) * x_frac * image[i, j + 1]
                if 0 <= i + 1 < n_rows:
                    if 0 <= j < n_columns:
                        value += y_frac * (1.0 - x_frac) * image[i + 1, j]
                    if 0 <= j + 1 < n_columns:
                        value += y_frac * x_frac * image[i + 1, j + 1]
                frames[k, y, x] = value
