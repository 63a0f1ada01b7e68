"""The queue alone: several producers, every form of packet, asyncio, the end."""

import asyncio
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from made import events_of, random_events

import async_tnt
from async_tnt.sources.background_reader import BackgroundReader
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.queue import PacketQueue

EVENTS = random_events(10_000, seed=1)
PACKETS = [EVENTS[k : k + 250] for k in range(0, 10_000, 250)]
FORMS = {
    "records": lambda e: e.copy(),
    "every second": lambda e: np.repeat(e, 2)[::2],
    "columns": lambda e: tuple(e[name].copy() for name in "txyp"),
    "object": lambda e: SimpleNamespace(**{name: e[name].copy() for name in "txyp"}),
    "packet": lambda e: SimpleNamespace(polarity_events=e.copy()),
    "numpy()": lambda e: SimpleNamespace(numpy=e.copy),
    "padded": lambda e: padded(e),
}


def padded(events):
    packed = np.zeros(len(events), np.dtype([("p", "u1"), ("x", "<u2"), ("t", "<i8"), ("y", "<u2")], align=True))
    for name in "txyp":
        packed[name] = events[name]
    return packed


def fill(packet):
    """Overwrite a packet's memory, as a driver does with the next one."""
    if isinstance(packet, np.ndarray):
        packet[:] = 0
    elif isinstance(packet, tuple):
        for column in packet:
            column[:] = 0
    else:
        for value in vars(packet).values():
            if isinstance(value, np.ndarray):
                fill(value) if value.dtype.names else value.fill(0)


@pytest.mark.parametrize("form", FORMS)
def test_every_form_is_copied_and_counted(form):
    queue = PacketQueue()
    packet = FORMS[form](EVENTS[:100])
    assert queue.put(packet) and queue.backlog == 100
    fill(packet)
    got = next(queue)
    assert async_tnt.events.as_events(got, (34, 34)).tobytes() == EVENTS[:100].tobytes()
    if isinstance(packet, np.ndarray):
        assert type(got) is np.ndarray and got.dtype == packet.dtype and got.flags.writeable
    assert queue.counters.handed_out == 100


@pytest.mark.parametrize("packet, n", [((5, 1, 2, 1), 1), (None, 0), ((), 0), ([], 0), (EVENTS[3], 1), (EVENTS[:0], 0)])
def test_small_packets(packet, n):
    queue = PacketQueue()
    queue.put(packet)
    assert queue.backlog == n
    got = async_tnt.events.as_events(next(queue), (34, 34))
    assert got.tobytes() == async_tnt.events.as_events(packet, (34, 34)).tobytes()


@pytest.mark.parametrize("junk", ["hello", 7, np.zeros(3), {"t": 1}, (1, 2)])
@pytest.mark.parametrize("copy", [False, True])
def test_what_is_no_packet_reaches_who_can_say_so(junk, copy):
    queue = PacketQueue(copy=copy)
    queue.put(junk)
    queue.end()
    assert queue.backlog == 0
    with pytest.raises((TypeError, ValueError), match="event"):
        list(async_tnt.stream(queue, "digits"))


def test_many_who_put_lose_nothing():
    queue = PacketQueue(max_packets=3)
    parts = [PACKETS[k::8] for k in range(8)]

    def put_all(part):
        for packet in part:
            assert queue.put(packet)

    threads = [threading.Thread(target=put_all, args=(part,)) for part in parts]
    for thread in threads:
        thread.start()
    got = [next(queue) for _ in PACKETS]
    for thread in threads:
        thread.join(10)
    got = [packet.tobytes() for packet in got]
    assert sorted(got) == sorted(packet.tobytes() for packet in PACKETS)
    for part in parts:  # each in its own order
        places = [got.index(packet.tobytes()) for packet in part]
        assert places == sorted(places)
    assert queue.counters.longest_wait_us >= 0 and queue.backlog == 0


def test_put_waits_for_room_and_gives_up_when_closed():
    for _ in range(100):
        queue = PacketQueue(max_packets=1)
        queue.put(EVENTS)
        answers = []
        thread = threading.Thread(target=lambda queue=queue, answers=answers: answers.append(queue.put(PACKETS[0])))
        thread.start()
        queue.close()
        thread.join(10)
        assert answers == [False] and not queue.put(PACKETS[1])
        counters = queue.counters
        assert counters.received == counters.skipped == 10_500 and counters.packets_skipped == 3


def test_after_the_end_nothing_comes_in():
    queue = PacketQueue()
    queue.put(PACKETS[0])
    queue.end()
    with pytest.raises(ValueError, match=r"^a packet after the end: this queue's end\(\) was called; make a new"):
        queue.put(PACKETS[1])
    assert len(list(queue)) == 1 and list(queue) == []
    assert queue.counters.received == 250


def test_the_first_end_counts():
    queue = PacketQueue()
    queue.end(OSError("first"))
    queue.end(ValueError("second"))
    with pytest.raises(OSError, match="first"):
        next(queue)


def test_callbacks_from_other_threads_reach_a_processor_owned_by_one():
    events = open_recording(sample_recordings()[6]).read()
    queue = PacketQueue()
    decisions = []
    owner = threading.Thread(target=lambda: decisions.extend(async_tnt.stream(queue, "digits")))
    owner.start()
    for packet in np.array_split(events, 30):
        queue.put(packet)
    queue.end()
    owner.join(60)
    assert [d.logits.tobytes() for d in decisions] == [d.logits.tobytes() for d in async_tnt.stream([events], "digits")]


# -- asyncio ---------------------------------------------------------------------------------------------


def test_async_for_yields_the_packets_in_order():
    async def main():
        async with BackgroundReader(PACKETS, max_packets=2) as reader:
            return [packet async for packet in reader]

    assert [packet.tobytes() for packet in asyncio.run(main())] == [packet.tobytes() for packet in PACKETS]
    assert not any(thread.name == "async_tnt.BackgroundReader" for thread in threading.enumerate())


def test_astream_decides_as_stream():
    recording = open_recording(sample_recordings()[4], packet_events=100)

    async def main():
        return [d async for d in async_tnt.astream(BackgroundReader(recording), "digits", every_us=50_000)]

    expected = [d.logits.tobytes() for d in async_tnt.stream(recording, "digits", every_us=50_000)]
    assert [d.logits.tobytes() for d in asyncio.run(main())] == expected


def test_waiting_in_asyncio_is_idle():
    """While no packet comes, the loop runs its other tasks and burns no time."""

    async def main():
        queue = PacketQueue()
        threading.Timer(0.3, lambda: (queue.put(PACKETS[0]), queue.end())).start()
        beats = 0

        async def beat():
            nonlocal beats
            while True:
                await asyncio.sleep(0.01)
                beats += 1

        other = asyncio.create_task(beat())
        started = time.thread_time()
        got = [packet async for packet in queue]
        other.cancel()
        return len(got), beats, time.thread_time() - started

    n, beats, cpu_s = asyncio.run(main())
    assert n == 1 and beats > 5 and cpu_s < 0.1


def test_a_queue_that_never_runs_empty_leaves_other_tasks_their_turn():
    async def main():
        queue = PacketQueue(max_packets=100)
        for packet in PACKETS:
            queue.put(packet)
        queue.end()
        beats = 0

        async def beat():
            nonlocal beats
            while True:
                await asyncio.sleep(0)
                beats += 1

        other = asyncio.create_task(beat())
        async for _ in queue:
            time.sleep(0.0005)
        other.cancel()
        return beats

    assert asyncio.run(main()) >= 5


def test_errors_come_up_in_async_for():
    def camera():
        yield PACKETS[0]
        raise OSError("cable out")

    async def main():
        got = []
        async with BackgroundReader(camera()) as reader:
            with pytest.raises(OSError, match="cable out"):
                async for packet in reader:
                    got.append(packet)
            return len(got), [packet async for packet in reader]

    assert asyncio.run(main()) == (1, [])


def test_cancelled_while_it_waits_loses_nothing():
    async def main():
        queue = PacketQueue()
        for _ in range(50):
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(anext(queue), 0.001)
        assert not queue._sleepers
        queue.put(PACKETS[0])
        queue.put(PACKETS[1])
        return [await anext(queue), await anext(queue)]

    assert [packet.tobytes() for packet in asyncio.run(main())] == [packet.tobytes() for packet in PACKETS[:2]]


def test_closing_wakes_who_waits_in_asyncio():
    async def main():
        queue = PacketQueue()
        threading.Timer(0.02, queue.close).start()
        return [packet async for packet in queue]

    assert asyncio.run(main()) == []


def test_aclose_leaves_the_loop_free_while_the_source_is_stuck():
    stuck = threading.Event()

    def camera():
        stuck.wait()
        yield PACKETS[0]

    async def main():
        reader = BackgroundReader(camera())
        loop = asyncio.get_running_loop()
        beats = []
        loop.call_later(0.02, lambda: beats.append(loop.time()))
        assert not await reader.aclose(timeout_s=0.05)
        assert beats
        stuck.set()
        assert await reader.aclose(timeout_s=5)

    asyncio.run(main())


def test_a_loop_that_is_gone_does_no_harm():
    queue = PacketQueue()
    loop = asyncio.new_event_loop()
    task = loop.create_task(anext(queue))
    loop.run_until_complete(asyncio.sleep(0.01))
    sleepers = list(queue._sleepers)
    task.cancel()
    loop.run_until_complete(asyncio.gather(task, return_exceptions=True))
    loop.close()
    queue._sleepers = sleepers  # as if the loop had been stopped without a word
    assert queue.put(events_of([1], [1], [1], [1])) and next(queue)["t"] == [1]
