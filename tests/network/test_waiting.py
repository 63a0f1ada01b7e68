"""Waiting for a datagram: ended from any thread at any moment, for any time, and nothing left behind."""

import asyncio
import random
import sys
import threading
import time

import pytest
from made import random_events

from async_tnt.sources.udp import UdpSource, open_udp
from async_tnt.sources.udp_sender import UdpSender

EVENTS = random_events(100)
A_CENTURY_S = 3.2e9
LOOPS_WATCH_SOCKETS = pytest.mark.skipif(sys.platform == "win32", reason="its event loop watches no sockets")


async def packets_of(source):
    return [packet async for packet in source]


def refuse(self, *args):
    """`add_reader` of Windows' default event loop."""
    raise NotImplementedError


def test_closed_by_a_thread_just_before_a_task_begins_to_wait(monkeypatch):
    async def run():
        source = UdpSource(port=0)
        loop = asyncio.get_running_loop()
        create_future = loop.create_future

        def close_first():
            monkeypatch.undo()
            closing = threading.Thread(target=source.close)
            closing.start()
            closing.join()
            return create_future()

        reading = asyncio.ensure_future(packets_of(source))
        monkeypatch.setattr(loop, "create_future", close_first)  # the first thing that a wait does
        await asyncio.sleep(0)
        assert source.closed
        assert await asyncio.wait_for(reading, 10) == [] and source._socket.fileno() == -1

    asyncio.run(run())


@LOOPS_WATCH_SOCKETS
@pytest.mark.parametrize("moment", ["before", "after"])
def test_closed_by_a_thread_just_when_a_task_begins_to_wait(moment, monkeypatch):
    async def run():
        source = UdpSource(port=0)
        loop = asyncio.get_running_loop()
        add_reader = loop.add_reader

        def close_meanwhile(descriptor, *args):
            if moment == "after":
                add_reader(descriptor, *args)
            closing = threading.Thread(target=source.close)
            closing.start()
            closing.join()
            if moment == "before":
                add_reader(descriptor, *args)

        monkeypatch.setattr(loop, "add_reader", close_meanwhile)
        assert await asyncio.wait_for(packets_of(source), 10) == []
        assert source.closed and source._socket.fileno() == -1

    asyncio.run(run())


@pytest.mark.parametrize("watched", [pytest.param(True, marks=LOOPS_WATCH_SOCKETS), False])
def test_closed_by_a_thread_at_any_moment(watched, monkeypatch):
    """No hang, no error, and the socket is closed."""
    if not watched:
        monkeypatch.setattr(asyncio.SelectorEventLoop, "add_reader", refuse)
    chance = random.Random(0)

    def close_after(source, delay_s):
        until = time.perf_counter() + delay_s
        while time.perf_counter() < until:  # `sleep` is too coarse
            pass
        source.close()

    async def run():
        for _ in range(400):
            source = UdpSource(port=0, buffer_bytes=4096)
            closing = threading.Thread(target=close_after, args=(source, chance.random() * 4e-4))
            closing.start()
            assert await asyncio.wait_for(packets_of(source), 10) == []
            closing.join()
            assert source._socket.fileno() == -1

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        asyncio.run(run())
    finally:
        sys.setswitchinterval(before)


@LOOPS_WATCH_SOCKETS
@pytest.mark.parametrize("end", ["timeout", "close", "close in a thread", "cancel"])
def test_the_loop_lets_go_of_the_socket_before_it_is_closed(end, monkeypatch):
    """Its number may then be another socket's, which the loop must not watch in place of ours."""

    async def run():
        source = UdpSource(port=0, timeout_s=0.05 if end == "timeout" else None)
        loop = asyncio.get_running_loop()
        descriptor = source._socket.fileno()
        remove_reader = loop.remove_reader
        still_open = []

        def watch(number):
            if number == descriptor:
                still_open.append(source._socket.fileno() == descriptor)
            return remove_reader(number)

        monkeypatch.setattr(loop, "remove_reader", watch)
        task = asyncio.ensure_future(packets_of(source))
        await asyncio.sleep(0.01)
        if end == "close":
            source.close()
        elif end == "close in a thread":
            closing = threading.Thread(target=source.close)
            closing.start()
            closing.join()  # the loop stands still meanwhile
        elif end == "cancel":
            task.cancel()
        await asyncio.wait({task}, timeout=10)
        assert task.done() and task.cancelled() == (end == "cancel")
        assert end == "cancel" or task.result() == []
        assert still_open == [True]
        assert not remove_reader(descriptor)  # nothing is watched any more
        source.close()
        assert source._socket.fileno() == -1

    asyncio.run(run())


def in_a_loop(source):
    return next(iter(source))


def in_a_task(source):
    async def first():
        async for packet in source:
            return packet

    return asyncio.run(first())


def in_a_task_and_a_thread(source):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(asyncio.SelectorEventLoop, "add_reader", refuse)
        return in_a_task(source)


@pytest.mark.parametrize("timeout_s", [25 * 86_400.0, A_CENTURY_S, 1e300])
@pytest.mark.parametrize("way", [in_a_loop, in_a_task, in_a_task_and_a_thread])
@pytest.mark.parametrize("polls", [True, False])
def test_any_time_can_be_waited(timeout_s, way, polls):
    with UdpSource(port=0, timeout_s=timeout_s) as source, UdpSender(port=source.port) as sender:
        if not polls:  # Windows
            source._waiter._poll = None
        sending = threading.Timer(0.03, sender.send, [EVENTS])
        sending.start()
        assert way(source).tobytes() == EVENTS.tobytes()
        sending.join()


def test_any_time_in_a_url():
    with open_udp("udp://127.0.0.1:0?timeout_s=1e10") as source:
        threading.Timer(0.03, source.close).start()
        assert list(source) == []


@pytest.mark.parametrize("way", ["loop", "thread", "task"])
def test_a_sleep_cut_in_pieces_lasts_as_long(way, monkeypatch):
    """As one of weeks is: the system takes no more than some days."""
    monkeypatch.setattr("async_tnt.sources.udp_socket.LONGEST_S", 0.01)
    if way == "thread":
        monkeypatch.setattr(asyncio.SelectorEventLoop, "add_reader", refuse)
    with UdpSource(port=0, timeout_s=0.1) as source:
        started = time.monotonic()
        assert (list(source) if way == "loop" else asyncio.run(packets_of(source))) == []
        assert time.monotonic() - started > 0.095


@pytest.mark.parametrize("way", ["watched", "thread"])
def test_silence_for_a_while_ends_a_task(way, monkeypatch):
    if way == "thread":
        monkeypatch.setattr(asyncio.SelectorEventLoop, "add_reader", refuse)

    async def run():
        async with UdpSource(port=0, timeout_s=0.1) as source:
            with UdpSender(port=source.port) as sender:
                sender.send(EVENTS)
            got = await packets_of(source)
            assert len(got) == 1 and got[0].tobytes() == EVENTS.tobytes() and not source.closed
        assert source._socket.fileno() == -1

    asyncio.run(run())
