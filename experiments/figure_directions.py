"""Draw accuracy by direction of the simulated motions, from experiments/results/thesis.

python -m experiments.figure_directions --picture docs/images/directions.png
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.views.figure_style import OFF, ON, TEXT, headline, new_figure
from experiments.scripts.options import draw_into, exit_with, picture_parser
from experiments.thesis.table import recorded_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOOKS: dict[str, dict[str, Any]] = {
    "thesis-baseline": {"color": "#000000"},
    "thesis-tnt": {"color": ON},
    "thesis-regress": {"color": OFF},
    "raw-reversed": {"color": "#8a8a8a", "ls": (0, (4, 1.5))},
    "raw-motions": {"color": "#009E73"},
}
"""Row of the table -> how its line is drawn."""

PANELS = {"1/sim": "trained on the first saccade", "all/sim": "trained on all three saccades"}
"""Column of the table -> title of its panel."""

SACCADES_DEG = {1: 75.0, 2: 308.0, 3: 183.0}
"""Number of a saccade of N-MNIST -> its direction, by `nmnist_saccades`; 90 is downwards."""


def by_direction(per_motion: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """The directions of motions, in radians, and for each the mean accuracy over all distances.

    per_motion : name of a motion, such as "036deg-5px" -> accuracy.
    """
    accuracies_by_direction: dict[int, list[float]] = {}
    for motion, accuracy in per_motion.items():
        accuracies_by_direction.setdefault(int(motion[:3]), []).append(accuracy)
    directions = sorted(accuracies_by_direction)
    return np.radians(directions), np.array(
        [np.mean(accuracies_by_direction[direction]) for direction in directions]
    )


def draw(report: dict[str, Any]) -> Figure:
    """Draw a polar panel for each set that was trained on.

    The angle is the direction of motion; 90 degrees, downwards, is below. The radius is the
    accuracy.
    """
    from experiments.thesis.rows import ROWS

    table = report["table"]
    figure = new_figure(5.6)
    for place, (column, panel_title) in enumerate(PANELS.items()):
        axes: Any = figure.add_axes((0.06 + 0.47 * place, 0.19, 0.41, 0.64), projection="polar")
        axes.set_theta_direction(-1)  # y grows downwards
        for row, look in LOOKS.items():
            if column in table.get(row, {}):
                angles, accuracies = by_direction(table[row][column]["per_motion"])
                title = ROWS[row].title.replace("`", "")
                closed_line = np.append(angles, angles[0]), np.append(accuracies, accuracies[0])
                axes.plot(*closed_line, label=title if place == 0 else None, lw=1.6, **look)
        # a circle at the accuracy of guessing one of ten classes
        axes.plot(
            np.linspace(0, 2 * np.pi, 100), np.full(100, 0.1), color="#b0b0b0", lw=0.8, ls=":"
        )
        axes.set_ylim(0, 1)
        axes.set_yticks([0.25, 0.5, 0.75, 1.0], [".25", ".5", ".75", "1"])
        axes.set_rlabel_position(-20)
        axes.set_xticks(np.radians([0, 90, 180, 270]), ["right", "down", "left", "up"])
        axes.set_title(panel_title, color=TEXT, fontsize=9)
        for saccade in (1,) if column == "1/sim" else (1, 2, 3):
            angle = np.radians(SACCADES_DEG[saccade])
            axes.annotate(
                "",
                (angle, 1.16),
                (angle, 1.01),
                arrowprops={"arrowstyle": "->", "color": TEXT},
                annotation_clip=False,
            )
    headline(
        figure,
        "Accuracy by direction of simulated motions; arrows: saccades trained on; dotted: guessing",
    )
    figure.legend(loc="lower center", ncols=3, labelcolor=TEXT)
    return figure


def main(argv: list[str] | None = None) -> int:
    """Draw the picture."""
    args = picture_parser("figure_directions", __doc__).parse_args(argv)
    draw_into(args.picture, draw, recorded_table())
    return 0


if __name__ == "__main__":
    exit_with(main)
