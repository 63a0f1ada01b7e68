"""Decide every 30 ms on events from an asynchronous source, in real time.

`camera` stands for a socket or a driver: any async generator of packets works. While it waits, the
event loop is free, as the second task shows.
"""

import asyncio
from collections.abc import AsyncIterator

import numpy as np

import async_tnt
from async_tnt.sources import open_recording, sample_recordings


async def camera(packet_us: int = 5_000) -> AsyncIterator[np.ndarray]:
    events = open_recording(sample_recordings()[8]).read()
    loop = asyncio.get_running_loop()
    started = loop.time()
    for start_us in range(0, int(events["t"][-1]) + 1, packet_us):
        end_us = start_us + packet_us
        await asyncio.sleep(started + end_us / 1e6 - loop.time())  # until the packet is complete
        yield events[(events["t"] >= start_us) & (events["t"] < end_us)]


async def other_work(heartbeats: list[float]) -> None:
    while True:
        await asyncio.sleep(0.01)
        heartbeats.append(asyncio.get_running_loop().time())


async def main() -> None:
    model = async_tnt.load_model("digits")
    async_tnt.warmup(model)  # compile now, so that the event loop is not blocked later
    heartbeats: list[float] = []
    task = asyncio.create_task(other_work(heartbeats))
    async for decision in async_tnt.astream(camera(), model, every_us=30_000):
        time_ms = decision.time_us / 1000
        print(
            f"{time_ms:6.1f} ms  {decision.trigger:<8}  {decision.label} "
            f"({decision.probability:.0%})"
        )
    task.cancel()
    print(f"meanwhile the loop ran other work {len(heartbeats)} times")


asyncio.run(main())  # in a notebook, where a loop is running already: await main()
