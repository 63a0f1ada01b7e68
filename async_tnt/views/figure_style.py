"""The style of all figures, and how they are written to files: completely or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from async_tnt.base.extras import needs_extra
from async_tnt.base.files import check_writable, replacing
from async_tnt.base.messages import printable

if TYPE_CHECKING:
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which colour-blind people can distinguish
ON = "#D55E00"
"""Colour of ON events."""
OFF = "#0072B2"
"""Colour of OFF events."""
OFF_TO_ON = OFF, "#ffffff", ON
"""Colours of what has a sign, from its smallest value over zero to its largest."""
HIGHLIGHTS = (
    ("#000000", "-"),
    ("#009E73", (0, (5, 1.5))),
    ("#CC79A7", (0, (3, 1, 1, 1))),
    ("#E69F00", (0, (1, 1))),
)
"""Colours and dashes of the lines that are named."""
GREY = "#8a8a8a"
"""Colour of lines that are not named."""
PALE = "#c4c4c4"
"""Colour of frames."""
TEXT = "#555555"
"""Colour of small words."""

# sizes of letters in points: legible in a figure 10.4 inches wide that is shown 900 pixels wide
SMALL = 9
NORMAL = 10
LARGE = 11
WIDTH = 10.4
"""Inches of a figure."""

FORMATS = (".png", ".svg", ".pdf")
_STYLE: dict[str, Any] = {
    "font.size": NORMAL,
    "axes.titlesize": LARGE,
    "axes.labelsize": NORMAL,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#dddddd",
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
    "legend.fontsize": SMALL,
    "legend.frameon": False,
    "text.parse_math": False,  # a $ in a file's name is a $
    "svg.fonttype": "none",  # words stay words: searchable, and small
    "svg.hashsalt": "async_tnt",  # the same figure gives the same bytes
}


def styled() -> AbstractContextManager[None]:
    """Give figures our style within the block.

    The user's settings do not matter and stay as they are.
    """
    import matplotlib.style

    return matplotlib.style.context(["default", _STYLE])


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """A figure of this size in inches, unknown to pyplot and not shown on a screen."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), facecolor="white")


def axes_at(
    figure: Figure, left: float, top: float, width: float, height: float, **settings: Any
) -> Any:
    """Axes at inches from the figure's upper left corner."""
    w, h = figure.get_size_inches()
    return figure.add_axes((left / w, 1 - (top + height) / h, width / w, height / h), **settings)


def picture_at(figure: Figure, left: float, top: float, width: float, height: float) -> Any:
    """`axes_at` for a picture: with a pale frame, without ticks."""
    axes = axes_at(figure, left, top, width, height, xticks=[], yticks=[])
    axes.spines[:].set(visible=True, color=PALE)
    return axes


def write_at(figure: Figure, left: float, top: float, words: str, **settings: Any) -> None:
    """One line of words at inches from the figure's upper left corner."""
    w, h = figure.get_size_inches()
    look = {"va": "center", "fontsize": LARGE, **settings}
    figure.text(left / w, 1 - top / h, printable(words), **look)


def headline(figure: Figure, words: str) -> None:
    """The figure's title, at its upper left."""
    write_at(figure, 0.21, 0.25, words, fontsize=LARGE + 2, fontweight="bold")


def note(
    axes: Any, words: str, at: tuple[float, float], offset: tuple[float, float], **settings: Any
) -> None:
    """Small words beside a point of the data, `offset` points away."""
    look = {"fontsize": SMALL, "color": TEXT, **settings}
    axes.annotate(words, at, xytext=offset, textcoords="offset points", **look)


def check_picture(path: Path) -> None:
    """Refuse a picture file that `save` could not write, before any work is done.

    Raises
    ------
    ImportError : matplotlib is missing.
    ValueError, OSError : see `check_writable`.
    """
    with needs_extra("plot", "pictures are drawn by matplotlib"):
        import matplotlib  # noqa: F401
    check_writable(path, FORMATS)


def save(figure: Figure, path: Path, dpi: int = 150) -> None:
    """Write a figure, drawn `styled`, in the format of the suffix.

    An existing file is replaced when the new one is complete.

    Parameters
    ----------
    dpi : pixels per inch of a PNG, and of the clouds of dots in SVG and PDF.
    """
    kind = path.suffix.lower().removeprefix(".")
    # no dates and versions: the same figure gives the same bytes
    metadata = {
        "png": {"Software": "async_tnt"},
        "svg": {"Date": None},
        "pdf": {"CreationDate": None},
    }[kind]
    with replacing(path) as part:
        figure.savefig(part, format=kind, dpi=dpi, metadata=metadata)


def colour_map(*colours: str) -> Colormap:
    """A colour map from the first colour to the last, over those between them."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("async_tnt", colours)


def polarity_legend(figure: Figure, more: Sequence[Any] = ()) -> None:
    """A legend for ON and OFF dots, and `more` handles, at the figure's upper right."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], marker="o", ls="", ms=5, color=colour, mec="none", label=name)
        for colour, name in ((ON, "ON (brighter)"), (OFF, "OFF (darker)"))
    ]
    corner = (0.985, 1 - 0.25 / figure.get_figheight())
    look = {"handletextpad": 0.3, "columnspacing": 1.2, "borderpad": 0}
    figure.legend(
        handles=[*handles, *more], loc="center right", bbox_to_anchor=corner, ncols=3, **look
    )


def shortened(name: str, most: int) -> str:
    """A name on one line, cut to at most `most` letters."""
    name = printable(name)
    return name if len(name) <= most else name[: most - 1] + "…"


def few_ticks(**settings: Any) -> Any:
    """About four ticks, at round numbers."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(4, **settings)
