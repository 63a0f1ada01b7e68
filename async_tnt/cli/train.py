"""`async-tnt train`: train a classifier on folders of recordings, one folder for each class."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from async_tnt.base.checks import needs_extra
from async_tnt.base.files import check_folder, check_ours, check_writable, locked_folder, write_text
from async_tnt.base.package import available_cores
from async_tnt.base.progress import progress
from async_tnt.cli.options import command_words, model_of, of_windows, reading_of, volume_of
from async_tnt.cli.output import note, say
from async_tnt.cli.pixel_options import pixels_of
from async_tnt.cli.train_figures import draw_motions, draw_pictures
from async_tnt.cli.train_options import DESCRIPTION, add_arguments
from async_tnt.networks.models.model import Model
from async_tnt.simulation.picture_scene import SceneSettings
from async_tnt.sources.files.labelled_recordings import has_test
from async_tnt.sources.files.source import ReadOptions
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.sensor import format_size

if TYPE_CHECKING:
    from async_tnt.training.data import TrainingData
    from async_tnt.training.moved_windows import Motions
    from async_tnt.training.settings import TrainSettings

__all__ = ["DESCRIPTION", "add_arguments", "main"]

NUMBERS, CURVES = ".json", ".curves.png"
"""What is written beside the model."""
FEW_PATHS = 0.2
"""Share of windows whose motion is found, below which there is a warning."""
FEW = 20
"""Held-out recordings of a class below which its windows are reported, too."""
TITLES = {
    "validation": "held out",
    "validation_motions": "held out, in other motions",
    "test": "Test",
}


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt train`. Returns the exit code 0."""
    with needs_extra("train", "training needs torch"):
        import torch  # noqa: F401
        from tnt_reference import Classifier  # noqa: F401
    from async_tnt.training.run_folder import CHECKPOINT, RUN_FILES

    run_folder = args.out.parent / "runs" / args.out.stem
    # q.pt and q.safetensors would share a run folder and q.json
    check_writable(args.out, (".safetensors",))
    beside = [args.out.with_suffix(suffix) for suffix in (NUMBERS, CURVES)]
    check_ours([*beside, args.out], ('"held_out"', '"summary"', '"history"'))
    check_folder(run_folder, RUN_FILES)
    if run_folder.is_dir() and not (run_folder / CHECKPOINT).exists():
        check_ours([run_folder / name for name in RUN_FILES[1:]], ('"settings"', '"history"'))
    _check_options(args, run_folder)
    restart = args.restart
    try:
        with locked_folder(run_folder, "command.lock"):
            return _train(args, run_folder)
    except KeyboardInterrupt:
        if args.restart:
            raise KeyboardInterrupt(
                f"interrupted before anything learned in {run_folder} was discarded"
            ) from None
        again = f"again{', without --restart,' * restart} to resume"
        kept = f"what is finished is kept in {run_folder}. Give the same command {again}."
        raise KeyboardInterrupt(f"interrupted; {kept}") from None


def _check_options(args: argparse.Namespace, run_folder: Path) -> None:
    """Refuse options that do not go together, before anything is read."""
    from async_tnt.training.simulated_pictures import find_pictures

    if args.everywhere and (args.teacher or args.motions != "recorded"):
        name = "--teacher" if args.teacher else "--motions"
        raise ValueError(
            f"{name} must come without --everywhere, which learns scenes from the beginning"
        )
    if args.motions == "resynthesized" and args.roi and not args.crop:
        raise ValueError(
            "--roi must come with --crop where motions are re-synthesized: objects leave the region"
        )
    if find_pictures(args.dataset):
        if args.motions == "resynthesized":
            raise ValueError(
                "--motions resynthesized is for recordings: pictures are recorded in all motions "
                "anyway"
            )
        if args.mask or (args.roi and not args.crop):
            raise ValueError(
                "--mask, and --roi without --crop, are for recordings; DATASET holds pictures, too"
            )
        if args.test and (args.dataset / "Test").is_dir() and find_pictures(args.dataset / "Test"):
            raise ValueError(
                "--test needs recordings of a camera in DATASET/Test; pictures there are not "
                "recorded"
            )
    elif args.camera or args.follow or args.light != "both" or args.size != SceneSettings.size:
        raise ValueError(
            "--camera, --follow, --light and --size are for pictures; DATASET holds none"
        )
    if args.test and not has_test(args.dataset):
        raise FileNotFoundError(
            f"--test needs {args.dataset}/Test, or a list trials_to_test.txt; found neither"
        )
    parts = [
        args.dataset / part for part in ("Train", "Test") if (args.dataset / part).is_dir()
    ] or [args.dataset]
    if any(run_folder.resolve().is_relative_to(part.resolve()) for part in parts):
        raise ValueError(
            f"--out must lie outside of {parts[0]}, in which a folder is a class; got {args.out}"
        )


def _train(args: argparse.Namespace, run_folder: Path) -> int:
    from async_tnt.training.early_end import COOLING, PATIENCE
    from async_tnt.training.fitting import fit
    from async_tnt.training.run_folder import begin_again, plot_curves

    teachers = [of_windows(model_of(name), name) for name in args.teacher]
    data, settings = _read(args, teachers, run_folder)
    if args.restart:  # not before everything has been read and tried
        begin_again(run_folder)
        args.restart = False
    for line in (*(f"left out: {line}" for line in data.left_out), *data.notes):
        note(line)
    note(f"{len(data.training)} windows to train on, {len(data.validation)} held out")
    draw_pictures(args, data, run_folder / "pictures" / "pictures.png")
    # as given, without paths; but --mask is kept, as it decides what is learned
    command = command_words("async-tnt train", args, add_arguments, leave_out=("json", "restart"))
    fitted = fit(
        data,
        settings,
        run_folder,
        motions=_other_motions(args, data, settings, teachers, run_folder),
        teachers=teachers,
        record={"command": command if args.mask is None else f"{command} --mask MASK"},
        progress=progress,
        report=_reporter(settings.n_epochs(len(data.training))),
    )

    n_epochs, n_done = settings.n_epochs(len(data.training)), len(fitted.history)
    if n_done < n_epochs:
        note(
            f"ended after {n_done} of {n_epochs} epochs: all that is held out was right in the "
            "last "
            f"{PATIENCE + COOLING}, and its loss fell no more; --epochs N makes N"
        )

    def save() -> list[Path]:
        """The model with its record so far, and the numbers beside it."""
        about = {
            "held_out": list(data.held_out),
            "summary": fitted.model.record,
            "history": fitted.history,
        }
        numbers = args.out.with_suffix(NUMBERS)
        # first: it tells whose the model is
        write_text(numbers, json.dumps((fitted.scores or {}) | about, indent=1))
        return [fitted.model.save(args.out), numbers]

    written = save()  # before Test, which may take long; once more with its accuracy
    if plot_curves(fitted.history, args.out.with_suffix(CURVES)):
        written.append(args.out.with_suffix(CURVES))
    else:
        note("no picture of curves: matplotlib is not installed (pip install 'async_tnt[plot]')")
    if data.tests:
        note("evaluating on Test")
        fitted = fitted.tested(data)
        save()
    for line in data.left_out:  # once more: the first time may be hours ago
        note(f"left out: {line}")
    _print_summary(fitted.model.record, fitted.scores or {}, args, written)
    return 0


def _read(
    args: argparse.Namespace, teachers: list[Model], run_folder: Path
) -> tuple[TrainingData, TrainSettings]:
    """The windows of DATASET, and how to train on them.

    What the options rule out, and a run with another volume, network or seed, is refused before any
    recording is read.
    """
    from async_tnt.training.batches import BatchVolumes
    from async_tnt.training.data import dataset_data
    from async_tnt.training.groups import groups_by_pattern
    from async_tnt.training.networks import find_network
    from async_tnt.training.pipeline import check_network
    from async_tnt.training.run_folder import discard_made, load_checkpoint
    from async_tnt.training.scenes import SceneMaker
    from async_tnt.training.settings import OF_PICTURES, default_config, settings_for, with_bins
    from async_tnt.training.simulated_pictures import find_pictures, measure_camera

    pixels = pixels_of(args)
    if pixels.region is not None and min(pixels.region) < 2:
        raise ValueError(
            "--roi with --crop: the region is the model's sensor and must have sides of at least 2 "
            "pixels, "
            f"got {format_size(pixels.region)}"
        )
    given = {
        name: getattr(args, name)
        for name in ("grid", "window_us")
        if getattr(args, name) is not None
    }
    named = volume_of(args.volume)
    config = default_config(**given, **named)
    if config.transform == "none" and not {"landmark", "t_max"}.isdisjoint(named):
        raise ValueError("--volume: landmark and t_max need transform=tnt")
    in_bins = args.motions == "resynthesized" and not args.volume
    config = with_bins(config) if in_bins else config
    BatchVolumes(config)
    augmentation = {"mirror": args.mirror, **(OF_PICTURES if find_pictures(args.dataset) else {})}
    wanted = {"seed": args.seed, "everywhere": args.everywhere, "augmentation": augmentation}
    wanted |= {
        name: getattr(args, name)
        for name in ("epochs", "network")
        if getattr(args, name) is not None
    }
    settings = settings_for(config, 1, **wanted)

    def seen(config: TNTConfig) -> TNTConfig:
        return SceneMaker(config).config if args.everywhere else config

    if ":" in settings.network:  # it may suit the data alone
        find_network(settings.network)
    else:
        check_network(settings.network, seen(config), everywhere=args.everywhere)
    groups_by_pattern((), args.groups or "")
    kinds = {(teacher.config.sensor, teacher.classes) for teacher in teachers}
    sensor = pixels.region or pixels.sensor
    if len(kinds) > 1 or (kinds and sensor not in (None, teachers[0].config.sensor)):
        raise ValueError(
            "--teacher: all must have the same classes, in the same order, and this training's "
            "sensor"
        )
    camera = None
    if args.camera is not None:
        if pixels.sensor is None:
            raise ValueError("--camera needs --sensor WxH, the camera's pixels")
        camera = measure_camera(args.camera, config.window_us, pixels.sensor, **reading_of(args))
        note(
            f"{args.camera.name}: thresholds of ON to OFF {camera.step_on / camera.step_off:.2f}, "
            "after-pulses "
            f"{camera.after_share:.0%}, noise {camera.noise_hz:.2g} events a pixel and second, "
            "refractory time up to "
            f"{camera.refractory_us:.0f} us (0 of these two: not known)"
        )
    fitted = {"grid", "window_us"} - given.keys()
    fitted |= set() if args.volume or in_bins else {"bins"}
    later = {"sensor", *fitted} | ({"representation"} if "bins" in fitted else set())
    volume = {name: value for name, value in config.to_dict().items() if name not in later}
    if pixels.sensor is not None and not pixels.crop:
        volume["sensor"] = pixels.sensor
    if not args.restart:
        load_checkpoint(run_folder, {**volume, "seed": settings.seed, "network": settings.network})
    data = dataset_data(
        args.dataset,
        config,
        pixels=pixels,
        reading=ReadOptions(**reading_of(args)),
        sensor_source="`sensor`" if args.sensor else "--mask",
        classes=teachers[0].classes if teachers else None,
        validation=args.validation,
        groups=args.groups,
        fitted=fitted,
        test=args.test,
        seed=args.seed,
        store=run_folder,
        begin=partial(discard_made, run_folder, "pictures") if args.restart else lambda: None,
        scenes={"size": args.size, "light": args.light, "follow": args.follow, "camera": camera},
        workers=available_cores(),
        progress=progress,
    )
    check_network(
        settings.network, seen(data.config), len(data.classes), everywhere=args.everywhere
    )
    return data, settings_for(data.config, len(data.training), **wanted)


def _other_motions(
    args: argparse.Namespace,
    data: TrainingData,
    settings: TrainSettings,
    teachers: list[Model],
    run_folder: Path,
) -> Motions | None:
    """The windows under other motions, made in the run folder or found there; None with --motions
    recorded."""
    from async_tnt.resynthesis.calibration import side_by_side, unlike
    from async_tnt.training.moved_windows import MotionSettings
    from async_tnt.training.resynthesis import resynthesize
    from async_tnt.training.run_folder import identity_of, load_checkpoint

    if args.motions == "recorded":
        return None
    motion_settings = MotionSettings(seed=args.seed).for_epochs(
        settings.n_epochs(len(data.training))
    )
    # refuses another run before the work
    windows = data.training, data.validation
    identity = identity_of(
        data.config, settings, *windows, None, data.classes, motion_settings, teachers
    )
    load_checkpoint(run_folder, identity)
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
    record = motions.record
    without = ", ".join(f"{reason} {n}" for reason, n in record["without_path"].items())
    note(
        f"motion found in {record['with_path']} of {record['windows']} windows"
        + (
            f", in {record['with_neighbours']} only with those beside them"
            if record["with_neighbours"]
            else ""
        )
        + "; the others are used as recorded only"
        + (f" ({without})" if without else ""),
        "recorded windows, and the same motion simulated again:",
        *side_by_side(record["match"]).splitlines(),
    )
    if record["with_path"] < FEW_PATHS * record["windows"]:
        note(
            "warning: so few motions hardly change what is learned. Re-synthesis needs windows in "
            "which one object "
            "moves as a whole by two pixels and more, with a few hundred events: try another "
            "--window-us, or --roi "
            "with --crop"
        )
    if names := unlike(record["match"]):
        note(
            f"warning: recorded and simulated windows differ in {', '.join(names)}: compare "
            "motions.png, and held out"
        )
    draw_motions(motions, data, run_folder / "motions" / "motions.png")
    return motions


def _reporter(n_epochs: int) -> Callable[[dict[str, float]], None]:
    """Prints a line after an epoch, at most one a second: hundreds of short epochs need no line
    each."""
    printed_at = -1.0

    def report(row: dict[str, float]) -> None:
        nonlocal printed_at
        if row["epoch"] < n_epochs and 0 <= printed_at > time.monotonic() - 1.0:
            return
        printed_at = time.monotonic()
        text = f"epoch {row['epoch']:.0f}/{n_epochs}  loss {row['loss']:.4f}"
        if "f1" in row:
            text += f"  held out: F1 {row['f1']:.4f}"
        if "per_window" in row:
            text += f"  held out: {row['per_window']:.4f} by window, {row['per_recording']:.4f} by recording"
        if "motions_per_window" in row:
            text += f"; in other motions {row['motions_per_window']:.4f} by window"
        note(text)

    return report


def _print_summary(
    summary: Mapping[str, Any],
    numbers: Mapping[str, Any],
    args: argparse.Namespace,
    written: list[Path],
) -> None:
    if args.json:
        say(json.dumps({"out": str(args.out), **summary}))
        return
    for name, title in TITLES.items():
        if name in summary:
            found = summary[name]
            if "f1" in found:
                early = ", ".join(
                    f"{f1:.4f} after {ms} ms" for ms, f1 in found["f1_against_time_ms"].items()
                )
                say(
                    f"{title}: F1 {found['f1']:.4f} of {found['objects']} objects in scenes "
                    f"({early})"
                )
                continue
            by_recording = ""
            if "recordings" in found:
                by_recording = f", {found['per_recording']:.4f} of {found['recordings']} recordings"
            if name == "validation" and (pictures := summary["data"].get("pictures")):
                by_recording += f" (simulated ones: of {pictures['held_out']} pictures)"
            say(
                f"{title}: {found['per_window']:.4f} of {found['windows']} windows{by_recording} "
                "right"
            )
    network = (
        f"{summary['network']}, {summary['multiplications']:,} multiplications a complete window"
    )
    say(f"network {network}; temperature {summary.get('temperature', 1):.3f}")
    if numbers and max(map(sum, numbers["confusion"])) < FEW:
        for k, name in enumerate(numbers["classes"]):
            windows, n_recordings = numbers["window_confusion"][k], sum(numbers["confusion"][k])
            say(
                f"  {name}: {windows[k]} of {sum(windows)} windows of {n_recordings} held-out "
                "recordings right"
            )
    if "held_out_in_time" in summary["data"]:
        say(
            "held out in time: of the sessions that were learned from; only another session tells "
            "how well it works"
        )
    say(f"wrote {', '.join(map(str, written))}")
