"""What a source of datagrams has counted."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NetworkCounts:
    """What has come so far."""

    datagrams: int
    bytes: int
    events: int
    """Handed on."""
    malformed: int
    """Left out: cut off, off the sensor, polarity or time impossible, too far ahead."""
    late: int
    """Handed on, but older than one before: the network or the sender changed their order."""
    lost: int | None
    """Datagrams that the system threw away, mostly because its buffer was full; None where it does not say."""
    ahead: int = 0
    """How many of `malformed` were left out for a time too far ahead of the stream."""
    off_sensor: int = 0
    """How many of `malformed` lie off the sensor."""
    clock_restarts: int = 0
    """How often the sender's clock started anew; times go on, see `UdpSource`."""

    def summary(self) -> str:
        """One line for people.

        Examples
        --------
        >>> NetworkCounts(12, 15_600, 1_199, malformed=1, late=0, lost=None, ahead=1).summary()
        '12 datagrams, 1,199 events (1 malformed, 1 of them too far ahead, 0 out of order, datagrams lost: unknown)'
        """
        lost = "unknown" if self.lost is None else f"{self.lost:,}"
        of_them = f"{self.ahead:,} of them too far ahead, " if self.ahead else ""
        of_them += f"{self.off_sensor:,} of them off the sensor, " if self.off_sensor else ""
        restarts = f", clock restarts: {self.clock_restarts:,}" if self.clock_restarts else ""
        return (
            f"{self.datagrams:,} datagrams, {self.events:,} events ({self.malformed:,} malformed, {of_them}"
            f"{self.late:,} out of order, datagrams lost: {lost}{restarts})"
        )
