"""How a data set is prepared: where its events are kept, by how many processes, and who is told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from async_tnt.base.progress import Bar


@dataclass(frozen=True)
class Work:
    """How a data set is prepared. Results do not depend on it.

    Parameters
    ----------
    store : a folder for the events and for what is simulated, see `RecordingsWriter`; None: events
        are in memory, and what is simulated is in a temporary folder.
    workers : processes that simulate.
    progress : makes the progress bars, which count recordings.
    """

    store: Path | None = None
    workers: int = 1
    progress: Callable[..., Bar] = Bar
