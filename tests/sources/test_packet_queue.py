"""The queue alone: every form of packet, what is discarded, asyncio, the end."""

import asyncio
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from made import random_events

from async_tnt.events import as_events
from async_tnt.sources import PacketQueue, QueueCounters

EVENTS = random_events(10_000, seed=1)
PACKETS = [EVENTS[k : k + 250] for k in range(0, 10_000, 250)]
PADDED = np.dtype([("p", "u1"), ("x", "<u2"), ("t", "<i8"), ("y", "<u2")], align=True)
FORMS = {
    "records": lambda e: e.copy(),
    "every second": lambda e: np.repeat(e, 2)[::2],
    "columns": lambda e: tuple(e[name].copy() for name in "txyp"),
    "object": lambda e: SimpleNamespace(**{name: e[name].copy() for name in "txyp"}),
    "padded": lambda e: e[["p", "x", "t", "y"]].astype(PADDED),
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_is_copied_and_counted(form):
    queue = PacketQueue()
    packet = FORMS[form](EVENTS[:100])
    assert queue.put(packet) and queue.backlog == 100
    memory = [packet] if isinstance(packet, np.ndarray) else packet if form == "columns" else vars(packet).values()
    for array in memory:  # a driver reuses it for the next packet
        array[:] = 0
    got = next(queue)
    assert as_events(got, (34, 34)).tobytes() == EVENTS[:100].tobytes()
    if isinstance(packet, np.ndarray):
        assert type(got) is np.ndarray and got.dtype == packet.dtype and got.flags.writeable
    assert queue.counters.handed_out == 100


@pytest.mark.parametrize("limits", [{"max_packets": 4}, {"max_packets": 64, "max_events": 1000}])
def test_latest_discards_the_oldest(limits):
    queue = PacketQueue(latest=True, copy=False, **limits)
    assert all(map(queue.put, PACKETS[:20]))
    assert (queue.backlog, queue.n_skipped) == (1000, 4000)
    queue.end()
    assert all(got is packet for got, packet in zip(queue, PACKETS[16:20], strict=True))
    assert queue.counters == QueueCounters(5000, 1000, 4000, 0, queue.counters.longest_wait_us)


def test_after_the_end_nothing_comes_in():
    queue = PacketQueue()
    queue.put(PACKETS[0])
    queue.end(OSError("first"))
    queue.end(ValueError("second"))
    with pytest.raises(ValueError, match=r"^a packet after the end: this queue's end\(\) was called; make a new"):
        queue.put(PACKETS[1])
    assert repr(queue) == "PacketQueue(ended, 250 events waiting, 0 skipped)" and len(next(queue)) == 250
    with pytest.raises(OSError, match="first"):
        next(queue)
    assert list(queue) == [] and queue.counters.received == 250


def test_delay_is_the_age_of_the_packet_handed_out(monkeypatch):
    now_us = 0
    clock = SimpleNamespace(monotonic_ns=lambda: now_us * 1000)
    monkeypatch.setattr("async_tnt.sources.queue.time", clock)
    queue = PacketQueue()
    assert queue.delay_us == 0
    queue.put(PACKETS[0])
    now_us = 20
    next(queue)
    now_us = 25
    assert (queue.counters.longest_wait_us, queue.delay_us) == (20, 25)


# -- asyncio ---------------------------------------------------------------------------------------------


async def collect(queue):
    return [packet async for packet in queue]


def test_cancelled_while_it_waits_loses_nothing():
    async def run():
        queue = PacketQueue()
        for _ in range(10):
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(anext(queue), 0.001)
        assert not queue._sleepers
        queue.put(PACKETS[0])
        queue.put(PACKETS[1])
        return [await anext(queue), await anext(queue)]

    assert [packet.tobytes() for packet in asyncio.run(run())] == [packet.tobytes() for packet in PACKETS[:2]]


def test_a_queue_that_never_runs_empty_leaves_other_tasks_their_turn(monkeypatch):
    monkeypatch.setattr("async_tnt.sources.queue.YIELD_AFTER_S", -1.0)
    turns = itertools.count()

    async def other():
        while True:
            next(turns)
            await asyncio.sleep(0)

    async def run():
        queue = PacketQueue(max_packets=100)
        for packet in PACKETS:
            queue.put(packet)
        queue.end()
        task = asyncio.create_task(other())
        assert len(await collect(queue)) == len(PACKETS)
        task.cancel()

    asyncio.run(run())
    assert next(turns) >= len(PACKETS)
