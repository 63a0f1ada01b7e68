"""Draw what a map model finds in the scene of `examples/several_digits.py`, at some moments.

python -m experiments.figure_objects --picture docs/images/objects.png
"""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt import load_model, stream
from async_tnt.views.figure_objects import draw_objects
from experiments.scripts.options import draw_into, exit_with, picture_parser

EXAMPLE = Path(__file__).resolve().parent.parent / "examples/several_digits.py"
"""The example whose scene is drawn."""

TIMES_MS = 90, 200, 400
"""Times at which the objects are drawn."""


def main(argv: list[str] | None = None) -> int:
    """Draw the picture."""
    parser = picture_parser("figure_objects", __doc__)
    parser.add_argument(
        "--model", default="digits-everywhere", help="a map model (default: %(default)s)"
    )
    args = parser.parse_args(argv)
    example: dict[str, Any] = runpy.run_path(str(EXAMPLE))
    events, _ = example["scene"](np.random.default_rng(0))
    model = load_model(args.model).for_sensor(example["SENSOR"])
    decisions = [
        decision
        for decision in stream(np.array_split(events, 100), model, every_us=10_000)
        if not decision.complete
    ]
    shown_decisions = [
        [decision for decision in decisions if decision.time_us <= 1000 * ms][-1] for ms in TIMES_MS
    ]
    titles = [f"{ms} ms" for ms in TIMES_MS]
    words = "Six digits that begin one after the other on 320x240 pixels"
    draw_into(
        args.picture,
        draw_objects,
        shown_decisions,
        titles,
        events,
        model.config.sensor,
        words,
        dpi=130,
    )
    return 0


if __name__ == "__main__":
    exit_with(main)
