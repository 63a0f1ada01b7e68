"""`async-tnt train --motions resynthesized`: other motions of the windows to train on, what was found, a picture."""

from __future__ import annotations

import argparse
from pathlib import Path

from async_tnt.cli.output import note
from async_tnt.networks.model import Model
from async_tnt.progress import progress
from async_tnt.simulation.statistics import side_by_side
from async_tnt.training.data import TrainingData
from async_tnt.training.moved_windows import Motions, MotionSettings
from async_tnt.training.resynthesis import resynthesize
from async_tnt.training.run_folder import identity_of, load_checkpoint
from async_tnt.training.settings import TrainSettings
from async_tnt.worker import available_cores

FOLDER, PICTURE = "motions", "motions.png"


def other_motions(
    args: argparse.Namespace, data: TrainingData, settings: TrainSettings, start: Model | None, run_folder: Path
) -> Motions | None:
    """Make them in the run's folder, or open those that are there; None with --motions recorded.

    Raises
    ------
    ValueError : the folder holds another run; no motion was found.
    """
    if args.motions == "recorded":
        return None
    given = {name: getattr(args, name) for name in ("variations", "recorded") if getattr(args, name) is not None}
    motion_settings = MotionSettings(**given, shared_path=args.shared_path, seed=args.seed).for_epochs(
        settings.n_epochs(len(data.training))
    )
    # refuses another run before the work
    load_checkpoint(
        run_folder,
        identity_of(data.config, settings, data.training, data.validation, start, data.classes, motion_settings),
    )
    folder = run_folder / FOLDER
    motions = resynthesize(
        data.training,
        data.validation,
        data.config,
        motion_settings,
        folder,
        masked=data.masked,
        workers=args.workers or available_cores(),
        progress=progress,
    )
    record = motions.record
    note(
        f"motion found in {record['with_path']} of {record['windows']} windows; the others are used as recorded only",
        "recorded windows, and the same motion simulated again:",
        *side_by_side(record["match"]).splitlines(),
    )
    _draw(motions, data, folder / PICTURE)
    return motions


def _draw(motions: Motions, data: TrainingData, path: Path) -> None:
    """Draw some windows, where there are any and matplotlib is installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return
    from async_tnt.training.motion_examples import motion_examples
    from async_tnt.views.figure_resynthesis import write_resynthesis

    if motions.found.any():
        write_resynthesis(motion_examples(motions, data.config, data.classes), path)
