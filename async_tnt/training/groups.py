"""Which recordings stay together when some are held out: those of one person, car or session look
alike.

An accuracy on held-out recordings says what new recordings will give only as far as these differ
from the learned ones as new ones will.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np

from async_tnt.sources.files.labelled_recordings import file_of

MIN_WINDOWS = 10
"""Of a session, to hold out its last ones."""


def groups_by_pattern(names: Sequence[str], pattern: str) -> list[str]:
    """What a regular expression finds in each name, `class/file`: its groups in parentheses, or
    else all of it.

    Raises
    ------
    ValueError : not a regular expression, or one that finds nothing in a name.
    """
    try:
        compiled = re.compile(pattern)
    except re.error as error:
        raise ValueError(
            f"`groups` must be a regular expression, got {pattern!r}: {error}"
        ) from None
    groups = []
    for name in names:
        if (found := compiled.search(name)) is None:
            raise ValueError(
                f"`groups` must be found in the name of every recording, but {pattern!r} is not in "
                f"{name}"
            )
        groups.append("/".join(part or "" for part in found.groups()) or found[0])
    return groups


def hold_out_last(
    names: Sequence[str], labels: np.ndarray, share: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Hold out the last recordings of each class by number; None where recordings are not numbered.

    They are if those of a class differ in numbers only; several numbers count from left to right.
    Parts of sessions are not. What leaks are the neighbours where a class is cut, and people or
    places that recur.

    Returns
    -------
    train, held_out : as `hold_out_groups`.
    """
    if any(file_of(name) != name for name in names):
        return None
    held_out = np.zeros(len(labels), bool)
    for label in np.unique(labels):
        members = np.flatnonzero(labels == label).tolist()
        if len(members) == 1:  # is not held out, whatever its name
            continue
        texts = {re.sub(r"\d+", "0", PurePosixPath(names[r]).stem) for r in members}
        if len(texts) != 1 or "0" not in texts.pop():
            return None
        numbers = [
            [int(number) for number in re.findall(r"\d+", PurePosixPath(names[r]).stem)]
            for r in members
        ]
        ordered = [r for _, r in sorted(zip(numbers, members, strict=True))]
        wanted = max(1, round(share * len(ordered))) if share else 0
        held_out[ordered[max(1, len(ordered) - wanted) :]] = True
    return np.flatnonzero(~held_out), np.flatnonzero(held_out)


def hold_out_groups(
    labels: np.ndarray, groups: Sequence[str], share: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Hold out whole groups, drawn at random, until each class has its share.

    Parameters
    ----------
    labels, groups : of each recording.
    share : of each class, rounded to whole recordings but at least one; 0: none. Large groups give
        more.

    Returns
    -------
    train, held_out : int64 indices, increasing. Each class keeps a recording to train on: one that
        has a single group is not held out.
    """
    of = np.unique(np.asarray(groups), return_inverse=True)[1]
    place = np.argsort(rng.permutation(of.max(initial=-1) + 1))  # of each group in a random order
    by_group = np.argsort(place[of], kind="stable")
    members = np.split(by_group, np.cumsum(np.bincount(place[of]))[:-1])
    n = np.bincount(labels)
    wanted = np.where(n > 0, np.maximum(np.round(share * n), 1), 0) if share else np.zeros(len(n))
    left = n.copy()
    held_out = np.zeros(len(labels), bool)
    for label in np.flatnonzero(n):
        for group in np.unique(place[of[labels == label]]):
            if n[label] - left[label] >= wanted[label]:
                break
            counts = np.bincount(labels[members[group]], minlength=len(n))
            if not held_out[members[group][0]] and ((left > counts) | (counts == 0)).all():
                held_out[members[group]] = True
                left -= counts
    return np.flatnonzero(~held_out), np.flatnonzero(held_out)


def hold_out_end(n_windows: int, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Hold out the last of the windows of one session, or of one after the other.

    Parameters
    ----------
    n_windows : which begin in this order.
    share : rounded to whole windows.

    Returns
    -------
    train, held_out : indices. A window between them is in neither: its neighbours share no moment.
        With fewer than `MIN_WINDOWS`, nothing is held out.

    Examples
    --------
    >>> learned, held_out = hold_out_end(10, 0.2)
    >>> learned, held_out
    (array([0, 1, 2, 3, 4, 5, 6]), array([8, 9]))
    """
    order = np.arange(n_windows)
    n_held_out = min(round(share * n_windows), n_windows - 2) if n_windows >= MIN_WINDOWS else 0
    if n_held_out == 0:
        return order, order[:0]
    return order[: -n_held_out - 1], order[-n_held_out:]
