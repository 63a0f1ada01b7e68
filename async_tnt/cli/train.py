"""`async-tnt train`: train a model on folders of recordings, one for each class, or on tables."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from async_tnt.base.extras import needs_extra
from async_tnt.base.files import check_folder, check_ours, check_writable, locked_folder, write_text
from async_tnt.base.package import available_cores
from async_tnt.base.progress import progress
from async_tnt.cli.options import command_words, reading_of, volume_of
from async_tnt.cli.output import note
from async_tnt.cli.pixel_options import pixels_of
from async_tnt.cli.train_figures import draw_motions, draw_pictures
from async_tnt.cli.train_options import DESCRIPTION, REMOVED, add_arguments
from async_tnt.cli.train_summary import print_summary
from async_tnt.simulation.picture_scene import SceneSettings
from async_tnt.sources.files.labelled_recordings import has_test
from async_tnt.sources.files.source import ReadOptions
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.volume.sensor import format_size

if TYPE_CHECKING:
    from async_tnt.simulation.measured_pixels import MeasuredPixels
    from async_tnt.training.fitting import Fitted
    from async_tnt.training.moved_windows import Motions
    from async_tnt.training.settings import TrainSettings
    from async_tnt.training.training_data import TrainingData

__all__ = ["DESCRIPTION", "REMOVED", "add_arguments", "main"]

FEW_PATHS = 0.2
"""If the motion is found in a smaller share of the windows, there is a warning."""


@dataclass(frozen=True)
class _Outputs:
    """The paths to which a training writes.

    Parameters
    ----------
    model : the model's file.
    """

    model: Path

    @property
    def numbers(self) -> Path:
        """The JSON file with the results and the history."""
        return self.model.with_suffix(".json")

    @property
    def curves(self) -> Path:
        """The picture of loss and accuracy against epochs."""
        return self.model.with_suffix(".curves.png")

    @property
    def run_folder(self) -> Path:
        """The folder with what is needed to resume."""
        return self.model.parent / "runs" / self.model.stem


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt train`. Returns the exit code 0."""
    with needs_extra("train", "training needs torch"):
        import torch  # noqa: F401
        from tnt_reference import Classifier  # noqa: F401

    outputs = _Outputs(args.out)
    _check_outputs(outputs)
    _check_options(args, outputs.run_folder)
    try:
        with locked_folder(outputs.run_folder, "command.lock"):
            _train(args, outputs)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted; what is finished is kept in {outputs.run_folder}. Give the same command "
            "again to resume."
        ) from None
    return 0


def _check_outputs(outputs: _Outputs) -> None:
    """Refuse to write over the files of another program."""
    from async_tnt.training.run_folder import CHECKPOINT, HISTORY, RUN_FILES

    run_folder = outputs.run_folder
    # one suffix only, because models q.pt and q.safetensors would share the run folder and q.json
    check_writable(outputs.model, (".safetensors",))
    check_ours(
        [outputs.numbers, outputs.curves, outputs.model], ('"held_out"', '"summary"', '"history"')
    )
    check_folder(run_folder, RUN_FILES)
    if run_folder.is_dir() and not (run_folder / CHECKPOINT).exists():
        check_ours([run_folder / HISTORY], ('"settings"', '"history"'))


def _check_options(args: argparse.Namespace, run_folder: Path) -> None:
    """Refuse options that do not go together, before anything is read."""
    from async_tnt.training.simulated_pictures import find_pictures

    if args.everywhere and args.motions != "recorded":
        raise ValueError(
            "--motions must come without --everywhere, which learns scenes from the beginning"
        )
    if args.motions == "resynthesized" and _sliding(args):
        raise ValueError(
            "--motions resynthesized is for windows with a start: give --window-us, and not "
            "--last-us or --last-events"
        )
    if args.everywhere and args.last_events is not None:
        raise ValueError(
            "--everywhere makes scenes of windows of a duration: give --last-us or --window-us, "
            "and not --last-events"
        )
    if args.motions == "resynthesized" and args.roi and not args.crop:
        raise ValueError(
            "--roi must come with --crop where motions are re-synthesized: objects leave the region"
        )
    if _has_tables(args):
        _check_options_of_tables(args)
    elif find_pictures(args.dataset):
        _check_options_of_pictures(args)
    elif args.camera or args.scales or args.size != SceneSettings.size:
        raise ValueError("--camera, --size and --scales are for pictures; DATASET holds none")
    if args.test and not has_test(args.dataset):
        raise FileNotFoundError(
            f"--test needs {args.dataset}/Test, or a list trials_to_test.txt; found neither"
        )
    class_roots = [
        args.dataset / class_root
        for class_root in ("Train", "Test")
        if (args.dataset / class_root).is_dir()
    ]
    if not class_roots:
        class_roots = [args.dataset]
    for class_root in class_roots:
        if run_folder.resolve().is_relative_to(class_root.resolve()):
            raise ValueError(
                f"--out must lie outside of {class_root}, in which a folder is a class; got "
                f"{args.out}"
            )


def _has_tables(args: argparse.Namespace) -> bool:
    """Whether DATASET holds recordings with tables of boxes."""
    from async_tnt.evaluation.object_tables import has_tables
    from async_tnt.training.table_windows import PART

    return has_tables(args.dataset, PART)


def _check_options_of_tables(args: argparse.Namespace) -> None:
    """Refuse options that recordings with tables of boxes do not allow."""
    if not args.everywhere:
        raise ValueError("DATASET holds tables of boxes: give --everywhere to learn from them")
    refused = {
        "--scales": args.scales,
        "--size": args.size != SceneSettings.size,
        "--camera": args.camera,
        "--roi": args.roi,
        "--mask": args.mask,
    }
    given = [option for option, value in refused.items() if value]
    if given:
        raise ValueError(
            f"{', '.join(given)} cannot be used with tables of boxes, which are of the whole "
            "sensor and have sizes"
        )
    if args.test:
        raise ValueError(
            "--test is for class folders: give recordings with tables to `async-tnt evaluate`"
        )


def _check_options_of_pictures(args: argparse.Namespace) -> None:
    """Refuse options that a data set with pictures does not allow."""
    from async_tnt.training.simulated_pictures import find_pictures

    if args.motions == "resynthesized":
        raise ValueError(
            "--motions resynthesized is for recordings: pictures are recorded in all motions anyway"
        )
    if args.mask or (args.roi and not args.crop):
        raise ValueError(
            "--mask, and --roi without --crop, are for recordings; DATASET holds pictures, too"
        )
    if args.scales and not args.everywhere:
        raise ValueError("--scales is for --everywhere, which makes scenes of objects")
    if args.scales and args.size != SceneSettings.size:
        raise ValueError("--size is for objects of one recording each: give --scales alone")
    test = args.dataset / "Test"
    if args.test and test.is_dir() and find_pictures(test):
        raise ValueError(
            "--test needs recordings of a camera in DATASET/Test; pictures there are not recorded"
        )


def _train(args: argparse.Namespace, outputs: _Outputs) -> None:
    """Read the data set, train, and write the model."""
    from async_tnt.training.fitting import fit

    data, settings = _read(args, outputs.run_folder)
    for line in data.left_out:
        note(f"left out: {line}")
    note(*data.notes)
    note(f"{len(data.training)} windows to train on, {len(data.validation)} held out")
    draw_pictures(args, data, outputs.run_folder / "pictures" / "pictures.png")
    n_epochs = settings.n_epochs(len(data.training))
    fitted = fit(
        data,
        settings,
        outputs.run_folder,
        motions=_other_motions(args, data, settings, outputs.run_folder),
        statistics=args.statistics,
        progress=progress,
        report=_reporter(n_epochs),
    ).with_record(command=_command(args))
    _note_early_end(len(fitted.history), n_epochs)
    _write(fitted, data, outputs, args)


def _command(args: argparse.Namespace) -> str:
    """The command as text, without paths. --mask is named, because it changes what is learned."""
    command = command_words("async-tnt train", args, add_arguments, leave_out=("json",))
    return command if args.mask is None else f"{command} --mask MASK"


# -- reading ---------------------------------------------------------------------------------------


def _read(args: argparse.Namespace, run_folder: Path) -> tuple[TrainingData, TrainSettings]:
    """Read the windows of DATASET, and the settings of the training.

    Two things are refused before any recording is read: options that do not fit each other, and a
    run folder of a training with another volume, network or seed.
    """
    from async_tnt.training.data import dataset_data
    from async_tnt.training.held_out import Split
    from async_tnt.training.plan import Plan
    from async_tnt.training.settings import duration_us
    from async_tnt.training.simulated_pictures import find_pictures
    from async_tnt.training.volume_choice import VolumeChoice
    from async_tnt.training.work import Work

    pixels = _pixels(args)
    volume = VolumeChoice.of(
        grid=args.grid,
        window_us=args.window_us,
        in_bins=args.motions == "resynthesized",
        **_sliding(args),
        **volume_of(args.volume),
    )
    _check_volume(args, volume.config.transform)
    has_tables = _has_tables(args)
    plan = Plan(
        volume,
        network=args.network,
        epochs=args.epochs,
        seed=args.seed,
        everywhere=args.everywhere,
        mirror=args.mirror,
        has_pictures=not has_tables and bool(find_pictures(args.dataset)),
        scales=args.scales,
        has_tables=has_tables,
    )
    plan.check()
    split = Split(args.validation, args.groups, args.test, args.seed)
    camera = _measured_camera(args, duration_us(volume.config))
    # with --crop, the sensor of --sensor is the camera's, and not that of the events
    plan.check_run(run_folder, None if pixels.crop else pixels.sensor)
    data = dataset_data(
        args.dataset,
        volume,
        pixels=pixels,
        reading=ReadOptions(**reading_of(args)),
        split=split,
        scenes={"size": args.size, "camera": camera},
        scales=args.scales,
        work=Work(run_folder, available_cores(), progress),
    )
    return data, plan.settings_for(data)


def _pixels(args: argparse.Namespace) -> Pixels:
    """The pixels that are learned from."""
    pixels = pixels_of(args)
    if pixels.region is not None and min(pixels.region) < 2:
        raise ValueError(
            "--roi with --crop: the region is the model's sensor and must have sides of at least 2 "
            f"pixels, got {format_size(pixels.region)}"
        )
    return pixels


def _sliding(args: argparse.Namespace) -> dict[str, int]:
    """The length of a window that slides, as a field of `TNTConfig`; empty for another window."""
    lengths = {"last_us": args.last_us, "last_events": args.last_events}
    return {name: length for name, length in lengths.items() if length is not None}


def _check_volume(args: argparse.Namespace, transform: str) -> None:
    """Refuse fields of --volume that a volume without the transform does not use."""
    if transform == "none" and not {"landmark", "t_max"}.isdisjoint(volume_of(args.volume)):
        raise ValueError("--volume: landmark and t_max need transform=tnt")


def _measured_camera(args: argparse.Namespace, window_us: int) -> MeasuredPixels | None:
    """Measure a camera's pixels in the recording of --camera; None without this option."""
    from async_tnt.training.simulated_pictures import measure_camera

    if args.camera is None:
        return None
    if args.sensor is None:
        raise ValueError("--camera needs --sensor WxH, the camera's pixels")
    camera = measure_camera(args.camera, window_us, args.sensor, **reading_of(args))
    note(
        f"{args.camera.name}: thresholds of ON to OFF {camera.step_on / camera.step_off:.2f}, "
        f"after-pulses {camera.after_share:.0%}, noise {camera.noise_hz:.2g} events a pixel and "
        f"second, refractory time up to {camera.refractory_us:.0f} us (0 of these two: not known)"
    )
    return camera


# -- other motions ---------------------------------------------------------------------------------


def _other_motions(
    args: argparse.Namespace, data: TrainingData, settings: TrainSettings, run_folder: Path
) -> Motions | None:
    """The windows under other motions. They are made in the run folder, or read from there.

    None with `--motions recorded`.
    """
    from async_tnt.training.moved_windows import MotionSettings
    from async_tnt.training.resynthesis import resynthesize
    from async_tnt.training.run_folder import identity_of, load_checkpoint

    if args.motions == "recorded":
        return None
    n_epochs = settings.n_epochs(len(data.training))
    motion_settings = MotionSettings(seed=args.seed).for_epochs(n_epochs)
    # refuses a run folder of another training, before the long work
    load_checkpoint(run_folder, identity_of(data, settings, motions=motion_settings))
    motions = resynthesize(
        data.training,
        data.validation,
        data.config,
        motion_settings,
        run_folder / "motions",
        masked=data.masked,
        workers=available_cores(),
        progress=progress,
    )
    _note_motions(motions.record)
    draw_motions(motions, data, run_folder / "motions" / "motions.png")
    return motions


def _note_motions(record: dict[str, Any]) -> None:
    """Print in how many windows a motion was found, and how well simulation matches recordings."""
    from async_tnt.resynthesis.calibration import differing_numbers, side_by_side

    summary = f"motion found in {record['with_path']} of {record['windows']} windows"
    if record["with_neighbours"]:
        summary += f", in {record['with_neighbours']} of them only with the neighbouring windows"
    summary += "; the other windows are used only as recorded"
    if record["without_path"]:
        reasons = [f"{reason} {n}" for reason, n in record["without_path"].items()]
        summary += f" ({', '.join(reasons)})"
    note(
        summary,
        "recorded windows, and the same motion simulated again:",
        *side_by_side(record["match"]).splitlines(),
    )
    if record["with_path"] < FEW_PATHS * record["windows"]:
        note(
            "warning: so few motions hardly change what is learned. Re-synthesis needs windows in "
            "which one object moves as a whole by two pixels and more, with a few hundred events: "
            "try another --window-us, or --roi with --crop"
        )
    names = differing_numbers(record["match"])
    if names:
        note(
            f"warning: recorded and simulated windows differ in {', '.join(names)}. Compare "
            "them in motions.png, and compare the accuracy on what is held out with that of "
            "--motions recorded"
        )


# -- training and writing --------------------------------------------------------------------------


def _reporter(n_epochs: int) -> Callable[[dict[str, float]], None]:
    """A function that prints a line about an epoch, but at most one line a second.

    A training may have hundreds of short epochs. The first and the last epoch always have a line.
    """
    printed_s: float | None = None

    def report(row: dict[str, float]) -> None:
        nonlocal printed_s
        now_s = time.monotonic()
        is_last = row["epoch"] >= n_epochs
        is_too_soon = printed_s is not None and printed_s > now_s - 1.0
        if is_too_soon and not is_last:
            return
        printed_s = now_s
        text = f"epoch {row['epoch']:.0f}/{n_epochs}  loss {row['loss']:.4f}"
        if "f1" in row:
            text += f"  held out: F1 {row['f1']:.4f}"
        if "per_window" in row:
            text += f"  held out: {row['per_window']:.4f} by window"
            text += f", {row['per_recording']:.4f} by recording"
        if "motions_per_window" in row:
            text += f"; in other motions {row['motions_per_window']:.4f} by window"
        note(text)

    return report


def _note_early_end(n_done: int, n_epochs: int) -> None:
    """If a training ended before its last epoch, print why."""
    from async_tnt.training.early_end import COOLING, PATIENCE

    if n_done < n_epochs:
        note(
            f"ended after {n_done} of {n_epochs} epochs: all that is held out was right in the "
            f"last {PATIENCE + COOLING}, and its loss fell no more; --epochs N always makes N"
        )


def _write(fitted: Fitted, data: TrainingData, outputs: _Outputs, args: argparse.Namespace) -> None:
    """Write the model and its other files, test it with --test, and print the results."""
    from async_tnt.training.run_folder import plot_curves

    # written before the test, which may take long, and once more with the accuracy of the test
    paths = _save(fitted, data, outputs)
    if plot_curves(fitted.history, outputs.curves):
        paths.append(outputs.curves)
    else:
        note("no picture of curves: matplotlib is not installed (pip install 'async_tnt[plot]')")
    if data.tests:
        note("evaluating on Test")
        fitted = fitted.tested(data)
        _save(fitted, data, outputs)
    for line in data.left_out:  # printed once more, because the first time may be hours ago
        note(f"left out: {line}")
    print_summary(fitted, args.out, paths, as_json=args.json)


def _save(fitted: Fitted, data: TrainingData, outputs: _Outputs) -> list[Path]:
    """Write the model with its record so far, and the numbers beside it. Returns both paths."""
    numbers = {
        **(fitted.scores or {}),
        "held_out": list(data.held_out),
        "summary": fitted.model.record,
        "history": fitted.history,
    }
    # written first, because `_check_outputs` knows by this file that the model is ours
    write_text(outputs.numbers, json.dumps(numbers, indent=1))
    return [fitted.model.save(outputs.model), outputs.numbers]
