"""Which piece of a cut recording an event belongs to."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from .window import Column, as_column


def segment_index(t: Column, cuts_us: Sequence[int]) -> torch.Tensor:
    """The number of cuts at or before each event:  k_i = #{c : cuts_us[c] <= t_i}.

    So piece k holds the times [cuts_us[k - 1], cuts_us[k]), with no bound before the first piece and none after
    the last.

    Parameters
    ----------
    t : (N,) integer microseconds.
    cuts_us : K times, in any order.

    Returns
    -------
    int64 tensor (N,), from 0 to K.

    Example
    -------
    >>> segment_index([5, 9, 10, 31], [10, 20, 30]).tolist()
    [0, 0, 1, 3]
    """
    cuts = torch.as_tensor(cuts_us, dtype=torch.int64)  # (K,)
    return (cuts <= as_column("t", t)[:, None]).sum(1)
