"""Memory stays where it is however long a stream runs."""

import tracemalloc

from held_memory import held
from made import random_events, random_model

from async_tnt import Processor, TNTConfig


def test_a_long_stream_leaves_nothing_behind():
    for landmark in ("running", "window"):
        config = TNTConfig(window_us=5_000, landmark=landmark)
        processor = Processor(random_model(config), every_us=1_000, hop_us=2_500)
        packet = random_events(2_000, duration_us=5_000)
        tracemalloc.start()
        try:
            for k in range(120):
                processor.push(packet)
                packet["t"] += 5_000
                if k == 20:
                    before = held()
            after = held()
        finally:
            tracemalloc.stop()
        assert processor.counts.received == 240_000
        assert before > 0 and after - before < 20_000
