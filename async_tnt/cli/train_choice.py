"""The choice of volume and network in `async-tnt train DATASET`: what is asked, tried, shown and kept."""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from async_tnt.checks import one_line
from async_tnt.cli.output import note
from async_tnt.config import TNTConfig
from async_tnt.files import write_text
from async_tnt.progress import progress
from async_tnt.training.choice import Candidate, Questions, Trial, choose
from async_tnt.training.data import TrainingData
from async_tnt.training.run_folder import has_checkpoint
from async_tnt.training.settings import TrainSettings

FILE = "choice.json"
VOLUME_OPTIONS = ("representation", "transform", "landmark", "t_max", "bins")


def questions_of(args: argparse.Namespace) -> Questions:
    """What the options leave open."""
    if args.quick or args.start_from or args.motions == "resynthesized":
        return Questions(False, False, False, False, False)
    return Questions(
        transform=not args.remove_flow and all(getattr(args, name) is None for name in VOLUME_OPTIONS),
        polarity=args.polarity is None and args.representation in (None, "volume"),
        grid=args.grid is None,
        network=args.network is None,
        mirror=args.mirror is None and not args.no_augmentation,
    )


class Choice:
    """The volume and the network of one run: chosen once, then kept in its folder.

    Parameters
    ----------
    run_folder : of the run.
    depends_on : the options that it follows from.
    recordings : name -> bytes. Once the training has begun, `check_run` compares them.
    """

    def __init__(self, run_folder: Path, depends_on: Mapping[str, Any], recordings: Mapping[str, int]) -> None:
        self._run_folder, self._file = run_folder, run_folder / FILE
        self._key, self._recordings = (
            hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:12]
            for what in (depends_on, recordings)
        )
        self._folder = run_folder / f"choice-{self._key}-{self._recordings}"
        self.trials: list[dict[str, Any]] = []
        self.chosen: Candidate | None = None
        try:
            found = json.loads(self._file.read_text(encoding="utf-8"))
            same_recordings = has_checkpoint(run_folder) or found["recordings"] == self._recordings
            if found["key"] == self._key and same_recordings:
                self.trials = found["trials"]
                self.chosen = Candidate(TNTConfig.from_dict(found["config"]), found["network"], found["mirror"])
                self._delete_trials()
        except FileNotFoundError:
            return
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{self._file}: damaged ({one_line(error)}); delete it to choose again") from None

    def make(
        self,
        data: TrainingData,
        start: Candidate,
        questions: Questions,
        settings_of: Callable[[Candidate, int], TrainSettings],
    ) -> Candidate:
        """Try the candidates, which resumes like any training, and keep the result; `start`, if none is held out."""

        def try_out(candidate: Candidate, steps: int) -> Trial | None:
            return _try_out(candidate, steps, data, settings_of(candidate, steps), self._folder)

        best = start
        if len(data.validation):
            note("trying volumes and networks (--quick leaves that out)")
            trials = choose(start, questions, try_out)
            self.trials = [trial.to_dict() for trial in trials]
            best = trials[-1].candidate
            note(f"chosen: {best}")
        else:
            note(
                "no recording is held out (--validation) to compare volumes and networks on: what no option gives "
                "takes its default"
            )
        self.chosen = best
        kept: dict[str, Any] = {"key": self._key, "recordings": self._recordings, "trials": self.trials}
        kept |= {**asdict(best), "config": best.config.to_dict()}
        write_text(self._file, json.dumps(kept, indent=1))
        self._delete_trials()
        return best

    def _delete_trials(self) -> None:
        """Also those of earlier options, and what an interruption left."""
        for folder in self._run_folder.glob("choice-*"):
            shutil.rmtree(folder, ignore_errors=True)


def _try_out(
    candidate: Candidate, steps: int, data: TrainingData, settings: TrainSettings, folder: Path
) -> Trial | None:
    from async_tnt.training.loop import train
    from async_tnt.training.pipeline import check_network

    try:
        check_network(candidate.network, candidate.config)
    except ValueError as error:
        note(f"  {candidate}: left out: {error}")
        return None
    started = time.monotonic()
    result = train(
        candidate.config,
        data.training,
        data.validation,
        settings,
        folder / hashlib.sha256(f"{candidate}, {steps}".encode()).hexdigest()[:12],
        classes=data.classes,
        progress=progress,
    )
    row = result.history[-1]
    seconds = time.monotonic() - started
    note(f"  {candidate!s:<44} {row['per_moment']:.4f} held out after {steps:,} steps  ({seconds:.0f} s)")
    return Trial(candidate, steps, row["per_moment"], row["validation_loss"])
