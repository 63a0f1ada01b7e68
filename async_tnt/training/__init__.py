"""Train classifiers on recordings. Needs torch (extra `train`), which is imported when a name that
uses it is.

dataset_data                windows of class folders to train, validate and test on
fit, train                  a finished model, with its record, from these; or the training loop
                            alone
settings_for                `TrainSettings` for a data set of any size; `default_config`, the volume
evaluate                    the accuracy of a model on windows; `pipeline_of` makes a torch module
                            of the model
read_dataset, make_windows  the steps between: recordings in memory, and their windows
VolumeDataset               a folder's windows as volumes, for torch's DataLoader and networks of
                            one's own
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from async_tnt.training.augment import Augmentation
    from async_tnt.training.data import TrainingData, dataset_data
    from async_tnt.training.dataset import Dataset, read_dataset
    from async_tnt.training.evaluation import Evaluation, evaluate
    from async_tnt.training.fitting import Fitted, fit
    from async_tnt.training.loop import TrainResult, train
    from async_tnt.training.pipeline import pipeline_of
    from async_tnt.training.recordings import Recordings
    from async_tnt.training.settings import TrainSettings, default_config, settings_for
    from async_tnt.training.volume_dataset import VolumeDataset
    from async_tnt.training.windows import Windows, make_windows
else:
    from async_tnt.base.package import lazy_names

    __getattr__, __dir__ = lazy_names(
        globals(),
        {
            "augment": "Augmentation",
            "data": "TrainingData dataset_data",
            "dataset": "Dataset read_dataset",
            "evaluation": "Evaluation evaluate",
            "fitting": "Fitted fit",
            "loop": "TrainResult train",
            "pipeline": "pipeline_of",
            "settings": "TrainSettings default_config settings_for",
            "recordings": "Recordings",
            "volume_dataset": "VolumeDataset",
            "windows": "Windows make_windows",
        },
    )

__all__ = [
    "Augmentation", "Dataset", "Evaluation", "Fitted", "Recordings", "TrainResult", "TrainSettings", "TrainingData",
    "VolumeDataset", "Windows", "dataset_data", "default_config", "evaluate", "fit", "make_windows", "pipeline_of",
    "read_dataset", "settings_for", "train",
]  # fmt: skip
