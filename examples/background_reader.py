"""A program that is slower than its camera: first it queues every packet, then it skips to the
newest.

`camera` stands for a driver: it yields 2 ms of events every 2 ms, in memory that it reuses for the
next packet. Handling a packet takes 5 ms here, so the program falls behind. In an unlimited queue
the delay grows for as long as the camera runs; with `latest=True` it stays within the four packets
that may wait.
"""

import time
from collections.abc import Iterator

import numpy as np

import async_tnt
from async_tnt.sources import BackgroundReader, open_recording, sample_recordings

PACKET_US = 2_000
events = open_recording(sample_recordings()[8]).read()


def camera() -> Iterator[np.ndarray]:
    memory = np.empty_like(events)
    times_us = np.arange(PACKET_US, events["t"][-1] + PACKET_US, PACKET_US)
    ends = np.searchsorted(events["t"], times_us)
    started = time.monotonic()
    for number, (start, end) in enumerate(zip([0, *ends], ends, strict=False), start=1):
        time.sleep(max(0.0, started + number * PACKET_US / 1e6 - time.monotonic()))
        memory[: end - start] = events[start:end]
        yield memory[: end - start]


def run(name: str, processor: async_tnt.Processor, **settings: object) -> None:
    with BackgroundReader(camera(), **settings) as reader:
        for packet in reader:
            processor.push(packet)
            time.sleep(0.005)  # the rest of the program
        decision = processor.fire()
        counters = reader.counters
    print(
        f"{name:<12} {counters.received} events = {counters.handed_out} handed out + "
        f"{counters.skipped} skipped; waited up to {counters.longest_wait_us / 1000:.0f} ms; "
        f"last decision of {decision.events} events: {decision.label}"
    )


model = async_tnt.load_model("digits")
run("every packet", async_tnt.Processor(model), max_packets=1_000)
run("the newest", async_tnt.Processor(model), max_packets=4, latest=True)
