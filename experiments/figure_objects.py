"""Draw what a map model finds in the scene of `examples/several_digits.py`, at some moments.

python -m experiments.figure_objects --picture docs/images/objects.png
"""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt import load_model, stream
from async_tnt.views.figure_style import OFF, ON, TEXT, axes_at, check_picture, headline, new_figure, save, styled
from experiments.script_options import exit_with, plain_parser

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXAMPLE = Path(__file__).resolve().parent.parent / "examples/several_digits.py"
TIMES_MS = 90, 200, 400


def draw(model_name: str) -> Figure:
    """A panel for each moment: the events of the open window, and what the last decision found in them."""
    example: dict[str, Any] = runpy.run_path(str(EXAMPLE))
    (width, height), (events, _) = example["SENSOR"], example["scene"](np.random.default_rng(0))
    model = load_model(model_name).for_sensor((width, height))
    decisions = list(stream(np.array_split(events, 100), model, every_us=10_000))
    figure = new_figure(3.1)
    for k, ms in enumerate(TIMES_MS):
        axes = axes_at(figure, 0.15 + 3.4 * k, 0.7, 3.12, 2.34)
        decision = [one for one in decisions if one.time_us <= 1000 * ms and not one.complete][-1]
        since = (events["t"] >= decision.window_start_us) & (events["t"] <= decision.time_us)
        for p, colour in ((1, ON), (0, OFF)):
            some = events[since & (events["p"] == p)]
            axes.plot(some["x"], some["y"], ",", color=colour, alpha=0.6)
        for found in decision.objects or ():
            words: dict[str, Any] = {"color": TEXT, "ha": "right" if found.x > width - 50 else "left"}
            x = found.x + (-17 if words["ha"] == "right" else 17)
            axes.text(x, found.y - 13, found.label, fontsize=13, weight="bold", **words)
            axes.text(x, found.y + 2, f"{found.probability:.2f}", fontsize=7, **words)
            axes.plot(found.x, found.y, "o", ms=26, mfc="none", mec=TEXT, mew=0.7)
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xticks=[], yticks=[], aspect="equal")
        axes.spines[:].set_visible(True)
        axes.set_title(f"{ms} ms", loc="left", fontsize=9, color=TEXT)
    headline(figure, f"Six digits that begin one after the other on {width}x{height} pixels")
    return figure


def main(argv: list[str] | None = None) -> int:
    """Draw the picture."""
    parser = plain_parser("figure_objects", __doc__)
    parser.add_argument("--model", default="digits-everywhere", help="a map model (default: %(default)s)")
    parser.add_argument("--picture", type=Path, metavar="FILE", required=True, help=".png, .svg or .pdf")
    args = parser.parse_args(argv)
    check_picture(args.picture)
    with styled():
        save(draw(args.model), args.picture, dpi=130)
    return 0


if __name__ == "__main__":
    exit_with(main)
