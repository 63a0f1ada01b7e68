"""One network for objects of many sizes, trained on drawn pictures, and scored in made scenes.

    python -m experiments.object_scales --out FOLDER [--seeds N] [--epochs N] [--network NAME]
                                        [--json FILE]
    python -m experiments.object_scales --out FOLDER --final [--json FILE]

A network learns from pictures alone: from PNG files of eight kinds of drawn objects, 40 of each,
and 80 of other things, which are a class that is not scored (`pictures/drawn.py`). The same is
done by

    async-tnt train pictures --everywhere --sensor 240x180 --scales 0.083-0.333 --window-us 50000
        --volume representation=volume,bins=5,polarity=split,transform=none

It is scored in scenes of objects of these kinds (`objects/scenes.py`), which share no code with
the training: neither with its simulation nor with the drawing of its pictures. There are scenes on
the sensor of the training and, for `Model.for_sensor`, on 640x480 pixels. The scores are COCO's
mean average precision after 10, 30, 50 and 100 ms, and F1: an object is found if the middle of a
box of its class lies in the ellipse that touches the sides of its box.

The first command trains, and scores scenes of the tuning seed: at some epochs for the learning
curve, and at the end. The second one scores the final set once. What is finished is kept in
FOLDER; give the same command again to resume. `--network map` trains a network that says no middles
of boxes, in another FOLDER.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from async_tnt import Model, Processor, load_model
from async_tnt.base.files import write_text
from async_tnt.base.progress import progress
from async_tnt.evaluation.box_scores import FoundBoxes
from async_tnt.evaluation.object_scores import ObjectScores, score_objects
from async_tnt.evaluation.object_tables import ObjectTable
from async_tnt.kernels.decisions.objects import FOUND_SIZE
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training import VolumeChoice, Work, dataset_data, fit
from async_tnt.training.plan import Plan
from async_tnt.training.settings import TrainSettings
from async_tnt.training.training_data import TrainingData
from async_tnt.volume.sensor import format_size
from experiments.objects.kinds import KINDS
from experiments.objects.mistakes import Mistakes
from experiments.objects.scenes import FINAL_SEED, SENSORS, TUNING_SEED, made_scene
from experiments.pictures.drawn import OTHER, write_drawn
from experiments.scripts.options import add_count, exit_with, script_parser, write_outputs
from experiments.speed.timing import machine

LEARNED_US = 50_000
"""Length of the model's windows, in microseconds. A scene has two of them."""

SCALES = (0.083, 0.333)
"""Least and largest longer side of the objects, as shares of the sensor's shorter side."""

N_PICTURES = 40
"""Pictures of each kind."""

EPOCHS = 24
"""Epochs of a training."""

TIMES_MS = (10, 30, 50, 100)
"""Times after a scene's start at which it is scored."""

N_TUNING = (60, 30)
"""Scenes of the tuning seed on each of `SENSORS`."""

N_FINAL = (200, 100)
"""Scenes of the final set on each of `SENSORS`."""

N_CURVE = 30
"""Scenes of the tuning seed, on the first sensor, in which a model is scored between epochs."""

CURVE_STEP = 2
"""A model is scored after each such number of epochs."""


class Scenes(NamedTuple):
    """Made scenes that are kept in files."""

    seed: int
    sensor: tuple[int, int]
    n: int
    folder: Path

    def __iter__(self) -> Iterator[tuple[list[np.ndarray], list[str], np.ndarray]]:  # type: ignore[override]
        """Events, labels, and boxes (T, N, 4) at `TIMES_MS` of each scene."""
        for number in range(self.n):
            name = f"{self.seed}-{format_size(self.sensor)}-{number:03}.npz"
            path = self.folder / name
            if not path.exists():
                self.folder.mkdir(parents=True, exist_ok=True)
                scene = made_scene(self.seed, self.sensor, number)
                boxes = np.stack([scene.boxes(1e3 * ms) for ms in TIMES_MS])
                part = path.with_suffix(".part.npz")
                arrays: dict[str, Any] = {"labels": scene.labels, "boxes": boxes, **scene.columns}
                np.savez(part, **arrays)
                part.replace(path)
            with np.load(path) as file:
                columns = [file[name] for name in "txyp"]
                yield columns, [str(label) for label in file["labels"]], file["boxes"]


def score(model: Model, scenes: Scenes, tick: Callable[[], None]) -> dict[str, Any]:
    """Time in ms -> the scores of a model in scenes at that time; and what it mistakes at the end.

    tick : called after each scene.
    """
    fitting = model.for_sensor(scenes.sensor)
    processor = Processor(fitting, start_us=0)
    n_classes = len(model.classes)
    boxes = {ms: FoundBoxes() for ms in TIMES_MS}
    counts = {ms: ObjectScores(*np.zeros((3, n_classes), np.int64)) for ms in TIMES_MS}
    mistakes = Mistakes()
    for columns, labels, true_boxes in scenes:
        processor.reset()
        first = 0
        for ms, present in zip(TIMES_MS, true_boxes, strict=True):
            end = int(np.searchsorted(columns[0], 1000 * ms))
            processor.push(tuple(column[first:end] for column in columns))
            first = end
            table = _table(present, [model.classes.index(label) for label in labels], ms)
            objects = [one for one in processor.fire().objects or () if one.label != OTHER]
            found = _rows(objects)
            boxes[ms].add(table, slice(None), found)
            counts[ms] += score_objects(found, table.label, table.middle, table.reach, n_classes)
        found_boxes = np.array([one.box for one in objects]).reshape(-1, 4)
        found_kinds = [one.label for one in objects]
        mistakes.add(true_boxes[-1], labels, found_boxes, found_kinds, min(scenes.sensor))
        tick()
    scores: dict[str, Any] = {"mistakes": mistakes.to_dict()}
    for ms in TIMES_MS:
        scores[str(ms)] = {"f1": round(counts[ms].f1, 5), **boxes[ms].scores(model.classes)}
        if ms == TIMES_MS[-1]:
            per_class = counts[ms].to_dict(model.classes)["per_class"]
            scores["f1_of_kinds"] = {name: per_class[name]["f1"] for name in KINDS}
    return scores


def _rows(objects: Any) -> np.ndarray:
    """The objects of a decision as rows of `FOUND_SIZE` numbers."""
    rows = [
        (one.x, one.y, one.probability, one.index, one.id, one.width, one.height) for one in objects
    ]
    return np.array(rows, np.float64).reshape(-1, FOUND_SIZE)


def _table(boxes: np.ndarray, labels: list[int], ms: int) -> ObjectTable:
    """The table of the objects of a scene at a time. Boxes are x0, y0, x1, y1."""
    size = boxes[:, 2:] - boxes[:, :2]
    return ObjectTable(
        t=np.full(len(boxes), 1000 * ms),
        label=np.array(labels, np.int64),
        middle=(boxes[:, :2] + boxes[:, 2:]) / 2,
        reach=size / 2,
        size=size,
        unknown={},
    )


class Training(NamedTuple):
    """How the networks are trained.

    Parameters
    ----------
    epochs : number of epochs.
    n_pictures : number of pictures of each kind.
    n_scenes : number of scenes in which a network is scored between epochs.
    network : one of those of `async-tnt train`; None: its default.
    """

    epochs: int = EPOCHS
    n_pictures: int = N_PICTURES
    n_scenes: int = N_CURVE
    network: str | None = None


def read_data(folder: Path, seed: int, how: Training) -> tuple[TrainingData, TrainSettings]:
    """The data and the settings of a training, as the command in the head of this file has them."""
    pictures = folder / "pictures"
    if not pictures.is_dir():
        write_drawn(pictures, how.n_pictures)
    (folder / "recordings").mkdir(exist_ok=True)
    volume = VolumeChoice.of(
        window_us=LEARNED_US, representation="volume", bins=5, polarity="split", transform="none"
    )
    plan = Plan(
        volume,
        epochs=how.epochs,
        seed=seed,
        network=how.network,
        everywhere=True,
        has_pictures=True,
        scales=SCALES,
    )
    data = dataset_data(
        pictures,
        volume,
        pixels=Pixels(sensor=SENSORS[0]),
        scales=SCALES,
        work=Work(folder / "recordings", 1, progress),
    )
    return data, plan.settings_for(data)


def model_so_far(run_folder: Path, data: TrainingData, settings: TrainSettings) -> Model:
    """The model that the checkpoint of a training holds."""
    import torch

    from async_tnt.training.pipeline import export, new_pipeline
    from async_tnt.training.run_folder import CHECKPOINT

    assert data.scenes is not None
    pipeline = new_pipeline(
        data.config,
        len(data.classes),
        settings.seed,
        data.training,
        settings.network,
        logarithm=settings.logarithm,
        grid=data.scenes.grid,
    )
    state = torch.load(run_folder / CHECKPOINT, weights_only=True, map_location="cpu")
    averaged = {}
    for name, tensor in state["averaged"].items():
        if name.startswith("module."):
            averaged[name.removeprefix("module.")] = tensor
    pipeline.load_state_dict(averaged)
    model = export(pipeline.eval(), data.classes, data.scenes)
    return replace(model, by_share=True)


def train(folder: Path, seed: int, how: Training) -> Path:
    """Train a model, and score it on the way. Returns its file, beside that of its curve.

    The curve, a list of rows, is in a file of the same name with the suffix .json.
    """
    path = folder / f"model{seed}.safetensors"
    curve_path = path.with_suffix(".json")
    if path.exists():
        return path
    data, settings = read_data(folder, seed, how)
    run_folder = folder / f"run{seed}"
    rows = json.loads(curve_path.read_text()) if curve_path.exists() else []
    scenes = Scenes(TUNING_SEED, SENSORS[0], how.n_scenes, folder / "scenes")

    def report(row: dict[str, float]) -> None:
        epoch = int(row["epoch"])
        if epoch % CURVE_STEP and epoch != how.epochs:
            return
        model = model_so_far(run_folder, data, settings)
        scores = score(model, scenes, lambda: None)
        last = scores[str(TIMES_MS[-1])]
        rows.append(
            {
                "epoch": epoch,
                "windows": epoch * len(data.training),
                "loss": row["loss"],
                "held_out_f1": row["f1"],
                "map": last["map"],
                "map_50": last["map_50"],
            }
        )
        write_text(curve_path, json.dumps(rows, indent=1))
        print(rows[-1], flush=True)

    fitted = fit(data, settings, run_folder, progress=progress, report=report)
    fitted.model.save(path)
    return path


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """The report: what the models of all seeds score, and their learning curves."""
    seed_of_scenes = FINAL_SEED if args.final else TUNING_SEED
    numbers = N_FINAL if args.final else N_TUNING
    how = Training(args.epochs, network=args.network)
    if args.quick:
        numbers = (2, 1)
        how = Training(1, 2, 1, args.network)
    rows = []
    for seed in range(1 if args.quick else args.seeds):
        path = args.out / f"model{seed}.safetensors"
        if args.final and not path.exists():
            raise FileNotFoundError(f"{path} is missing: train first, without --final")
        path = train(args.out, seed, how)
        model = load_model(path)
        row: dict[str, Any] = {"seed": seed, "scores": {}}
        with progress(sum(numbers), "scenes") as bar:
            for sensor, n in zip(SENSORS, numbers, strict=True):
                scenes = Scenes(seed_of_scenes, sensor, n, args.out / "scenes")
                row["scores"][format_size(sensor)] = score(model, scenes, bar.update)
        row["curve"] = json.loads(path.with_suffix(".json").read_text())
        rows.append(row)
        print(row)
    return {
        "scenes": dict(zip(map(format_size, SENSORS), numbers, strict=True)),
        "scenes_seed": seed_of_scenes,
        "pictures": how.n_pictures * (len(KINDS) + 2),  # twice as many of other things
        "recorded_events": 0,
        "epochs": how.epochs,
        "multiplications": model.multiplications,
        "models": rows,
        "machine": machine("torch"),
    }


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print it, and write the files that are asked for."""
    parser = script_parser("object_scales", __doc__, "one short training, three scenes")
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", required=True, help="pictures, models and scenes"
    )
    parser.add_argument("--final", action="store_true", help="score the final set")
    add_count(parser, "--seeds", 1, "networks")
    add_count(parser, "--epochs", EPOCHS, "of a training")
    parser.add_argument("--network", metavar="NAME", help="of `async-tnt train`, not the default")
    args = parser.parse_args(argv)
    write_outputs(args, measure(args))
    return 0


if __name__ == "__main__":
    exit_with(main)
