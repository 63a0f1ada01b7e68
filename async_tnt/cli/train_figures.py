"""The figures that `async-tnt train` writes, where matplotlib is installed."""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from async_tnt.cli.output import note
from async_tnt.views.figure_style import save, styled

if TYPE_CHECKING:
    from async_tnt.training.data import TrainingData
    from async_tnt.training.moved_windows import Motions


def draw_motions(motions: Motions, data: TrainingData, path: Path) -> None:
    """Draw some windows, where there are any and matplotlib is installed."""
    if find_spec("matplotlib") is None:
        return
    from async_tnt.training.resynthesis import examples
    from async_tnt.views.figure_resynthesis import draw_resynthesis

    if motions.spans.any():
        with styled():
            save(draw_resynthesis(*examples(motions, data.classes)), path)


def draw_pictures(args: argparse.Namespace, data: TrainingData, path: Path) -> None:
    """Draw some pictures and recordings of them, where there are any and matplotlib is
    installed."""
    from async_tnt.simulation.measured_pixels import MeasuredPixels
    from async_tnt.simulation.picture_scene import SceneSettings
    from async_tnt.training.simulated_pictures import example_recordings, find_pictures
    from async_tnt.views.figure_resynthesis import draw_recorded_pictures

    found = find_pictures(args.dataset)
    if "pictures" not in data.record or path.exists() or find_spec("matplotlib") is None:
        return
    about = data.record["pictures"]["settings"]
    camera = about["camera"] and MeasuredPixels(**about["camera"])
    settings = SceneSettings(
        **{**about, "sensor": data.config.sensor, "size": args.size, "camera": camera}
    )
    with styled():
        save(
            draw_recorded_pictures(
                example_recordings(found, settings, args.seed), data.config.sensor
            ),
            path,
        )
    note(f"some recordings of pictures: {path}")
