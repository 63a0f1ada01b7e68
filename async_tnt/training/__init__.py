"""Train classifiers on recordings. Needs torch (extra `train`), which is imported when a name that uses it is.

dataset_data, nmnist_data   windows of class folders, or of N-MNIST, to train, validate and test on
train                       learn from windows; `settings_for` chooses `TrainSettings` for a data set of any size
evaluate                    the accuracy of a model on windows; `pipeline_of` makes a torch module of the model
read_dataset, make_windows  the steps between: recordings in memory, and their windows
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from async_tnt.training.augment import Augmentation
    from async_tnt.training.data import TrainingData, dataset_data, nmnist_data
    from async_tnt.training.dataset import Dataset, read_dataset
    from async_tnt.training.evaluation import Evaluation, evaluate
    from async_tnt.training.loop import TrainResult, train
    from async_tnt.training.pipeline import pipeline_of
    from async_tnt.training.recordings import Recordings
    from async_tnt.training.settings import TrainSettings, settings_for
    from async_tnt.training.windows import Windows, make_windows, split_recordings
else:
    from async_tnt.package import lazy_names

    __getattr__, __dir__ = lazy_names(
        globals(),
        {
            "augment": "Augmentation",
            "data": "TrainingData dataset_data nmnist_data",
            "dataset": "Dataset read_dataset",
            "evaluation": "Evaluation evaluate",
            "loop": "TrainResult train",
            "pipeline": "pipeline_of",
            "settings": "TrainSettings settings_for",
            "recordings": "Recordings",
            "windows": "Windows make_windows split_recordings",
        },
    )

__all__ = [
    "Augmentation", "Dataset", "Evaluation", "Recordings", "TrainResult", "TrainSettings", "TrainingData", "Windows",
    "dataset_data", "evaluate", "make_windows", "nmnist_data", "pipeline_of", "read_dataset", "settings_for",
    "split_recordings", "train",
]  # fmt: skip
