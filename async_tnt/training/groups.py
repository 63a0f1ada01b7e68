"""Groups of recordings that stay together when some are held out.

The recordings of one person, car or session look alike. Later the model will see other persons,
cars or sessions. So whole groups are held out. Then held-out recordings differ from the recordings
to learn from as much as new recordings will, and the accuracy on the held-out recordings says how
good the model will be.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.sources.files.labelled_recordings import file_of

MIN_WINDOWS = 10
"""Fewest windows of a class from which `hold_out_end` holds out the last windows."""


def groups_by_pattern(names: Sequence[str], pattern: str) -> list[str]:
    """The group of each recording: the text that a regular expression finds in its name.

    If the expression has parentheses, the group is the text that they match.

    Parameters
    ----------
    names : `class/file`, of each recording.
    pattern : the regular expression.

    Raises
    ------
    ValueError : the pattern is not a regular expression, or finds nothing in a name.
    """
    try:
        compiled = re.compile(pattern)
    except re.error as error:
        raise ParameterValueError(
            "groups", "must be a regular expression", f"{pattern!r}: {error}"
        ) from None
    groups = []
    for name in names:
        match = compiled.search(name)
        if match is None:
            raise ParameterValueError(
                "groups",
                "must be found in the name of every recording",
                f"{pattern!r}, which is not in {name}",
            )
        in_parentheses = "/".join(part or "" for part in match.groups())
        groups.append(in_parentheses or match[0])
    return groups


def hold_out_last(
    names: Sequence[str], labels: np.ndarray, share: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Hold out, in each class, the recordings with the highest numbers in their names.

    The names of a class must differ in numbers only. Several numbers in a name are compared from
    left to right. Parts of sessions count as not numbered.

    The recordings to learn from may still resemble those that are held out. The last learned
    recording of a class is followed by the first held-out one, and the same people or places may
    occur in both.

    Parameters
    ----------
    names : `class/file`, of each recording.
    labels : int64, of each recording.
    share : share of each class, rounded to whole recordings but at least one; 0: none.

    Returns
    -------
    train, held_out : see `hold_out_groups`. A single None is returned instead if recordings are not
        numbered.
    """
    has_parts_of_sessions = any(file_of(name) != name for name in names)
    if has_parts_of_sessions:
        return None
    held_out = np.zeros(len(labels), bool)
    for label in np.unique(labels):
        members = np.flatnonzero(labels == label).tolist()
        if len(members) == 1:  # the only recording is learned from, whatever its name
            continue
        stems = [PurePosixPath(names[r]).stem for r in members]
        # the names must have numbers, and differ in nothing else
        without_numbers = {re.sub(r"\d+", "0", stem) for stem in stems}
        if len(without_numbers) != 1 or "0" not in without_numbers.pop():
            return None
        numbers = [[int(digits) for digits in re.findall(r"\d+", stem)] for stem in stems]
        ordered = [r for _, r in sorted(zip(numbers, members, strict=True))]
        n_wanted = max(1, round(share * len(ordered))) if share else 0
        n_learned = max(1, len(ordered) - n_wanted)  # at least one recording is learned from
        held_out[ordered[n_learned:]] = True
    return np.flatnonzero(~held_out), np.flatnonzero(held_out)


def hold_out_groups(
    labels: np.ndarray, groups: Sequence[str], share: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Hold out whole groups, drawn at random, until the share of each class is held out.

    Parameters
    ----------
    labels, groups : label and group of each recording.
    share : share of each class, rounded to whole recordings but at least one; 0: none. More
        recordings may be held out, as groups are not divided.
    rng : draws the order of the groups.

    Returns
    -------
    train, held_out : int64 indices, increasing. Each class keeps a recording to train on: a class
        with a single group is not held out.
    """
    group_of = np.unique(np.asarray(groups), return_inverse=True)[1]
    # the rank of each recording's group in a random order of the groups
    rank = np.argsort(rng.permutation(group_of.max(initial=-1) + 1))[group_of]
    # members[k]: the recordings of the group with rank k
    by_rank = np.argsort(rank, kind="stable")
    members = np.split(by_rank, np.cumsum(np.bincount(rank))[:-1])
    n_of_class = np.bincount(labels)
    n_wanted = np.zeros(len(n_of_class))
    if share:
        n_wanted = np.where(n_of_class > 0, np.maximum(np.round(share * n_of_class), 1), 0)
    n_left = n_of_class.copy()
    held_out = np.zeros(len(labels), bool)
    for label in np.flatnonzero(n_of_class):
        for group in np.unique(rank[labels == label]):
            n_held_out = n_of_class[label] - n_left[label]
            if n_held_out >= n_wanted[label]:
                break
            counts = np.bincount(labels[members[group]], minlength=len(n_of_class))
            # each class that the group has must keep a recording to learn from
            leaves_some = ((n_left > counts) | (counts == 0)).all()
            # the group may be held out already, because of an earlier class that it has, too
            is_held_out = held_out[members[group][0]]
            if leaves_some and not is_held_out:
                held_out[members[group]] = True
                n_left -= counts
    return np.flatnonzero(~held_out), np.flatnonzero(held_out)


def hold_out_end(n_windows: int, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Hold out the last windows of a session, or of several sessions in a row.

    Parameters
    ----------
    n_windows : number of windows. They are in order: session after session, and by their starts.
    share : the share to hold out, rounded to whole windows.

    Returns
    -------
    train, held_out : indices of windows. The window between `train` and `held_out` is in neither of
        them, so that they share no moment. If there are fewer than `MIN_WINDOWS`, nothing is held
        out.

    Examples
    --------
    >>> learned, held_out = hold_out_end(10, 0.2)
    >>> learned, held_out
    (array([0, 1, 2, 3, 4, 5, 6]), array([8, 9]))
    """
    order = np.arange(n_windows)
    n_held_out = 0
    if n_windows >= MIN_WINDOWS:
        # two windows remain: one to learn from, and the one between
        n_held_out = min(round(share * n_windows), n_windows - 2)
    if n_held_out == 0:
        return order, order[:0]
    return order[: -n_held_out - 1], order[-n_held_out:]
