"""The raw event volume of the same window, beside a processor that has the transformed one."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.decision import Decision
from async_tnt.volume import TNTVolume


class RawTwin:
    """Follows a processor's open window with a volume that has no transform.

    Parameters
    ----------
    config : the processor's.
    late : the processor's setting.
    """

    def __init__(self, config: TNTConfig, late: str = "accept") -> None:
        raw = config.replace(transform="none", landmark="center", remove_flow=False)
        self._volume = TNTVolume(raw, late=late)

    def reset(self) -> None:
        """Forget the stream."""
        self._volume.reset()

    def follow(self, packets: Iterable[np.ndarray], now: Decision) -> np.ndarray:
        """Take what the processor took since the last call, and stand where it stands.

        Parameters
        ----------
        packets : structured arrays of events, all of them, in order.
        now : what the processor's `fire` says after the last one: it names the open window. That may be a later one
            than the events alone would tell, where a decision has closed one early.

        Returns
        -------
        float32, shape (C, H, W), read-only, valid until the next call.

        Raises
        ------
        ValueError : the processor's window holds other events.
        """
        volume = self._volume
        if volume.n_events == 0 or volume.start_us != now.window_start_us:
            volume.open(now.window_start_us)  # what came before it is late now
        for packet in packets:
            volume.update(packet)
        if now.events == 0:
            volume.open(now.window_start_us)
        if volume.n_events != now.events or volume.start_us != now.window_start_us:
            raise ValueError(
                f"the raw volume has {volume.n_events} events from {volume.start_us} us on, the processor's window "
                f"{now.events} from {now.window_start_us} us on: a view can only follow windows laid end to end (no "
                "`hop_us`), all of whose events went through `push` of the view"
            )
        return volume.array
