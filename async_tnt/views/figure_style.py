"""The style of all figures, the parts that they share, and `save`, which writes them to files."""

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
"""Colours of values with a sign: of the most negative value, of zero, of the most positive one."""
HIGHLIGHTS = (
    ("#000000", "-"),
    ("#009E73", (0, (5, 1.5))),
    ("#CC79A7", (0, (3, 1, 1, 1))),
    ("#E69F00", (0, (1, 1))),
)
"""Colours and dashes of the lines that the legend names."""
GREY = "#8a8a8a"
"""Colour of the lines that the legend does not name."""
PALE = "#c4c4c4"
"""Colour of frames."""
TEXT = "#555555"
"""Colour of small words."""

# Sizes of letters in points. The letters are legible in a figure 10.4 inches wide that is shown 900
# pixels wide.
SMALL = 9
NORMAL = 10
LARGE = 11
WIDTH = 10.4
"""Width of a figure, in inches."""

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
    "text.parse_math": False,  # a $ in a file's name is printed as a $
    "svg.fonttype": "none",  # text can be searched, and takes little space
    "svg.hashsalt": "async_tnt",  # the same figure gives the same bytes
}


def styled() -> AbstractContextManager[None]:
    """A context: figures that are made within its block have our style.

    The user's own settings of matplotlib have no effect there, and stay as they are.
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
    """Add axes to a figure, in inches. `left` and `top` count from its upper left corner."""
    figure_width, figure_height = figure.get_size_inches()
    return figure.add_axes(
        (
            left / figure_width,
            1 - (top + height) / figure_height,
            width / figure_width,
            height / figure_height,
        ),
        **settings,
    )


def picture_at(figure: Figure, left: float, top: float, width: float, height: float) -> Any:
    """Add axes for a picture, as `axes_at` does, but with a pale frame and without ticks."""
    axes = axes_at(figure, left, top, width, height, xticks=[], yticks=[])
    axes.spines[:].set(visible=True, color=PALE)
    return axes


def write_at(figure: Figure, left: float, top: float, words: str, **settings: Any) -> None:
    """Write a line of text. `left` and `top` are inches from the figure's upper left corner."""
    figure_width, figure_height = figure.get_size_inches()
    look = {"va": "center", "fontsize": LARGE, **settings}
    figure.text(left / figure_width, 1 - top / figure_height, printable(words), **look)


def headline(figure: Figure, words: str) -> None:
    """Write the figure's title, in its upper left corner."""
    write_at(figure, 0.21, 0.25, words, fontsize=LARGE + 2, fontweight="bold")


def note(
    axes: Any, words: str, point: tuple[float, float], offset: tuple[float, float], **settings: Any
) -> None:
    """Write small text beside the data point `point`. `offset` is (right, up), in 1/72 inch."""
    look = {"fontsize": SMALL, "color": TEXT, **settings}
    axes.annotate(words, point, xytext=offset, textcoords="offset points", **look)


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
    """Write a figure to a file, in the format of the file's suffix.

    Call it within `styled`, in which the figure was drawn. An existing file is replaced only when
    the new file is complete.

    Parameters
    ----------
    dpi : pixels per inch of a PNG file, and of the clouds of dots in an SVG or PDF file.
    """
    file_format = path.suffix.lower().removeprefix(".")
    # without dates and versions, the same figure gives the same bytes
    metadata = {
        "png": {"Software": "async_tnt"},
        "svg": {"Date": None},
        "pdf": {"CreationDate": None},
    }[file_format]
    with replacing(path) as part:
        figure.savefig(part, format=file_format, dpi=dpi, metadata=metadata)


def colour_map(*colours: str) -> Colormap:
    """A colour map from the first colour to the last, through all colours between them."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("async_tnt", colours)


def polarity_legend(figure: Figure, more: Sequence[Any] = ()) -> None:
    """Add a legend of ON dots, OFF dots and `more` handles, in the figure's upper right corner."""
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
    """A locator that places about four ticks, at round numbers."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(4, **settings)
