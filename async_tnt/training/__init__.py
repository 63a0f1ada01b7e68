"""Train classifiers on recordings.

Training needs torch (extra `train`). The first use of a name that needs torch imports it.

dataset_data                     reads class folders, or recordings with tables of boxes, into
                                 windows to train, validate and test on
VolumeChoice, Split, Work        arguments of `dataset_data`: how events become volumes, what is
                                 held out, where events are kept
Recordings, make_windows         turn events in memory into windows, for `TrainingData`
fit                              trains on these windows; returns a finished model with its record
settings_for, default_config     `TrainSettings` for a data set of any size; the default volume
evaluate, pipeline_of            the accuracy of a model on windows; the model as a torch module
VolumeDataset                    a folder's windows as volumes, for torch's DataLoader and for any
                                 network
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
