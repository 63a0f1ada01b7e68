"""Train classifiers on recordings.

Needs torch (extra `train`), which is imported when a name that uses it is.

dataset_data                     windows of class folders to train, validate and test on
VolumeChoice, Split, Work        how their events become volumes, what is held out, where events are
                                 kept
Recordings, make_windows         the same from events in memory, for `TrainingData`
fit                              a finished model, with its record, from these
settings_for, default_config     `TrainSettings` for a data set of any size, and its volume
evaluate, pipeline_of            the accuracy of a model on windows; a torch module of the model
VolumeDataset                    a folder's windows as volumes, for torch's DataLoader and networks
                                 of one's own
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from async_tnt.training.augment import Augmentation
    from async_tnt.training.data import dataset_data
    from async_tnt.training.evaluation import evaluate
    from async_tnt.training.fitting import Fitted, fit
    from async_tnt.training.held_out import Split
    from async_tnt.training.pipeline import pipeline_of
    from async_tnt.training.recordings import Recordings
    from async_tnt.training.settings import TrainSettings, default_config, settings_for
    from async_tnt.training.training_data import TrainingData
    from async_tnt.training.volume_choice import VolumeChoice
    from async_tnt.training.volume_dataset import VolumeDataset
    from async_tnt.training.windows import Windows, make_windows
    from async_tnt.training.work import Work
else:
    from async_tnt.base.package import lazy_names

    __getattr__, __dir__ = lazy_names(
        globals(),
        {
            "augment": "Augmentation",
            "data": "dataset_data",
            "evaluation": "evaluate",
            "fitting": "Fitted fit",
            "held_out": "Split",
            "pipeline": "pipeline_of",
            "recordings": "Recordings",
            "settings": "TrainSettings default_config settings_for",
            "training_data": "TrainingData",
            "volume_choice": "VolumeChoice",
            "volume_dataset": "VolumeDataset",
            "windows": "Windows make_windows",
            "work": "Work",
        },
        instead={
            "Dataset": "`dataset_data` returns `TrainingData`",
            "Evaluation": "it is in `async_tnt.training.evaluation`",
            "TrainResult": "`fit` returns `Fitted`",
            "read_dataset": "use `dataset_data`",
            "train": "use `fit`, which also calibrates the model",
        },
    )

__all__ = [
    "Augmentation",
    "Fitted",
    "Recordings",
    "Split",
    "TrainSettings",
    "TrainingData",
    "VolumeChoice",
    "VolumeDataset",
    "Windows",
    "Work",
    "dataset_data",
    "default_config",
    "evaluate",
    "fit",
    "make_windows",
    "pipeline_of",
    "settings_for",
]
