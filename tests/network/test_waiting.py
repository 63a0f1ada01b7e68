"""Waiting for a datagram: ended from any thread at any moment, for any time, and nothing left behind."""

import asyncio
import random
import signal
import sys
import threading
import time

import pytest
from made import random_events
from waiting import PATIENCE_S, meanwhile, until

from async_tnt.sources import UdpSender, UdpSource

EVENTS = random_events(100)


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


@in_all_ways
@pytest.mark.parametrize(("timeout_s", "polls"), [(25 * 86_400.0, True), (1e300, True), (1e300, False)])
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


class PatientForTwoPackets(UdpSource):
    timeout_s = property(lambda self: PATIENCE_S if self.counts.events < 2 * len(EVENTS) else 0.01, lambda *_: None)


@in_all_ways
def test_silence_for_a_while_ends_it(way, monkeypatch):
    """However many pieces the sleep is cut into: the system takes no more than some days at a time."""
    monkeypatch.setattr("async_tnt.sources.udp_socket.LONGEST_S", 0.01)
    with PatientForTwoPackets(port=0) as source, UdpSender(port=source.port) as sender:
        sender.send(EVENTS)
        sending = threading.Timer(0.1, sender.send, [EVENTS])
        sending.start()
        assert b"".join(packet.tobytes() for packet in way(source)) == 2 * EVENTS.tobytes()
        sending.join()
        assert not source.closed


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
