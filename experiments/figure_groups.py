"""Draw to which transformations a convolution is equivariant, as in chapter 2 of the thesis.

    python -m experiments.figure_groups --picture docs/images/groups.png

The events of a bundled 3 are counted in an image. In the first way to its features, the image is
moved or turned before a convolution. In the second way, the features are moved or turned after the
convolution. The picture shows both, and their difference relative to the size of the features.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F

from async_tnt.sources import open_recording, sample_recordings
from async_tnt.views.figure_style import SMALL, TEXT, headline, new_figure, picture_at, write_at
from experiments.scripts.options import draw_into, exit_with, picture_parser

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIDE = 51
"""Width and height of the image, in pixels; odd, so that a quarter turn moves whole pixels."""

WINDOW_US = 105_000
"""Length of the window whose events are counted, in microseconds."""

Map = Callable[[torch.Tensor], torch.Tensor]
"""A function from an image to another image or to features, or from features to features."""


class Case(NamedTuple):
    """A row of the picture: two ways to compute features, which equivariance would make the same.

    In the first way the image is transformed, and then its features are computed. In the second way
    the features of the image are computed, and then they are transformed.

    title : title of the row.
    transform_image : transforms the image.
    features_of_transformed : computes the features of the transformed image.
    features_of_image : computes the features of the image as it is.
    transform_features : transforms the features of the image.
    """

    title: str
    transform_image: Map
    features_of_transformed: Map
    features_of_image: Map
    transform_features: Map


def counted() -> torch.Tensor:
    """ON minus OFF events of the first saccade of a bundled 3, (1, 1, SIDE, SIDE)."""
    events = open_recording(sample_recordings()[3]).read()
    events = events[events["t"] < WINDOW_US]
    image = np.zeros((SIDE, SIDE))
    margin = (SIDE - 34) // 2
    np.add.at(image, (events["y"] + margin, events["x"] + margin), 2.0 * events["p"] - 1)
    return torch.from_numpy(image)[None, None]


def edge_filter() -> torch.Tensor:
    """A filter for an edge, which a quarter turn changes; shape (1, 1, 5, 5)."""
    y, x = np.mgrid[-2:3, -2:3]
    return torch.from_numpy((x + 0.4 * y) * np.exp(-(x**2 + y**2) / 3.0))[None, None]


def moved(by: int) -> Map:
    """A function that moves an image to the right by `by` pixels, round the border."""
    return lambda image: image.roll(by, -1)


def turned(image: torch.Tensor) -> torch.Tensor:
    """An image after a quarter turn."""
    return image.rot90(1, (-2, -1))


def convolved(filters: torch.Tensor) -> Map:
    """A function that convolves an image with filters."""
    return lambda image: F.conv2d(image, filters, padding="same")


def lifted(image: torch.Tensor) -> torch.Tensor:
    """Four maps of features, (1, 4, H, W): one for each quarter turn of the filter."""
    return torch.cat([convolved(edge_filter().rot90(k, (-2, -1)))(image) for k in range(4)], 1)


def turned_lift(maps: torch.Tensor) -> torch.Tensor:
    """The maps that `lifted` should have for a turned image.

    Each map is turned, and takes the place of the map of the next quarter turn.
    """
    return turned(maps).roll(1, 1)


def pooled(image: torch.Tensor) -> torch.Tensor:
    """The features of an image by the edge filter, pooled by 2."""
    return F.avg_pool2d(convolved(edge_filter())(image), 2)


CASES = (
    Case("moved by 6 px", moved(6), convolved(edge_filter()), convolved(edge_filter()), moved(6)),
    Case("turned", turned, convolved(edge_filter()), convolved(edge_filter()), turned),
    Case(
        "turned, filter turned back",
        turned,
        convolved(edge_filter()),
        convolved(edge_filter().rot90(-1, (-2, -1))),
        turned,
    ),
    Case("turned, all four filters", turned, lifted, lifted, turned_lift),
    Case("moved by 2 px, pooled by 2", moved(2), pooled, pooled, moved(1)),
    Case("moved by 1 px, pooled by 2", moved(1), pooled, pooled, moved(1)),
)
"""The rows of the picture."""


def compared(case: Case, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, float]:
    """Two sets of features of a case, and their relative difference.

    The first set has the features of the transformed image. The second set has the features of the
    image, transformed.
    """
    first = case.features_of_transformed(case.transform_image(image))
    second = case.transform_features(case.features_of_image(image))
    return first, second, float((first - second).norm() / second.norm())


def draw() -> Figure:
    """Draw a row for each case."""
    image = counted()
    figure = new_figure(1.2 * len(CASES) + 0.95)
    heads = ("image", "transformed", "its features", "features, transformed", "difference")
    for k, case in enumerate(CASES):
        first, second, error = compared(case, image)
        top = 0.85 + 1.2 * k
        write_at(figure, 0.3, top + 0.55, case.title, fontsize=SMALL, color=TEXT)
        largest = float(second.abs().max())
        for place, (head, part) in enumerate(
            zip(
                heads,
                (image, case.transform_image(image), first, second, first - second),
                strict=True,
            )
        ):
            axes = picture_at(figure, 2.6 + 1.45 * place, top, 1.1, 1.1)
            # the first two pictures show images, the pictures after them show features
            limit = float(image.abs().max()) if place < 2 else largest
            axes.imshow(_tiled(part), cmap="RdBu_r", vmin=-limit, vmax=limit)
            if k == 0:
                axes.set_title(head, fontsize=SMALL, color=TEXT)
        write_at(
            figure, 2.6 + 1.45 * len(heads), top + 0.55, f"{error:.2f}", fontsize=SMALL, color=TEXT
        )
    headline(figure, "What a convolution is equivariant to")
    return figure


def _tiled(maps: torch.Tensor) -> np.ndarray:
    """One map as it is, or four maps side by side as 2 by 2."""
    parts: Any = maps[0].numpy()
    return parts[0] if len(parts) == 1 else np.block([[parts[0], parts[1]], [parts[2], parts[3]]])


def main(argv: list[str] | None = None) -> int:
    """Draw the picture."""
    args = picture_parser("figure_groups", __doc__).parse_args(argv)
    draw_into(args.picture, draw)
    return 0


if __name__ == "__main__":
    exit_with(main)
