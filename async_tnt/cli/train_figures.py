"""The figures that `async-tnt train` writes, where matplotlib is installed."""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from async_tnt.cli.output import note
from async_tnt.views.figure_style import save, styled

if TYPE_CHECKING:
    from async_tnt.training.moved_windows import Motions
    from async_tnt.training.training_data import TrainingData


def draw_motions(motions: Motions, data: TrainingData, path: Path) -> None:
    """Draw some windows under other motions.

    Nothing is drawn if no motion was found in any window, or if matplotlib is not installed.
    """
    if find_spec("matplotlib") is None or not motions.spans.any():
        return
    from async_tnt.training.resynthesis import examples
    from async_tnt.views.figure_resynthesis import draw_resynthesis

    with styled():
        save(draw_resynthesis(*examples(motions, data.classes)), path)


def draw_pictures(args: argparse.Namespace, data: TrainingData, path: Path) -> None:
    """Draw some pictures of the data set, and simulated recordings of them.

    Nothing is drawn without pictures, without matplotlib, or if the file exists already.
    """
    if "pictures" not in data.record or path.exists() or find_spec("matplotlib") is None:
        return
    from async_tnt.simulation.measured_pixels import MeasuredPixels
    from async_tnt.simulation.picture_scene import SceneSettings
    from async_tnt.training.simulated_pictures import example_recordings, find_pictures
    from async_tnt.views.figure_resynthesis import draw_recorded_pictures

    sensor = data.config.sensor
    fields = dict(data.record["pictures"]["settings"])
    if fields["camera"] is not None:
        fields["camera"] = MeasuredPixels(**fields["camera"])
    fields["sensor"] = sensor
    fields["size"] = tuple(fields["size"])
    examples = example_recordings(find_pictures(args.dataset), SceneSettings(**fields), args.seed)
    with styled():
        save(draw_recorded_pictures(examples, sensor), path)
    note(f"some recordings of pictures: {path}")
