"""How the bundled model `digits` was trained, step by step.

    python -m experiments.digits [--nmnist FOLDER] [--mnist FOLDER] [--out FOLDER]

There are five trainings. Each continues the training before. The networks see N-MNIST's recordings,
simulated recordings, and both under other motions. The last two trainings also show windows without
a digit.

Finished trainings in --out are kept, and interrupted trainings resume. The command takes an hour
for the motions and another hour for the trainings. It writes OUT/digits.safetensors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import torch

from async_tnt import Model, TNTConfig
from async_tnt.base.package import available_cores
from async_tnt.base.progress import progress
from async_tnt.training.augment import Augmentation
from async_tnt.training.evaluation import evaluate
from async_tnt.training.fitting import Fitted, fit, moments_ms
from async_tnt.training.moved_windows import MotionSettings
from async_tnt.training.pipeline import pipeline_of
from async_tnt.training.resynthesis import resynthesize
from async_tnt.training.settings import TrainSettings
from async_tnt.training.temperature import calibrated
from async_tnt.training.training_data import TrainingData
from experiments.digit_data.recordings import digits_data
from experiments.scripts.options import add_folder, data_folder, exit_with, plain_parser

CONFIG = TNTConfig(t_max=4.0)
"""Settings of the volumes that `digits` sees."""

SIMULATED = 20_000
"""Number of simulated recordings to train on."""


@dataclass(frozen=True)
class Step:
    """The settings of one of the five trainings.

    Parameters
    ----------
    epochs : passes over the windows.
    rate : the highest learning rate.
    recorded : share of the windows that an epoch shows as they were recorded.
    variations : number of other motions that are made of each window.
    augmentation : augmentation of all windows.
    averaging : averaging of the weights, see `TrainSettings`.
    is_taught : whether the answer of the model of the previous step is half of the target of
        training.
    kept : share of the weights of the previous step's model in the mean of old and new weights
        (Wortsman et al. 2022, arXiv:2109.01903).
    """

    epochs: int
    rate: float
    recorded: float
    variations: int = 8
    augmentation: Augmentation = Augmentation()  # noqa: RUF009  (frozen)
    averaging: float = 0.0
    is_taught: bool = False
    kept: float = 0.0


STEPS = {
    "first": Step(epochs=20, rate=0.002, recorded=0.5),
    "second": Step(epochs=8, rate=0.001, recorded=0.5),
    "third": Step(epochs=12, rate=0.001, recorded=0.6),
    "fourth": Step(
        epochs=8,
        rate=0.0005,
        recorded=0.6,
        variations=2,
        augmentation=Augmentation(partial=0.5, nothing=0.2),
    ),
    "digits": Step(
        epochs=20,
        rate=0.001,
        recorded=0.6,
        variations=2,
        augmentation=Augmentation(partial=0.5, nothing=0.15),
        averaging=0.9995,
        is_taught=True,
        kept=0.27,
    ),
}
"""Name of a step -> its training, in order; the last one is the bundled model."""


def train_digits(data: TrainingData, steps: dict[str, Step], out: Path) -> Model:
    """Train a model step by step, and test it after the last step.

    Each step continues with the model of the previous step. The model of each step is written to
    `out`. The model of the last step is returned.
    """
    model = None
    last_step = list(steps)[-1]
    for name, step in steps.items():
        settings = TrainSettings(
            epochs=step.epochs,
            learning_rate=step.rate,
            augmentation=step.augmentation,
            averaging=step.averaging,
        )
        motion_settings = MotionSettings(variations=step.variations, recorded=step.recorded)
        motions = resynthesize(
            data.training,
            data.validation,
            data.config,
            motion_settings.for_epochs(step.epochs),
            out / f"motions-{step.variations}",
            workers=available_cores(),
            progress=progress,
        )
        teachers: list[Model] = []
        if model is not None and step.is_taught:
            teachers = [model]
        fitted = fit(
            data,
            settings,
            out / name,
            start=model,
            motions=motions,
            teachers=teachers,
            statistics=False,
            progress=progress,
        )
        if model is not None and step.kept:
            fitted = mixed(model, fitted, step.kept, data)
        if name == last_step:
            fitted = fitted.tested(data)
        model = fitted.model
        model.save(out / f"{name}.safetensors")
    assert model is not None
    return model


def mixed(before: Model, fitted: Fitted, kept: float, data: TrainingData) -> Fitted:
    """The result `fitted` of a training, with weights mixed with those of the model `before`.

    A mixed weight is the mean of both weights, in which that of `before` has the share `kept`. The
    mixed model is calibrated again on the held-out windows, if there are any.
    """
    weights = {
        name: kept * before.weights[name] + (1 - kept) * new_weights
        for name, new_weights in fitted.model.weights.items()
    }
    model = replace(fitted.model, weights=weights, record={**fitted.model.record, "kept": kept})
    if not len(data.validation):
        return replace(fitted, model=model)
    validation = evaluate(pipeline_of(model), data.validation, times_ms=moments_ms(model))
    model, temperature = calibrated(model, validation.temperature)
    record = {
        **model.record,
        "validation": validation.to_dict(),
        "temperature": round(temperature, 5),
    }
    return replace(fitted, model=replace(model, record=record))


def main(argv: list[str] | None = None) -> int:
    """Train `digits`."""
    parser = plain_parser("digits", __doc__)
    add_folder(
        parser,
        "--nmnist",
        "with Train/<digit>/*.bin and Test/<digit>/*.bin (default: $TNT_DATA/nmnist)",
    )
    add_folder(parser, "--mnist", "MNIST's IDX files, gzipped or not (default: $TNT_DATA/mnist)")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("digits"),
        metavar="FOLDER",
        help="models (default: digits)",
    )
    args = parser.parse_args(argv)
    nmnist = data_folder(args.nmnist, "nmnist", "--nmnist")
    mnist = data_folder(args.mnist, "mnist", "--mnist")
    args.out.mkdir(parents=True, exist_ok=True)
    # another number of threads gives slightly different weights
    torch.set_num_threads(1)
    data = digits_data(nmnist, mnist, CONFIG, simulated=SIMULATED, progress=progress)
    model = train_digits(data, STEPS, args.out)
    print(
        f"wrote {args.out / 'digits.safetensors'}: {model.record['test']['per_window']:.4f} of "
        "Test's windows right"
    )
    return 0


if __name__ == "__main__":
    exit_with(main)
