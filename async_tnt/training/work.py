"""How a data set is prepared: where its events are kept, and by how many processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from async_tnt.base.progress import Bar


@dataclass(frozen=True)
class Work:
    """How a data set is prepared. The prepared data do not depend on it.

    Parameters
    ----------
    store : a folder for the events and for simulated recordings, see `RecordingsWriter`. None:
        events are in memory, and simulated recordings are in a temporary folder.
    workers : number of processes that simulate.
    progress : makes the progress bars, which count recordings.
    """

    store: Path | None = None
    workers: int = 1
    progress: Callable[..., Bar] = Bar
