"""Decide what is held out of a data set: recordings and pictures, or the last windows of a class.

The module `groups` finds the groups of recordings, and draws some of them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.sources.files.labelled_recordings import file_of
from async_tnt.training.groups import (
    groups_by_pattern,
    hold_out_end,
    hold_out_groups,
    hold_out_last,
)
from async_tnt.training.recordings import Recordings
from async_tnt.training.windows import Windows

BY_NUMBER = "number, the last ones"
"""The value of `Division.held_out_by` if the recordings with the highest numbers in each class are
held out."""


@dataclass(frozen=True)
class Split:
    """How a data set is divided into recordings to learn from and recordings to hold out.

    Parameters
    ----------
    validation : share of each class's recordings to hold out, rounded to whole recordings, but at
        least one recording. A class with a single recording or a single group is not held out. 0:
        nothing is held out.
    groups : a regular expression that finds a recording's group in its name, see
        `groups_by_pattern`. Whole groups are held out then. None: if the names of recordings are
        numbered, the recordings with the highest numbers in each class are held out; if not, the
        held-out recordings, or sessions, are drawn at random.
    test : whether the recordings of the part `Test` are read, too.
    seed : seed of the groups that are drawn, and of the simulated recordings of pictures.

    Raises
    ------
    ValueError : `validation` is outside [0, 1), or `groups` is not a regular expression.
    """

    validation: float = 0.2
    groups: str | None = None
    test: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.validation < 1:
            raise ParameterValueError("validation", "must be in [0, 1)", self.validation)
        if self.groups is not None:
            groups_by_pattern((), self.groups)


@dataclass(frozen=True)
class Division:
    """Which recordings and pictures are learned from, and which are held out.

    Parameters
    ----------
    learned, held_out : int64, indices of recordings and pictures.
    held_out_by : the rule that divided them, as text for the model's record.
    count_text : text with two numbers: how many recordings or groups are held out, and how many
        there are.
    """

    learned: np.ndarray
    held_out: np.ndarray
    held_out_by: str
    count_text: str


def divide(names: Sequence[str], labels: np.ndarray, split: Split) -> Division:
    """Divide recordings and pictures into learned and held-out ones.

    Parameters
    ----------
    names : the names of recordings and pictures, `class/file`.
    labels : int64, one for each name. The share `split.validation` of each label is held out.
    split : the share, and how recordings are grouped.
    """
    files = [file_of(name) for name in names]
    if split.groups is not None:
        groups = groups_by_pattern(files, split.groups)
        held_out_by = f"group ({split.groups})"
    else:
        by_number = hold_out_last(names, labels, split.validation)
        if by_number is not None:
            learned, held_out = by_number
            count_text = f"{len(held_out)} of {len(labels)} recordings"
            return Division(learned, held_out, BY_NUMBER, count_text)
        # recordings that are not numbered: each file is a group
        groups = files
        held_out_by = "recording" if files == list(names) else "session"
    rng = np.random.default_rng(split.seed)
    learned, held_out = hold_out_groups(labels, groups, split.validation, rng)
    n_held_out = len({groups[r] for r in held_out})
    return Division(learned, held_out, held_out_by, f"{n_held_out} of {len(set(groups))}")


def hold_out_ends(
    training: Windows, validation: Windows, share: float, n_real: int, window_us: int
) -> tuple[Windows, Windows, list[int]]:
    """Hold out the last windows of each class whose recordings are all learned from.

    Such a class has only one recording, or only one group of recordings.

    Parameters
    ----------
    training, validation : windows of the learned recordings, and of those that are held out.
    share : share of the windows of such a class that is held out; 0: nothing is held out.
    n_real : number of recordings of a camera. The recordings after them are of pictures. Windows of
        pictures are not held out.
    window_us : length of a window.

    Returns
    -------
    training, validation, and the labels of the classes whose last windows are held out.
    """
    if not share:
        return training, validation, []
    # each training window's time in its session, and the rank of its file
    sessions_us = _session_starts_us(training.recordings)[training.recording]
    times_us = training.start_us + sessions_us
    ends_us = training.ends_us(window_us) + sessions_us
    files = _file_order(training.recordings)[training.recording]
    is_real = training.recording < n_real
    is_kept = np.ones(len(training), bool)
    labels = []
    ends = []
    for label in np.setdiff1d(training.labels, validation.labels):
        members = np.flatnonzero((training.labels == label) & is_real)
        # file after file, and by time in each file
        members = members[np.lexsort((times_us[members], files[members]))]
        learned, held_out = hold_out_end(len(members), share)
        if not len(held_out):
            continue
        learned = members[learned]
        held_out = members[held_out]
        first = held_out[0]
        # Parts of a session may overlap in time. A window that reaches into the first held-out
        # window is not learned from.
        is_in_other_file = files[learned] != files[first]
        ends_before = ends_us[learned] <= times_us[first]
        is_kept[members] = False
        is_kept[learned] = is_in_other_file | ends_before
        labels.append(int(label))
        ends.append(held_out)
    if not labels:
        return training, validation, labels
    held_out_windows = validation.joined(training[np.concatenate(ends)])
    return training[np.flatnonzero(is_kept)], held_out_windows, labels


def _session_starts_us(recordings: Recordings) -> np.ndarray:
    """The time at which each recording begins in its session, in microseconds.

    The name of a part of a session ends in the part's times, `session.npz[1000:2000]`. A recording
    with a file of its own begins at 0.
    """
    starts = []
    for name in recordings.names:
        start_us = 0
        is_part = file_of(name) != name
        if is_part:
            times = name.rpartition("[")[2]
            start_us = int(times.partition(":")[0])
        starts.append(start_us)
    return np.array(starts)


def _file_order(recordings: Recordings) -> np.ndarray:
    """The rank of each recording's file when the files are sorted by name.

    Numbers in names are compared by their value: `a_9` comes before `a_10`.
    """
    numbered = []
    for name in recordings.names:
        file = file_of(name)
        padded = re.sub(r"\d+", lambda number: number[0].zfill(20), file)
        numbered.append(f"{padded} {file}")
    return np.unique(numbered, return_inverse=True)[1]
