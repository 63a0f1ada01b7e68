"""Events that outrun decisions.

There are fewer decisions, then packets are skipped and counted. The delay is bounded. Time is
simulated.
"""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from made import events_of
from waiting import PATIENCE_S, meanwhile

from async_tnt import Processor, TNTConfig
from async_tnt.sources import KeepUp, PacketQueue

PACKET_US = 1_000
CONFIG = TNTConfig(window_us=100_000)


class Clock:
    """The time of the queue and of its policy, in microseconds."""

    def __init__(self, monkeypatch):
        self.now_us = 1_000_000
        clock = SimpleNamespace(monotonic_ns=lambda: int(1000 * self.now_us))
        for module in ("queue", "keep_up"):
            monkeypatch.setattr(f"async_tnt.sources.queues.{module}.time", clock)


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


@pytest.fixture
def reader_of():
    """A KeepUp whose packets the test puts itself: its source waits until the end."""
    done = threading.Event()

    def source():
        done.wait()
        yield from ()

    readers = []

    def make(processor, **settings):
        readers.append(KeepUp(source(), processor, **settings))
        return readers[-1]

    yield make
    done.set()
    for reader in readers:
        reader.close()


def packet(k, n=50):
    t = k * PACKET_US + np.linspace(0, PACKET_US - 1, n).astype(np.int64)
    return events_of(t, np.arange(n) % 34, np.arange(n) % 34, [1] * n)


def consumed(reader, processor, clock, n_packets, decision_us, event_us=0.01):
    """The delays of packets that come every millisecond, where decisions and events cost time."""
    delays = []
    start_us = clock.now_us
    k = 0
    while k < n_packets or reader.backlog:
        while k < n_packets and start_us + k * PACKET_US <= clock.now_us:
            now_us = clock.now_us
            clock.now_us = start_us + k * PACKET_US
            reader.put(packet(k))
            clock.now_us = now_us
            k += 1
        if not reader.backlog:
            clock.now_us = start_us + k * PACKET_US
            continue
        events = next(reader)
        delays.append(reader.delay_us)
        clock.now_us += event_us * len(events) + decision_us * len(processor.push(events))
    return np.array(delays)


@pytest.mark.parametrize(
    "trigger", [{"every_us": 1_000}, {"every_events": 50}], ids=["every_us", "every_events"]
)
@pytest.mark.parametrize("overload", [2, 20])
def test_decisions_become_rarer_before_packets_are_skipped(trigger, overload, clock, reader_of):
    """A decision after each packet costs twice, or twenty times, what there is time for."""
    processor = Processor(CONFIG, classifier=lambda volume: [0.0], **trigger)
    reader = reader_of(processor, max_delay_us=100_000)
    delays = consumed(reader, processor, clock, 5_000, decision_us=overload * PACKET_US)
    counters = reader.counters
    assert counters.received == counters.handed_out + counters.skipped == 250_000
    assert counters.handed_out == processor.counts.received and counters.skipped == 0
    # what waits must be made up for
    assert delays.max() < 100_000 and overload <= reader.slowest <= 8 * overload
    processor.reset()  # times begin again
    delays = consumed(reader, processor, clock, 2_000, decision_us=1)
    assert reader.slower == 1 and delays[-100:].max() < PACKET_US
    assert (processor.every_us, processor.every_events) == (
        trigger.get("every_us"),
        trigger.get("every_events"),
    )


def test_how_long_packets_wait_decides_by_hand(clock, reader_of):
    """The wait is in percent of the delay: above 25 decisions get rarer, below 5 more frequent.

    Between both, and soon after a change, nothing changes.
    """
    processor = Processor(CONFIG, classifier=lambda volume: [0.0], every_us=1_000)
    reader = reader_of(processor, max_delay_us=100_000)
    steps = [
        (25, 1),
        (26, 2),
        (5, 2),
        (25, 2),
        (26, 4),
        (24, 4),
        (6, 4),
        (4, 2),
        (6, 2),
        (4, 1),
        (0, 1),
    ]
    for k, (percent, slower) in enumerate(steps):
        clock.now_us += 30_000  # more than there is between two changes
        reader.put(packet(k))
        clock.now_us += 1_000 * percent
        next(reader)
        assert (reader.slower, processor.every_us) == (slower, 1_000 * slower), (k, percent)
    assert reader.slowest == 4  # though decisions are frequent again
    # one after the other, without a pause
    for percent, slower in ((26, 2), (24, 2), (26, 4), (51, 8), (4, 8)):
        reader.put(packet(k))
        clock.now_us += 1_000 * percent
        next(reader)
        assert reader.slower == slower, percent


@pytest.mark.parametrize(
    ("changed_at", "pause"),
    [
        (30, 25),  # packets wait for 30 to 50 percent of the longest delay
        (60, 5),  # for more than 50 percent
    ],
)
def test_between_two_changes_is_a_pause_by_hand(changed_at, pause, clock, reader_of):
    """In percent of the longest delay."""
    processor = Processor(CONFIG, classifier=lambda volume: [0.0], every_us=1_000)
    reader = reader_of(processor, max_delay_us=100_000)
    start_us = clock.now_us
    arrivals = (0, changed_at - 10, changed_at - 10) if pause > 5 else (0, 0, 0)
    for k, arrival in enumerate(arrivals):
        clock.now_us = start_us + 1_000 * arrival
        reader.put(packet(k))
    for later, slower in ((0, 2), (1_000 * pause - 1, 2), (1_000 * pause, 4)):
        clock.now_us = start_us + 1_000 * changed_at + later
        next(reader)
        assert reader.slower == slower, later


@pytest.mark.parametrize(
    ("window", "trigger", "slowest", "rarest"),
    [
        ({"window_us": 100_000}, {"every_us": 1_000}, 128, 100_000),  # a window has 100
        ({"window_us": 100_000}, {"every_us": 30_000}, 4, 100_000),
        ({"window_us": 100_000}, {"every_us": 150_000}, 1, 150_000),
        ({"window_us": 100_000}, {"every_us": 50}, 1_024, 51_200),
        ({"window_events": 1_000}, {"every_events": 30}, 1_024, 1_000),
        ({"window_events": 1_000}, {"every_events": 3_000}, 1_024, 3_000),
        ({"window_us": 100_000}, {"every_events": 3}, 1_024, 3_072),
        ({"window_us": 100_000}, {}, 1, None),
    ],
)
@pytest.mark.filterwarnings("ignore::async_tnt.base.checks.ParameterWarning")
def test_decisions_become_no_rarer_than_one_a_window(
    window, trigger, slowest, rarest, clock, reader_of
):
    """And by a factor of 1,024 at most; a trigger that is rarer by itself stays as it is."""
    processor = Processor(TNTConfig(**window), classifier=lambda volume: [0.0], **trigger)
    reader = reader_of(processor, max_delay_us=100_000)
    for k in range(15):
        reader.put(packet(k))
        clock.now_us += 60_000
        next(reader)
    (name,) = trigger or ("every_us",)
    assert (reader.slower, reader.slowest) == (slowest, slowest)
    assert getattr(processor, name) == rarest
    reader.close()
    assert getattr(processor, name) == trigger.get(name) and reader.slower == 1


def test_what_events_alone_cost_too_much_is_skipped_and_counted(clock, reader_of):
    """Twice as many events as the volume can take: no rarer decision helps."""
    processor = Processor(CONFIG, classifier=lambda volume: [0.0], every_us=1_000)
    reader = reader_of(processor, max_delay_us=20_000)
    delays = consumed(reader, processor, clock, 5_000, decision_us=10, event_us=2 * PACKET_US / 50)
    counters = reader.counters
    assert counters.received == counters.handed_out + counters.skipped == 250_000
    assert counters.handed_out == processor.counts.received
    assert 0.4 < counters.skipped / 250_000 < 0.6
    assert delays.max() <= 20_000 and processor.every_us == CONFIG.window_us
    assert reader.slowest == 128  # 100 are a window
    with reader:
        pass
    assert processor.every_us == 1_000  # it is as it was at first


@pytest.mark.parametrize("copy", [True, False])
def test_it_copies_packets_only_if_it_is_asked_to_and_wakes_its_source(copy):
    woken = threading.Event()
    packets = [packet(0), packet(1)]

    def source():
        yield from packets
        assert woken.wait(PATIENCE_S)

    processor = Processor(CONFIG, classifier=lambda volume: [0.0])
    with KeepUp(source(), processor, max_delay_us=10**9, copy=copy, on_close=woken.set) as reader:
        got = [next(reader), next(reader)]
    assert [one is given for one, given in zip(got, packets, strict=True)] == [not copy] * 2
    assert woken.is_set()


@pytest.mark.parametrize("kind", ["KeepUp", "PacketQueue"])
def test_while_nobody_reads_no_more_waits_than_comes_within_the_delay(kind, clock, reader_of):
    """If nobody reads the program's output, it waits in a decision, and events go on to come."""
    if kind == "KeepUp":
        reader = reader_of(Processor(CONFIG, classifier=lambda volume: [0.0]), max_delay_us=20_000)
    else:
        reader = PacketQueue(latest=True, max_packets=1 << 20, max_delay_us=20_000)
    for k in range(2_000):
        assert reader.put(packet(k))
        clock.now_us += PACKET_US
        assert reader.backlog <= 21 * 50
    counters = reader.counters
    assert (counters.received, counters.handed_out) == (100_000, 0)
    assert counters.skipped + counters.backlog == 100_000 and counters.backlog >= 20 * 50
    assert next(reader)["t"][0] >= 1_980 * PACKET_US


def test_closed_while_the_processor_is_at_work_the_loop_sets_it_back(clock, reader_of):
    closing = threading.Event()

    def close():
        try:
            reader.close()
        finally:
            closing.set()

    def classify(volume):
        if reader.slower > 1 and not closing.is_set():
            with meanwhile(close):
                assert closing.wait(PATIENCE_S)
        return [0.0]

    processor = Processor(CONFIG, classifier=classify, every_us=1_000)
    reader = reader_of(processor, max_delay_us=100_000)
    consumed(reader, processor, clock, 1_000, decision_us=20 * PACKET_US)
    assert next(reader, None) is None  # where a loop over it ends
    assert closing.is_set() and processor.every_us == 1_000 and reader.slower == 1


def test_the_newest_packet_is_handed_out_however_old_it_is(clock):
    queue = PacketQueue(latest=True, max_delay_us=1_000)
    for k in range(3):
        queue.put(packet(k))
    clock.now_us += 5_000
    assert next(queue)["t"][0] == 2 * PACKET_US and queue.counters.skipped == 100


def test_a_delay_that_cannot_be_kept_is_refused():
    processor = Processor(CONFIG, classifier=lambda volume: [0.0])
    with pytest.raises(ValueError, match=r"^`max_delay_us` must be at least 1, got 0$"):
        KeepUp([], processor, max_delay_us=0)
    with pytest.raises(
        ValueError, match=r"^`max_delay_us` discards packets, which `latest=True` must allow$"
    ):
        PacketQueue(max_delay_us=5)
