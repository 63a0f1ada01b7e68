"""A map-style torch data set: the volumes of all windows of a folder of recordings."""

from __future__ import annotations

import os
import warnings

import torch
from torch.utils.data import Dataset

from async_tnt.base.files import user_path
from async_tnt.sources.files.labelled_recordings import has_test
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training.batches import BatchVolumes
from async_tnt.training.dataset import read_dataset
from async_tnt.training.windows import windows_of
from async_tnt.volume.config import TNTConfig


class VolumeDataset(Dataset[tuple[torch.Tensor, int]]):
    """A torch data set. Item i is the volume of window i, and the index of the window's class.

    A volume is float32, shape (C, H, W). It is computed when its item is asked for, from events in
    memory. It is bit for bit the volume that a stream of the recording's events gives, in order of
    time. A UserWarning tells how many recordings are left out.

    Parameters
    ----------
    folder : a data set as for `async-tnt train`: a folder of recordings for each class, or
        sessions.
    config : how events become volumes. It must have neither landmark `regressor` nor
        `window_events`.
    part : "Train", which may be the folder itself, or "Test".
    classes : names, by index; by default the classes of this part, sorted. For "Test", give the
        classes of "Train".

    Attributes
    ----------
    classes : names, by index.
    windows : all windows with events. They lie end to end, from each recording's first event on;
        of windows that slide, the last one ends at the last event.
    left_out : the recordings that are left out, with the reasons.

    Raises
    ------
    ValueError, OSError : as `read_dataset`; the recordings are of another sensor than `config`;
        there are no recordings for "Test".

    Examples
    --------
    >>> from torch.utils.data import DataLoader
    >>> data = VolumeDataset("gestures", TNTConfig(sensor=(128, 128)))  # doctest: +SKIP
    >>> loader = DataLoader(data, batch_size=64, shuffle=True)  # doctest: +SKIP
    >>> volumes, labels = next(iter(loader))  # doctest: +SKIP
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        config: TNTConfig,
        *,
        part: str = "Train",
        classes: tuple[str, ...] | None = None,
    ) -> None:
        if config.needs_regressor:
            raise ValueError(
                "landmark 'regressor' needs a network; volumes of a data set have none"
            )
        if part == "Test" and not has_test(user_path(folder)):
            raise FileNotFoundError(
                f"{folder} has neither a folder Test nor lists of what belongs to it"
            )
        self._volumes = BatchVolumes(config)
        pixels = Pixels(sensor=config.sensor)
        data = read_dataset(folder, part=part, pixels=pixels, classes=classes)
        self.classes = data.classes
        self.left_out = data.left_out
        if self.left_out:
            warnings.warn(
                f"{len(self.left_out)} recordings left out, first {self.left_out[0]}", stacklevel=2
            )
        self.windows = windows_of(data.recordings, config)

    def __len__(self) -> int:
        return len(self.windows)

    def __getitem__(self, index: int) -> tuple[torch.Tensor, int]:
        if not -len(self) <= index < len(self):
            raise IndexError(
                f"`index` must be below {len(self)}, the number of windows, got {index}"
            )
        # For the last window, -1, the slice must end at None: with the end 0 it would be empty.
        window = self.windows[index : index + 1 or None]
        return torch.from_numpy(self._volumes(window)[0].copy()), int(window.labels[0])
