"""The queue of packets, and the reader that fills it in a thread.

The tests are about order, skipping and its counts, and the end.
"""

import asyncio
import collections
import inspect
import itertools
import threading
import weakref
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from made import random_events
from waiting import in_both_ways, until

from async_tnt.sources import BackgroundReader, KeepUp, PacketQueue
from async_tnt.sources.queues.queue import QueueCounters
from async_tnt.volume.events import as_events

EVENTS = random_events(10_000, seed=1)
# some of them empty
PACKETS = np.split(EVENTS, np.sort(np.random.default_rng(2).integers(0, 10_001, 40)))
EQUAL = [EVENTS[k : k + 250] for k in range(0, 10_000, 250)]


@pytest.fixture(autouse=True)
def no_thread_is_left():
    yield

    def is_gone():
        names = [thread.name for thread in threading.enumerate()]
        return "async_tnt.BackgroundReader" not in names

    until(is_gone)


class Source:
    """Packets, with a note of how many were asked for.

    `gate` holds back the packets from number `gate_at` on.
    """

    def __init__(self, packets=PACKETS, gate_at=None, error=None):
        self.packets = packets
        self.error = error
        self.gate = threading.Event()
        self.gate_at = gate_at
        self.n_asked = 0
        self.n_yielded = 0
        self.n_events = 0

    def __iter__(self):
        return self

    def __next__(self):
        self.n_asked += 1
        if self.gate_at is not None and self.n_yielded >= self.gate_at:
            assert self.gate.wait(60)
        if self.n_yielded == len(self.packets):
            raise StopIteration if self.error is None else self.error
        packet = self.packets[self.n_yielded]
        self.n_yielded += 1
        self.n_events += len(packet)
        return packet


@in_both_ways
@pytest.mark.parametrize("latest", [False, True])
@pytest.mark.parametrize("max_packets", [1, 64])
def test_all_packets_come_in_order_where_there_is_room(read, latest, max_packets):
    packets = PACKETS[:max_packets] if latest else PACKETS
    reader = BackgroundReader(packets, latest=latest, max_packets=max_packets)
    assert [packet.tobytes() for packet in read(reader)] == [packet.tobytes() for packet in packets]
    assert reader.n_skipped == reader.backlog == 0


def test_without_latest_the_source_is_held_back():
    source = Source(EQUAL)
    with BackgroundReader(source, max_packets=5) as reader:
        for k in range(20):
            until(lambda: reader.backlog >= 250 * 5)
            assert source.n_asked == 5 + k  # no more, as none fits
            assert next(reader).tobytes() == EQUAL[k].tobytes()


@pytest.mark.parametrize("max_packets", [1, 7])
def test_received_is_handed_out_and_skipped_and_waiting_at_any_moment(max_packets):
    """And the newest packet always arrives."""
    source = Source(PACKETS * 20)
    handed_out = 0
    with BackgroundReader(source, latest=True, max_packets=max_packets) as reader:
        for packet in reader:
            handed_out += len(packet)
            now = reader.counters
            assert now.received == now.handed_out + now.skipped + now.backlog
            assert now.handed_out == handed_out
    now = reader.counters
    assert now.received == source.n_events == handed_out + now.skipped and now.backlog == 0
    assert packet.tobytes() == PACKETS[-1].tobytes()


@in_both_ways
@pytest.mark.parametrize("latest", [False, True])
@pytest.mark.parametrize("error", [OSError(19, "gone"), SystemExit(3)])
def test_an_error_of_the_source_comes_after_the_packets_before_it(read, latest, error):
    reader = BackgroundReader(Source(PACKETS[:7], error=error), latest=latest)
    with pytest.raises(type(error)) as raised:
        read(reader)
    assert raised.value is error and reader.counters.handed_out == sum(map(len, PACKETS[:7]))
    assert list(reader) == []  # once; then it has ended


def test_a_reader_keeps_to_the_longest_delay(monkeypatch):
    """A packet may wait exactly so long."""
    now_us = 0
    clock = SimpleNamespace(monotonic_ns=lambda: now_us * 1000)
    monkeypatch.setattr("async_tnt.sources.queues.queue.time", clock)
    for waited_us, n_skipped in ((1_000, 0), (1_001, 500)):
        with BackgroundReader(EQUAL[:3], latest=True, max_delay_us=1_000) as reader:
            until(lambda: reader.backlog == 750)
            now_us += waited_us
            next(reader)
            assert reader.n_skipped == n_skipped


# -- closing ---------------------------------------------------------------------------------------


def test_closing_at_any_moment_accounts_for_every_event():
    for k in range(50):
        source = Source()
        reader = BackgroundReader(source, max_packets=3, latest=bool(k % 2))
        handed_out = sum(len(next(reader, ())) for _ in range(k % 45))
        reader.close(60)
        counters = reader.counters
        assert counters.received == source.n_events == handed_out + counters.skipped
        assert counters.handed_out == handed_out and counters.backlog == 0
        assert next(reader, None) is None
        assert repr(reader).startswith("BackgroundReader(closed, 0 events ")


@in_both_ways
def test_closing_from_another_thread_ends_the_loop_and_wakes_the_source(read):
    """The error that closing causes in the source is not raised."""
    for _ in range(20):
        source = Source(gate_at=3, error=OSError("the device was closed"))
        source.packets = PACKETS[:3]
        reader = BackgroundReader(source, on_close=source.gate.set)
        closer = threading.Timer(0.001, reader.close)
        closer.start()
        assert len(read(reader)) <= 3
        closer.join()


@in_both_ways
def test_who_closes_a_reader_wants_no_error_any_more_and_wakes_the_source_once(read):
    """To close twice, or after the source has failed, ends the loop without an error."""
    woken = []
    reader = BackgroundReader(
        Source(PACKETS[:2], error=OSError("gone")), on_close=lambda: woken.append(1)
    )
    until(lambda: repr(reader).startswith("BackgroundReader(ended"))
    reader.close()
    reader.close()
    assert read(reader) == [] and woken == [1]


def test_closing_waits_for_the_thread_no_longer_than_it_is_told():
    """Here for no time at all: the source does not end."""
    source = Source(gate_at=0)
    reader = BackgroundReader(source)
    waits = []
    reader._thread = SimpleNamespace(join=waits.append)
    reader.close(0.25)
    asyncio.run(reader.aclose(0.5))
    reader.close()
    source.gate.set()
    assert waits == [0.25, 0.5, 1.0]


def test_while_a_task_waits_for_the_thread_others_run():
    source = Source(gate_at=0)

    async def run():
        closing = asyncio.create_task(BackgroundReader(source).aclose(5))
        await asyncio.sleep(0)
        was_over = closing.done()
        source.gate.set()
        await closing
        return was_over

    assert not asyncio.run(run())


def test_a_packet_that_was_handed_out_belongs_to_its_reader_alone():
    """While the thread waits for the next one, too: its memory is free as soon as that is."""
    source = Source([EQUAL[0].copy() for _ in range(2)], gate_at=1)
    with BackgroundReader(source, copy=False) as reader:
        packet = next(reader)
        source.packets[0] = None
        until(lambda: source.n_asked == 2)
        memory = weakref.ref(packet)
        del packet
        was_free = memory() is None
        source.gate.set()
    assert was_free


# -- arguments -------------------------------------------------------------------------------------


async def asynchronous():
    yield EVENTS


@pytest.mark.parametrize(
    "settings, error, message",
    [
        ({"max_packets": 0}, ValueError, "`max_packets` must be at least 1, got 0"),
        ({"source": 7}, TypeError, "`source` must be an iterable of packets, got int"),
        *(
            (
                {"source": path},
                TypeError,
                r"`source` must yield events, got the path a.bin; open_recording\(path\)",
            )
            for path in ("a.bin", Path("a.bin"))
        ),
        (
            {"source": asynchronous()},
            TypeError,
            "`source` is asynchronous already: pass it to `astream` directly",
        ),
    ],
)
def test_wrong_arguments(settings, error, message):
    with pytest.raises(error, match=f"^{message}"):
        BackgroundReader(**({"source": PACKETS} | settings))


def test_a_source_may_be_a_sequence_and_may_close_its_reader():
    class Packets:
        """It has no method `__iter__`."""

        def __getitem__(self, k):
            if k == 3:
                raise IndexError
            return EQUAL[k]

    with BackgroundReader(Packets()) as reader:
        assert sum(map(len, reader)) == 750
    is_made = threading.Event()
    outcome = []

    def source():
        yield EQUAL[0]
        assert is_made.wait(60)
        try:
            reader.close()
        except RuntimeError as error:  # a thread cannot wait for itself
            outcome.append(error)
        else:
            outcome.append("closed")

    reader = BackgroundReader(source())
    is_made.set()
    assert sum(map(len, reader)) in (0, 250)
    until(lambda: outcome)
    assert outcome == ["closed"]


def test_what_queues_share_has_one_default():
    """A packet is copied, 64 packets wait, and nothing is lost."""
    queue, reader, keep_up = [
        {name: parameter.default for name, parameter in inspect.signature(kind).parameters.items()}
        for kind in (PacketQueue, BackgroundReader, KeepUp)
    ]
    assert queue == dict(max_packets=64, latest=False, max_delay_us=None, copy=True)
    assert reader == {"source": inspect.Parameter.empty, **queue, "on_close": None}
    assert all(keep_up[name] == reader[name] for name in ("source", "copy", "on_close"))


# -- the queue alone -------------------------------------------------------------------------------

PADDED = np.dtype([("p", "u1"), ("x", "<u2"), ("t", "<i8"), ("y", "<u2")], align=True)
FORMS = {
    "records": lambda e: e.copy(),
    "every second": lambda e: np.repeat(e, 2)[::2],
    "columns": lambda e: tuple(e[name].copy() for name in "txyp"),
    "padded": lambda e: e[["p", "x", "t", "y"]].astype(PADDED),
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_is_copied_and_counted(form):
    queue = PacketQueue()
    packet = FORMS[form](EVENTS[:100])
    assert queue.put(packet) and queue.backlog == 100
    # a driver reuses it for the next packet
    for array in packet if form == "columns" else [packet]:
        array[:] = 0
    got = next(queue)
    assert as_events(got, (34, 34)).tobytes() == EVENTS[:100].tobytes()
    if form != "columns":
        assert type(got) is np.ndarray and got.dtype == packet.dtype and got.flags.writeable
    assert queue.counters.handed_out == 100


@pytest.mark.parametrize("make", [PacketQueue, BackgroundReader])
@pytest.mark.parametrize("form", ["records", "columns"])
@pytest.mark.parametrize("copy", [True, False])
def test_packets_are_the_sources_own_where_no_copies_are_asked_for(make, form, copy):
    packets = [FORMS[form](EQUAL[k]) for k in range(3)]
    if make is BackgroundReader:
        reader = BackgroundReader(packets, copy=copy)
    else:
        reader = PacketQueue(copy=copy)
        for packet in packets:
            reader.put(packet)
        reader.end()
    got = list(reader)
    assert [one is packet for one, packet in zip(got, packets, strict=True)] == [not copy] * 3
    assert reader.counters.handed_out == 750
    shared = [np.shares_memory(one[0], packet[0]) for one, packet in zip(got, packets, strict=True)]
    assert shared == [not copy] * 3


def test_a_copy_has_the_type_of_its_packet():
    objects = np.dtype([(name, "O") for name in "txyp"])
    for packet in (EQUAL[0].view(np.recarray), EQUAL[0].astype(objects)):
        queue = PacketQueue()
        queue.put(packet)
        got = next(queue)
        assert type(got) is type(packet) and got.dtype == packet.dtype
        assert got.tolist() == packet.tolist() and not np.shares_memory(got, packet)


@pytest.mark.parametrize("copy", [False, True])
@pytest.mark.parametrize("wrong", ["t,x,y,p", ([1], [2], [3]), (1, 2, 3)])
def test_what_is_no_packet_passes_to_whoever_refuses_it(wrong, copy):
    """It counts no events."""
    queue = PacketQueue(copy=copy)
    for packet in (EQUAL[0], wrong, EQUAL[1]):
        queue.put(packet)
    queue.end()
    first, same, last = queue
    assert same is wrong and len(first) == len(last) == 250
    assert queue.counters.handed_out == 500


def test_latest_discards_the_oldest():
    queue = PacketQueue(max_packets=4, latest=True, copy=False)
    assert all(map(queue.put, EQUAL[:20]))
    assert (queue.backlog, queue.n_skipped) == (1000, 4000)
    queue.end()
    assert all(got is packet for got, packet in zip(queue, EQUAL[16:20], strict=True))
    assert queue.counters == QueueCounters(5000, 1000, 4000, 0, queue.counters.longest_wait_us)


def test_after_the_end_nothing_comes_in():
    queue = PacketQueue()
    queue.put(EQUAL[0])
    queue.end(OSError("first"))
    queue.end(ValueError("second"))
    with pytest.raises(
        ValueError, match=r"^a packet after the end: this queue's end\(\) was called; make a new"
    ):
        queue.put(EQUAL[1])
    assert repr(queue) == "PacketQueue(ended, 250 events waiting, 0 skipped)"
    assert len(next(queue)) == 250
    with pytest.raises(OSError, match="first"):
        next(queue)
    assert list(queue) == [] and queue.counters.received == 250


def test_closed_by_a_signal_between_the_look_for_a_packet_and_its_removal():
    queue = PacketQueue()
    queue.put(EQUAL[0])

    class Interrupted(collections.deque):
        def __bool__(self):
            waits = len(self) > 0
            queue._waiting = collections.deque(self)
            queue.close()
            return waits

    queue._waiting = Interrupted(queue._waiting)
    queue._is_ready = lambda: True
    assert next(queue) is None and list(queue) == [] and queue.counters.skipped == 250


def test_delay_is_the_age_of_the_packet_handed_out(monkeypatch):
    now_us = 0
    clock = SimpleNamespace(monotonic_ns=lambda: now_us * 1000)
    monkeypatch.setattr("async_tnt.sources.queues.queue.time", clock)
    queue = PacketQueue()
    assert queue.delay_us == 0
    queue.put(EQUAL[0])
    now_us = 20
    next(queue)
    now_us = 25
    assert (queue.counters.longest_wait_us, queue.delay_us) == (20, 25)
    queue.put(EQUAL[1])
    now_us = 30
    next(queue)
    assert (queue.counters.longest_wait_us, queue.delay_us) == (20, 5)


def test_the_wait_for_room_is_a_part_of_the_delay(monkeypatch):
    now_us = 0
    clock = SimpleNamespace(monotonic_ns=lambda: now_us * 1000)
    monkeypatch.setattr("async_tnt.sources.queues.queue.time", clock)
    queue = PacketQueue()

    def wait_for_room():
        nonlocal now_us
        now_us += 500

    monkeypatch.setattr(queue, "wait_for_room", wait_for_room)
    queue.put(EQUAL[0])
    next(queue)
    assert (queue.counters.longest_wait_us, queue.delay_us) == (500, 500)


# -- asyncio ---------------------------------------------------------------------------------------


def test_cancelled_while_it_waits_loses_nothing():
    async def run():
        queue = PacketQueue()
        for _ in range(10):
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(anext(queue), 0.001)
        assert not queue._sleepers
        queue.put(EQUAL[0])
        queue.put(EQUAL[1])
        return [await anext(queue), await anext(queue)]

    assert [packet.tobytes() for packet in asyncio.run(run())] == [
        packet.tobytes() for packet in EQUAL[:2]
    ]


def test_a_packet_may_come_when_the_loop_that_waited_for_it_is_closed():
    queue = PacketQueue()
    loop = asyncio.new_event_loop()
    task = loop.create_task(queue.__anext__())
    loop.run_until_complete(asyncio.sleep(0))
    loop.close()
    assert queue.put(EQUAL[0]) and next(queue).tobytes() == EQUAL[0].tobytes()
    task._log_destroy_pending = False  # it is left behind on purpose


def test_a_queue_that_never_runs_empty_leaves_other_tasks_their_turn(monkeypatch):
    monkeypatch.setattr("async_tnt.sources.queues.queue.YIELD_AFTER_S", -1.0)
    turns = itertools.count()

    async def other():
        while True:
            next(turns)
            await asyncio.sleep(0)

    async def run():
        queue = PacketQueue(max_packets=100)
        for packet in EQUAL:
            queue.put(packet)
        queue.end()
        task = asyncio.create_task(other())
        assert len([packet async for packet in queue]) == len(EQUAL)
        task.cancel()

    asyncio.run(run())
    assert next(turns) >= len(EQUAL)
