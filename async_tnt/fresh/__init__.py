"""Staying fresh: packets of a camera or a network wait in a bounded queue, and too old ones may be left out.

    with BackgroundReader(camera, latest=True) as reader:
        for decision in async_tnt.stream(reader, "digits"):
            ...

`BackgroundReader` reads a source in a thread of its own; `PacketQueue` is the queue alone, for drivers that call back.
"""

from .background_reader import BackgroundReader
from .packet_queue import PacketQueue, QueueCounters

__all__ = ["BackgroundReader", "PacketQueue", "QueueCounters"]
