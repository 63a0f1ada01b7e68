"""A reader in a thread: order, skipping and its accounts, backpressure, errors, closing in every state."""

import gc
import threading
import time

import numpy as np
import pytest
from made import random_events

import async_tnt
from async_tnt.sources.background_reader import BackgroundReader
from async_tnt.sources.files.recording import open_recording, sample_recordings

EVENTS = random_events(10_000, seed=1)
PACKETS = np.split(EVENTS, np.sort(np.random.default_rng(2).integers(0, 10_001, 40)))  # some of them empty


def threads():
    return [thread for thread in threading.enumerate() if thread.name == "async_tnt.BackgroundReader"]


@pytest.fixture(autouse=True)
def no_thread_is_left():
    yield
    deadline = time.monotonic() + 60
    while threads() and time.monotonic() < deadline:
        time.sleep(0.001)
    assert not threads()


def until(condition):
    """Wait for what another thread is about to do, with a generous end."""
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.0005)


class Source:
    """Packets, with a note of how many were asked for; `gate` holds back the packets from number `gate_at` on."""

    def __init__(self, packets, gate_at=None, error=None):
        self.packets, self.error = packets, error
        self.gate, self.gate_at = threading.Event(), gate_at
        self.n_asked = self.n_yielded = self.n_events = 0

    def __iter__(self):
        return self

    def __next__(self):
        self.n_asked += 1
        if self.gate_at is not None and self.n_yielded >= self.gate_at:
            assert self.gate.wait(60)
        if self.n_yielded == len(self.packets):
            if self.error is not None:
                raise self.error
            raise StopIteration
        packet = self.packets[self.n_yielded]
        self.n_yielded += 1
        self.n_events += len(packet)
        return packet


@pytest.mark.parametrize("latest", [False, True])
@pytest.mark.parametrize("max_packets", [1, 2, 64])
def test_all_packets_come_in_order_where_there_is_room(latest, max_packets):
    packets = PACKETS[:max_packets] if latest else PACKETS
    with BackgroundReader(packets, latest=latest, max_packets=max_packets) as reader:
        got = list(reader)
    assert [packet.tobytes() for packet in got] == [packet.tobytes() for packet in packets]
    assert reader.n_skipped == reader.backlog == 0


def test_decisions_are_those_of_the_source():
    recording = open_recording(sample_recordings()[4], packet_events=100)
    with BackgroundReader(recording, max_packets=3) as reader:
        got = list(async_tnt.stream(reader, "digits", every_us=10_000))
    expected = list(async_tnt.stream(recording, "digits", every_us=10_000))
    assert len(got) > 20
    for one, other in zip(got, expected, strict=True):
        assert one.time_us == other.time_us and one.logits.tobytes() == other.logits.tobytes()


def test_without_latest_the_source_is_held_back():
    source = Source(PACKETS)
    with BackgroundReader(source, max_packets=5) as reader:
        until(lambda: source.n_yielded == 5)
        time.sleep(0.02)
        assert source.n_asked == 5
        assert reader.backlog == sum(map(len, PACKETS[:5]))
        for k in range(6, 20):
            next(reader)
            until(lambda k=k: source.n_yielded == k)
        time.sleep(0.02)
        assert source.n_asked == 19
        assert b"".join(packet.tobytes() for packet in reader) == np.concatenate(PACKETS[14:]).tobytes()


def test_max_events_holds_the_source_back_too():
    packets = [EVENTS[k : k + 100] for k in range(0, 2000, 100)]
    source = Source(packets)
    with BackgroundReader(source, max_events=250) as reader:
        until(lambda: source.n_yielded == 3)
        time.sleep(0.02)
        assert source.n_asked == 3
        next(reader)
        until(lambda: source.n_yielded == 4)
        assert len(list(reader)) == 19


def test_a_packet_larger_than_max_events_passes_alone():
    for latest in (False, True):
        with BackgroundReader([EVENTS], max_events=10, latest=latest) as reader:
            assert [len(packet) for packet in reader] == [10_000]
        assert reader.n_skipped == 0


@pytest.mark.parametrize("limits", [{"max_packets": 4}, {"max_packets": 64, "max_events": 1000}])
def test_latest_discards_the_oldest(limits):
    packets = [EVENTS[k : k + 250] for k in range(0, 5000, 250)]
    source = Source(packets, gate_at=20)
    with BackgroundReader(source, latest=True, **limits) as reader:
        until(lambda: source.n_asked == 21)
        assert (reader.backlog, reader.n_skipped) == (1000, 4000)
        assert next(reader).tobytes() == packets[16].tobytes()
        source.gate.set()
        assert [packet.tobytes() for packet in reader] == [packet.tobytes() for packet in packets[17:]]
        counters = reader.counters
    assert (counters.received, counters.handed_out, counters.skipped, counters.backlog) == (5000, 1000, 4000, 0)
    assert (counters.packets_received, counters.packets_handed_out, counters.packets_skipped) == (20, 4, 16)


@pytest.mark.parametrize("seed", range(20))
def test_received_is_handed_out_and_skipped_and_waiting_at_any_moment(seed):
    rng = np.random.default_rng(seed)
    source = Source(PACKETS * 10)
    handed_out = 0
    with BackgroundReader(source, latest=True, max_packets=int(rng.integers(1, 8))) as reader:
        for number, packet in enumerate(reader):
            handed_out += len(packet)
            now = reader.counters
            assert now.received == now.handed_out + now.skipped + now.backlog
            assert now.packets_received == now.packets_handed_out + now.packets_skipped + now.packets_waiting
            assert now.handed_out == handed_out and now.packets_handed_out == number + 1
            if rng.random() < 0.2:
                time.sleep(0.0005)
    now = reader.counters
    assert now.received == source.n_events == 100_000 == handed_out + now.skipped
    assert now.backlog == now.packets_waiting == 0


def test_the_newest_packet_always_arrives():
    for _ in range(50):
        *_, last = BackgroundReader(PACKETS, latest=True, max_packets=1)
        assert last.tobytes() == PACKETS[-1].tobytes()


def test_delay_is_the_age_of_what_was_handed_out():
    source = Source(PACKETS, gate_at=2)
    with BackgroundReader(source) as reader:
        assert reader.delay_us == 0
        until(lambda: source.n_asked == 3)
        time.sleep(0.02)
        next(reader)
        assert 20_000 <= reader.counters.waited_us <= reader.delay_us
        before = reader.delay_us
        time.sleep(0.005)
        assert reader.delay_us >= before + 5_000
        assert reader.counters.longest_wait_us == reader.counters.waited_us
        source.gate.set()
    assert reader.counters.longest_wait_us >= 20_000


@pytest.mark.parametrize("latest", [False, True])
@pytest.mark.parametrize("error", [ValueError("cable out"), OSError(19, "gone"), KeyError("x"), SystemExit(3)])
def test_an_error_of_the_source_comes_after_the_packets_before_it(latest, error):
    source = Source(PACKETS[:7], error=error)
    with BackgroundReader(source, latest=latest) as reader:
        got = []
        with pytest.raises(type(error)) as raised:
            for packet in reader:
                got.append(packet)
        assert raised.value is error and len(got) == 7
        assert list(reader) == []  # once; then it has ended


def test_an_error_before_the_first_packet():
    class Broken:
        def __iter__(self):
            raise RuntimeError("no camera")

    with BackgroundReader(Broken()) as reader, pytest.raises(RuntimeError, match="no camera"):
        next(reader)


def test_packets_outlive_the_memory_they_came_in():
    def driver():
        buffer = np.empty(250, EVENTS.dtype)
        for k in range(0, 10_000, 250):
            buffer[:] = EVENTS[k : k + 250]
            yield buffer
            buffer["x"] = 0

    assert np.concatenate(list(BackgroundReader(driver()))).tobytes() == EVENTS.tobytes()
    shared = np.concatenate(list(BackgroundReader(driver(), copy=False)))
    assert not shared["x"].any()  # what copying is for


# -- closing ---------------------------------------------------------------------------------------------


def test_closing_while_the_thread_waits_for_room():
    for _ in range(200):
        source = Source(PACKETS)
        reader = BackgroundReader(source, max_packets=2)
        until(lambda source=source: source.n_yielded == 2)
        assert reader.close()
        assert list(reader) == [] and reader.close()
        counters = reader.counters
        assert counters.received == counters.skipped == source.n_events and counters.backlog == 0


def test_closing_at_any_moment_accounts_for_every_event():
    rng = np.random.default_rng(5)
    for k in range(400):
        source = Source(PACKETS)
        reader = BackgroundReader(source, max_packets=3, latest=bool(k % 2))
        handed_out = sum(len(next(reader, ())) for _ in range(rng.integers(0, 45)))
        if k % 3 == 0:
            time.sleep(rng.random() * 2e-4)
        assert reader.close()
        counters = reader.counters
        assert counters.received == source.n_events == handed_out + counters.skipped
        assert counters.handed_out == handed_out and counters.backlog == 0
        assert next(reader, None) is None


def test_closing_from_another_thread_ends_the_loop():
    for _ in range(100):
        source = Source(PACKETS, gate_at=3)
        reader = BackgroundReader(source, on_close=source.gate.set)
        closer = threading.Timer(0.001, reader.close)
        closer.start()
        assert len(list(reader)) <= 3
        closer.join()
        assert reader.close()


def test_closing_wakes_a_source_that_waits_forever():
    gone = threading.Event()

    def camera():
        yield EVENTS
        gone.wait()
        raise OSError("the device was closed")

    with BackgroundReader(camera(), on_close=gone.set) as reader:
        next(reader)
    assert next(reader, None) is None  # the error that closing caused is not raised
    assert reader.close()


def test_closing_says_when_the_source_does_not_come_back():
    source = Source(PACKETS, gate_at=1)
    reader = BackgroundReader(source)
    until(lambda: source.n_asked == 2)
    assert not reader.close(timeout_s=0.01)
    assert list(reader) == []
    source.gate.set()
    assert reader.close(timeout_s=5)


def test_closing_from_within_the_source():
    made = threading.Event()
    answers = []

    def camera():
        made.wait()
        yield EVENTS
        answers.append(reader.close())  # its own thread is not waited for
        yield EVENTS

    reader = BackgroundReader(camera())
    made.set()
    assert len(list(reader)) <= 1
    until(lambda: answers)
    assert answers == [False] and reader.close()


def test_a_forgotten_reader_stops():
    for _ in range(50):
        for _ in BackgroundReader(PACKETS, max_packets=1):
            break
    gc.collect()  # the fixture sees that no thread is left


def test_a_failing_on_close_still_stops_the_thread():
    reader = BackgroundReader(PACKETS, max_packets=1, on_close=lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        reader.close()
    assert not threads() and reader.close()


# -- arguments -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings, error, message",
    [
        ({"max_packets": 0}, ValueError, "`max_packets` must be at least 1, got 0"),
        ({"max_packets": 2.5}, TypeError, "`max_packets` must be a whole number, got 2.5"),
        ({"max_packets": True}, TypeError, "`max_packets` must be a whole number, got True"),
        ({"max_events": -1}, ValueError, "`max_events` must be at least 1, got -1"),
        ({"source": 7}, TypeError, "`source` must be an iterable of packets, got int"),
        ({"source": "a.bin"}, TypeError, r"`source` must yield events, got the path a.bin; open_recording\(path\)"),
    ],
)
def test_wrong_arguments(settings, error, message):
    with pytest.raises(error, match=f"^{message}"):
        BackgroundReader(**({"source": PACKETS} | settings))


def test_an_asynchronous_source_needs_no_reader():
    async def camera():
        yield EVENTS

    with pytest.raises(TypeError, match="`source` is asynchronous already: pass it to `astream` directly"):
        BackgroundReader(camera())


def test_what_it_says_of_itself():
    source = Source(PACKETS[:1], gate_at=1)
    with BackgroundReader(source) as reader:
        until(lambda: source.n_asked == 2)
        assert repr(reader) == f"BackgroundReader(PacketQueue(open, {len(PACKETS[0])} events waiting, 0 skipped))"
        source.gate.set()
        list(reader)
        assert repr(reader) == "BackgroundReader(PacketQueue(ended, 0 events waiting, 0 skipped))"
    assert repr(reader) == "BackgroundReader(PacketQueue(closed, 0 events waiting, 0 skipped))"
