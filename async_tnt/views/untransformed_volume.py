"""The raw event volume of the open window of a processor with a transformed one."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.decision import Decision
from async_tnt.volume import TNTVolume


class UntransformedVolume:
    """A volume without the transform that follows the open window of a processor.

    Parameters
    ----------
    config : the processor's.
    late : the processor's setting.
    """

    def __init__(self, config: TNTConfig, late: str = "accept") -> None:
        raw = config.replace(transform="none", landmark="center", remove_flow=False)
        self._volume = TNTVolume(raw, late=late)

    def reset(self) -> None:
        """Start a new stream."""
        self._volume.reset()

    def follow(self, packets: Iterable[np.ndarray], now: Decision) -> np.ndarray:
        """Add the events that the processor received since the last call.

        Parameters
        ----------
        packets : structured arrays of events, all of them, in order.
        now : the result of the processor's `fire` after the last packet, which names the open window. If a decision
            closed a window early, this is a later one than the events alone imply.

        Returns
        -------
        float32, shape (C, H, W), read-only, valid until the next call.

        Raises
        ------
        ValueError : the processor's window holds other events.
        """
        volume = self._volume
        if volume.n_events == 0 or volume.start_us != now.window_start_us:
            volume.open(now.window_start_us)  # earlier events are late from now on
        for packet in packets:
            volume.update(packet)
        if now.events == 0:
            volume.open(now.window_start_us)
        if volume.n_events != now.events or volume.start_us != now.window_start_us:
            raise ValueError(
                f"the raw volume has {volume.n_events} events from {volume.start_us} us on, the processor's window "
                f"{now.events} from {now.window_start_us} us on: a view can only follow windows without overlap (no "
                "`hop_us`), all of whose events went through `push` of the view"
            )
        return volume.array
