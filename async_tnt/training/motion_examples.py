"""A few of the windows that were re-synthesized, made once more, for a picture."""

from __future__ import annotations

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.events import structured
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.resynthesis.pixels import MeasuredPixels, SimulatedPixels
from async_tnt.resynthesis.reconstruction import Reconstruction, shares
from async_tnt.training.moved_windows import Motions
from async_tnt.training.resynthesis import generator
from async_tnt.views.figure_resynthesis import ResynthesizedWindow

N_WINDOWS, N_OTHERS = 5, 4


def motion_examples(motions: Motions, config: TNTConfig, classes: tuple[str, ...]) -> list[ResynthesizedWindow]:
    """Windows of different classes, as far as there are, with their first variations."""
    found = np.flatnonzero(motions.found)
    labels, firsts = np.unique(motions.training.labels[found], return_index=True)
    which = found[firsts[np.unique(np.linspace(0, len(labels) - 1, N_WINDOWS).round().astype(int))]]
    reconstruction = Reconstruction(config.sensor, config.window_us)
    return [_example(motions, reconstruction, int(i), classes) for i in which]


def _example(motions: Motions, reconstruction: Reconstruction, i: int, classes: tuple[str, ...]) -> ResynthesizedWindow:
    measured = MeasuredPixels(**motions.record["pixels"]["measured"])
    pixels = SimulatedPixels(measured, motions.record["pixels"]["scale"])
    columns = motions.training.events(i, reconstruction.model.window_us)
    found = MotionPath(motions.paths[i], evidence=0.0, margin=np.inf, explained=1.0, n_events=len(columns[0]))
    image = reconstruction.image(columns, measured, found)
    path = found.at(shares())
    seed, n_others = motions.settings.seed, min(N_OTHERS, motions.settings.variations)
    others = [
        image.moved(motions.record["length_px"], pixels, generator(seed, "training", i, v)) for v in range(n_others)
    ]
    return ResynthesizedWindow(
        classes[motions.training.labels[i]],
        structured(columns),
        image.pictures(path[len(path) // 2 : len(path) // 2 + 1])[0],
        image.as_recorded(pixels, np.random.default_rng(seed)),
        [path, *(motion for _, motion in others)],
        [events for events, _ in others],
    )
