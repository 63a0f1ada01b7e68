"""Waiting for a datagram: ended from any thread at any moment, for any time, and nothing left behind."""

import asyncio
import random
import signal
import sys
import threading
import time

import pytest
from made import random_events
from waiting import meanwhile, until

from async_tnt.sources import UdpSender, UdpSource

EVENTS = random_events(100)
LOOPS_WATCH_SOCKETS = pytest.mark.skipif(sys.platform == "win32", reason="its event loop watches no sockets")


def in_a_loop(source):
    return list(source)


def in_a_task(source):
    async def run():
        return await asyncio.wait_for(packets_of(source), 60)

    return asyncio.run(run())


def in_a_task_and_a_thread(source):
    """As Windows' default event loop has to do it."""

    def refuse(self, *args):
        raise NotImplementedError

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(asyncio.SelectorEventLoop, "add_reader", refuse)
        return in_a_task(source)


in_all_ways = pytest.mark.parametrize("way", [in_a_loop, in_a_task, in_a_task_and_a_thread])


async def packets_of(source):
    return [packet async for packet in source]


def close_in_a_thread(source):
    with meanwhile(source.close):
        pass


@in_all_ways
def test_closed_by_a_thread_at_any_moment(way):
    """No hang, no error, and the socket is closed."""
    chance = random.Random(0)

    def close_after(source, delay_s):
        end = time.perf_counter() + delay_s
        while time.perf_counter() < end:  # `sleep` is too coarse
            pass
        source.close()

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        for _ in range(100):
            source = UdpSource(port=0, buffer_bytes=4096)
            with meanwhile(close_after, source, chance.random() * 1e-3):
                assert way(source) == []
            assert source._socket.fileno() == -1 and source.receive(0) is None
    finally:
        sys.setswitchinterval(before)


@LOOPS_WATCH_SOCKETS
@pytest.mark.parametrize("moment", ["before it waits", "before it watches", "when it watches"])
def test_closed_by_a_thread_just_when_a_task_begins_to_wait(moment, monkeypatch):
    async def run():
        source, loop = UdpSource(port=0), asyncio.get_running_loop()
        create_future, add_reader = loop.create_future, loop.add_reader
        reading = asyncio.ensure_future(packets_of(source))

        def close_and_create():  # the first thing that a wait does
            monkeypatch.undo()
            close_in_a_thread(source)
            return create_future()

        def close_and_watch(*args):
            if moment == "when it watches":
                add_reader(*args)
            close_in_a_thread(source)
            if moment == "before it watches":
                add_reader(*args)

        if moment == "before it waits":
            monkeypatch.setattr(loop, "create_future", close_and_create)
        else:
            monkeypatch.setattr(loop, "add_reader", close_and_watch)
        await asyncio.wait({reading}, timeout=60)
        assert reading.result() == [] and source.closed and source._socket.fileno() == -1

    asyncio.run(run())


@LOOPS_WATCH_SOCKETS
@pytest.mark.parametrize("end", ["timeout", "close", "close in a thread", "cancel"])
def test_the_loop_lets_go_of_the_socket_before_it_is_closed(end, monkeypatch):
    """Its number may then be another socket's, which the loop must not watch in place of ours."""

    async def run():
        source = UdpSource(port=0, timeout_s=0.05 if end == "timeout" else None)
        loop, descriptor = asyncio.get_running_loop(), source._socket.fileno()
        remove_reader, still_open, watching = loop.remove_reader, [], asyncio.Event()

        def watch(number):
            if number == descriptor:
                still_open.append(source._socket.fileno() == descriptor)
            return remove_reader(number)

        add_reader = loop.add_reader
        monkeypatch.setattr(loop, "add_reader", lambda *args: (add_reader(*args), watching.set()))
        monkeypatch.setattr(loop, "remove_reader", watch)
        task = asyncio.ensure_future(packets_of(source))
        await watching.wait()
        if end == "close":
            source.close()
        elif end == "close in a thread":
            close_in_a_thread(source)  # the loop stands still meanwhile
        elif end == "cancel":
            task.cancel()
        await asyncio.wait({task}, timeout=60)
        assert task.done() and task.cancelled() == (end == "cancel")
        assert still_open == [True]
        assert not remove_reader(descriptor)  # nothing is watched any more
        assert source.closed == (end != "timeout")
        source.close()
        assert source._socket.fileno() == -1

    asyncio.run(run())


@in_all_ways
@pytest.mark.parametrize("timeout_s", [25 * 86_400.0, 1e300])
@pytest.mark.parametrize("polls", [True, False])
def test_any_time_can_be_waited(timeout_s, way, polls):
    with UdpSource(port=0, timeout_s=timeout_s) as source, UdpSender(port=source.port) as sender:
        if not polls:  # Windows
            source._waiter._poll = None

        def send_and_close():
            sender.send(EVENTS)
            until(lambda: source.counts.events)
            source.close()

        sending = threading.Timer(0.01, send_and_close)
        sending.start()
        (packet,) = way(source)
        sending.join()
    assert packet.tobytes() == EVENTS.tobytes()


@in_all_ways
def test_silence_for_a_while_ends_it(way, monkeypatch):
    """However many pieces the sleep is cut into: the system takes no more than some days at a time."""
    monkeypatch.setattr("async_tnt.sources.udp_socket.LONGEST_S", 0.01)
    with UdpSource(port=0, timeout_s=0.1) as source, UdpSender(port=source.port) as sender:
        sender.send(EVENTS)
        started = time.monotonic()
        assert [packet.tobytes() for packet in way(source)] == [EVENTS.tobytes()]
        assert time.monotonic() - started > 0.095
        assert not source.closed


def test_closed_while_datagrams_never_pause():
    """The port is free at once, and no later socket is read in place of ours."""
    source, stop = UdpSource(port=0, max_datagrams=1), threading.Event()

    def flood():
        with UdpSender(port=source.port) as sender:
            while not stop.is_set():
                sender.send(EVENTS)

    with meanwhile(flood):
        with meanwhile(list, source):
            until(lambda: source.counts.datagrams >= 20)
            source.close()
            UdpSource(port=source.port).close()
        stop.set()


def test_closed_within_the_loop_over_it():
    with UdpSource(port=0) as source, UdpSender(port=source.port) as sender:
        sender.send(EVENTS)
        assert [source.close() for _ in source] == [None]
        source.close()


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="signals")
def test_closed_in_a_signal_handler_that_interrupts_the_wait():
    source = UdpSource(port=0)
    before = signal.signal(signal.SIGALRM, lambda *_: source.close())
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.02)
        assert list(source) == []
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
