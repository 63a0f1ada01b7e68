"""Train classifiers on recordings. Needs torch (extra `train`), which is imported when a name that uses it is.

dataset_data, nmnist_data   windows of class folders, or of N-MNIST, to train, validate and test on
train                       learn from windows; `settings_for` chooses `TrainSettings` for a data set of any size
evaluate                    the accuracy of a model on windows; `pipeline_of` makes a torch module of the model
read_dataset, make_windows  the steps between: recordings in memory, and their windows
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

# ruff: noqa: F401  (`__all__` is read from `_MODULES`)
if TYPE_CHECKING:
    from async_tnt.training.augment import Augmentation
    from async_tnt.training.data import TrainingData, dataset_data, nmnist_data
    from async_tnt.training.dataset import Dataset, read_dataset
    from async_tnt.training.evaluation import Evaluation, evaluate
    from async_tnt.training.loop import TrainResult, train
    from async_tnt.training.pipeline import pipeline_of
    from async_tnt.training.settings import TrainSettings, settings_for
    from async_tnt.training.windows import Recordings, Windows, make_windows, split_recordings

_MODULES = {
    "Augmentation": "augment",
    "Dataset": "dataset",
    "Evaluation": "evaluation",
    "Recordings": "windows",
    "TrainResult": "loop",
    "TrainSettings": "settings",
    "TrainingData": "data",
    "Windows": "windows",
    "dataset_data": "data",
    "evaluate": "evaluation",
    "make_windows": "windows",
    "nmnist_data": "data",
    "pipeline_of": "pipeline",
    "read_dataset": "dataset",
    "settings_for": "settings",
    "split_recordings": "windows",
    "train": "loop",
}
__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
