"""The events of ROS 1 and ROS 2 bags, which `ros_reader.py` unpacks in a worker process.

Times are microseconds:

EventPacket, evt3         the clock of the sensor. The words TIME_HIGH and TIME_LOW have its low 24
                          bits, so it is unwrapped every 16.8 s. If the recording began later than
                          the camera, the first time is the clock's modulo 16.8 s. `time_base` is
                          not defined for this encoding.
EventPacket, libcaer_cmp  `time_base` of the message, nanoseconds since 1970, rounded down to a
                          microsecond, plus the time that the words add to it.
EventArray                the stamp of each event, seconds and nanoseconds since 1970 or since the
                          start of a simulation, to the nearest microsecond.

The stamps of messages, and the times of their recording, are not used.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.kernels.sources.evt import INITIAL, decode_evt3
from async_tnt.sources.files.prophesee import decoded_words, refuse_unplaced
from async_tnt.sources.files.ros_reader import Block, read_bag
from async_tnt.sources.files.source import BLOCK_EVENTS, ReadOptions, Source, Topic, valid_blocks
from async_tnt.sources.files.worker_source import WorkerSource
from async_tnt.volume.events import empty_columns


class RosBagSource(WorkerSource):
    """The events of one topic of a bag."""

    unit = "message"

    def _take_head(self, head: Any) -> None:
        sensor, topics = head
        self.sensor = sensor
        self.topics = tuple(Topic(*topic) for topic in topics)

    def _size_of(self, block: Block) -> int:
        return block[0]

    def _events_of(self, blocks: Iterable[Block]) -> Iterator[np.ndarray]:
        columns = empty_columns(BLOCK_EVENTS)[:4]
        state = np.array(INITIAL, np.int64)
        n_events = 0
        for _, arrays in blocks:
            # four columns, or one array of EVT3 words, see `Block`
            if len(arrays) == 4:
                t, x, y, p = arrays
                yield from valid_blocks([(t, x, y, p)])
                continue
            for events in decoded_words(arrays[0], decode_evt3, state, columns):
                yield events
                n_events += len(events)
        refuse_unplaced(state, n_events)


def open_ros_bag(path: Path, options: ReadOptions) -> Source:
    """Open a `.bag`, `.db3` or `.mcap` file."""
    if find_spec("rosbags") is None:
        raise ImportError(
            f"{path}: ROS bags are read by rosbags, which is missing: pip install 'async_tnt[ros]'"
        )
    return RosBagSource(path, partial(read_bag, topic=options.topic), "ROS bag")
