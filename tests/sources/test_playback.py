"""Playback at recording pace, on a made clock."""

import math

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt.sources import replay
from async_tnt.sources.files import playback

EVENTS = random_events(2500, duration_us=50_000, start_us=7_000_000)


class Clock:
    """Stands still, but for sleeping, which takes 150 us longer than asked."""

    now_ns = 123

    def monotonic_ns(self):
        return self.now_ns

    def sleep(self, seconds):
        assert seconds > 0
        self.now_ns += round(seconds * 1e9) + 150_000


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(playback, "time", clock)
    return clock


def at(*times):
    return events_of(times, [0] * len(times), [0] * len(times), [0] * len(times))


@pytest.mark.parametrize(("speed", "size"), [(0.5, 60), (1.0, 1), (7.0, 2500)])
def test_packets_come_when_they_are_due_without_drift(clock, speed, size):
    packets = [EVENTS[first : first + size] for first in range(0, len(EVENTS), size)]
    started_ns = clock.now_ns
    parts = []
    for packet in replay(packets, speed):
        due_ns = (int(packet["t"][-1]) - int(EVENTS["t"][0])) * 1000 / speed
        # late by one sleep, not by all of them
        assert 0 <= clock.now_ns - started_ns - due_ns + 1 <= 150_002
        assert packet["t"][-1] - packet["t"][0] < 1000
        parts.append(packet)
    assert np.concatenate(parts).tobytes() == EVENTS.tobytes()


@pytest.mark.parametrize(
    ("packets", "played"),
    [
        ([at(0, 5000, 100, 5100, 200, 9000)], [[0], [5000, 100, 5100, 200], [9000]]),
        ([at(0, 5000), at(100, 5100), at(200, 9000)], [[0], [5000], [100, 5100], [200], [9000]]),
        ([at(), at(5), at()], [[5]]),
        ([at()], []),
    ],
)
def test_an_event_out_of_order_is_due_with_the_newest_before(clock, packets, played):
    assert [packet["t"].tolist() for packet in replay(packets)] == played


@pytest.mark.parametrize("packet_us", [1, 300, 5_000, 10**9])
def test_a_packet_has_the_events_of_one_part_of_so_many_microseconds(clock, packet_us):
    packets = list(replay(EVENTS, math.inf, packet_us=packet_us))
    parts = (EVENTS["t"] - EVENTS["t"][0]) // packet_us
    assert [len(packet) for packet in packets] == np.unique(parts, return_counts=True)[1].tolist()
    assert np.concatenate(packets).tobytes() == EVENTS.tobytes() and clock.now_ns == 123


def test_no_pause_is_too_long_for_the_system(clock):
    """The system refuses to sleep for three centuries.

    A speed may make any pause longer, even infinitely long.
    """
    sleep = clock.sleep

    def sleep_if_possible(seconds):
        assert seconds <= 9e9, "too long"
        sleep(seconds)

    def stop(seconds):
        raise TimeoutError

    clock.sleep = sleep_if_possible
    two = [([0, 10**15], [1, 1], [1, 1], [1, 1])]
    assert [len(packet) for packet in replay(two, 0.1)] == [1, 1]
    packets = replay([at(0, 1000)], 1e-320)
    next(packets)
    clock.sleep = stop
    with pytest.raises(TimeoutError):
        next(packets)


@pytest.mark.parametrize(
    ("how", "message"),
    [
        (
            {"speed": math.nan},
            r"`speed` must be above 0 \(math.inf: as fast as possible\), got nan",
        ),
        ({"speed": 0}, r"`speed` must be above 0 \(math.inf: as fast as possible\), got 0"),
        ({"packet_us": 0}, "`packet_us` must be at least 1, got 0"),
    ],
)
def test_wrong_arguments_are_refused_at_once(how, message):
    with pytest.raises(ValueError, match=message):
        replay(EVENTS, **how)
