"""Cut a recording into pieces: at given times, or at N-MNIST's three saccades."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from async_tnt.checks import checked_time
from async_tnt.config import MAX_SIDE
from async_tnt.events import as_events

SACCADE_CUTS_US = (0, 105_000, 210_000, 315_000)
"""Where N-MNIST's saccades begin, and where the third ends, in microseconds (Orchard et al. 2015)."""

_ANY_SENSOR = (MAX_SIDE, MAX_SIDE)  # pixels do not matter here


def segment(events: Any, cuts_us: Sequence[int]) -> list[np.ndarray]:
    """Cut events at given times.

        piece k = {i : cuts_us[k - 1] <= t_i < cuts_us[k]}

    where the first piece has no lower bound and the last no upper one. An event exactly at a cut belongs to the piece
    after it, and no event is lost: K cuts make K + 1 pieces, some perhaps empty. Events keep their order within each
    piece; if times never run backwards, the pieces end to end are the input.

    Parameters
    ----------
    events : in any form that `async_tnt.event_forms` lists, on any sensor.
    cuts_us : increasing times in microseconds, on the events' own clock.

    Returns
    -------
    list of K + 1 structured arrays of `async_tnt.EVENT_DTYPE`, copied from the input.

    Raises
    ------
    ValueError, TypeError : invalid events, or the cuts do not increase.

    References
    ----------
    Wang 2019, arXiv:1911.12801, which separates saccades by a threshold on time.

    Examples
    --------
    >>> events = ([5, 9, 10, 31], [1, 1, 1, 1], [2, 2, 2, 2], [0, 1, 0, 1])  # t, x, y, p
    >>> [piece["t"].tolist() for piece in segment(events, [10, 20, 30])]
    [[5, 9], [10], [], [31]]
    """
    cuts = [checked_time("cuts_us", cut) for cut in cuts_us]
    for k in range(1, len(cuts)):
        if cuts[k] <= cuts[k - 1]:
            raise ValueError(f"`cuts_us` must increase, got {cuts[k]} after {cuts[k - 1]}")
    packed = as_events(events, _ANY_SENSOR)
    t = packed["t"]
    if np.all(t[1:] >= t[:-1]):
        return np.split(packed, np.searchsorted(t, cuts))  # left: an event at a cut belongs to the piece after it
    piece = np.searchsorted(cuts, t, side="right")  # cuts at or before t
    return [packed[piece == k] for k in range(len(cuts) + 1)]


def split_saccades(events: Any, *, start_us: int = 0) -> list[np.ndarray]:
    """Cut a recording like those of N-MNIST into its three saccades and the rest.

    Parameters
    ----------
    events : in any form that `async_tnt.event_forms` lists.
    start_us : when the recording begins. N-MNIST's clock begins at 0, often before the first event.

    Returns
    -------
    list of four structured arrays that together hold all events: [0, 105), [105, 210) and [210, 315) ms after
    `start_us`, and the rest. Events before `start_us` belong to the first.

    References
    ----------
    Orchard, Jayawant, Cohen, Thakor 2015, Frontiers in Neuroscience 9:437, for the three saccades.

    Examples
    --------
    >>> events = ([0, 104_999, 105_000, 320_000], [1, 1, 1, 1], [2, 2, 2, 2], [0, 1, 0, 1])
    >>> first, second, third, rest = split_saccades(events)
    >>> len(first), len(second), len(third), len(rest)
    (2, 1, 0, 1)
    """
    start_us = checked_time("start_us", start_us)
    return segment(events, [start_us + cut for cut in SACCADE_CUTS_US[1:]])
