"""Streams whose times fall back: they are followed, and their times go on."""

import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import events_of, random_events

from async_tnt import Processor, TNTConfig, stream
from async_tnt.kernels.datagrams import FALL_US, FOLLOW_AFTER, LATEST_START_US
from async_tnt.sources.datagrams import Decoder, encode
from async_tnt.sources.udp import UdpSource
from async_tnt.sources.udp_sender import UdpSender

JUMP_S = 10.0
MINUTE_US = 60_000_000
TIMED = ("t64_x16_y16_on8", "t32_x16_y15_on1", "spif_t32")


def at(*times):
    """Events at these times, all at one pixel."""
    n = len(times)
    return events_of(times, [1] * n, [2] * n, [1] * n)


def decoded(decoder, datagrams, arrivals=None):
    """The times handed on of each datagram."""
    return [
        decoder.decode(encode(at(*times), decoder.format), 0 if arrivals is None else arrivals[k]).events["t"].tolist()
        for k, times in enumerate(datagrams)
    ]


@pytest.mark.parametrize("format", TIMED)
def test_a_sender_that_starts_anew_goes_on_by_hand(format):
    decoder = Decoder(format, max_jump_s=JUMP_S)
    datagrams = [[MINUTE_US], *[[k, 10 + k] for k in range(FOLLOW_AFTER + 1)]]
    last = FOLLOW_AFTER - 1
    assert decoded(decoder, datagrams) == [
        [MINUTE_US],
        *[[k, 10 + k] for k in range(last)],  # handed on as they are, and late
        [MINUTE_US, MINUTE_US + 10],
        [MINUTE_US + 1, MINUTE_US + 11],
    ]
    assert (decoder.restarts, decoder.late, decoder.malformed) == (1, 2 * last + 1, 0)


@pytest.mark.parametrize("format", TIMED)
def test_the_bound_by_hand(format):
    """A second behind is out of order, however often; a microsecond more is a restart."""
    for behind_us, restarts in ((FALL_US, 0), (FALL_US + 1, 1)):
        decoder = Decoder(format, max_jump_s=JUMP_S)
        decoded(decoder, [[MINUTE_US], *[[MINUTE_US - behind_us]] * FOLLOW_AFTER])
        assert decoder.restarts == restarts


def test_the_time_that_passed_here_counts_too():
    """A recording of 0.3 s sent again 5 s later: less than a second behind the first, but it comes 5 s after it."""
    again = [[k * 1000] for k in range(300)]
    for pause_us, restarts in ((5_000_000, 1), (FALL_US - 300_000, 0)):
        decoder = Decoder(max_jump_s=JUMP_S)
        arrivals = [*range(0, 300_000, 1000), *range(300_000 + pause_us, 600_000 + pause_us, 1000)]
        got = [t for times in decoded(decoder, again + again, arrivals) for t in times]
        assert decoder.restarts == restarts
        if restarts:
            assert decoder.late == FOLLOW_AFTER - 1 and got[-1] == 299_000 + 299_000 - (FOLLOW_AFTER - 1) * 1000


def test_a_pause_is_no_restart():
    decoder = Decoder(max_jump_s=JUMP_S)
    hour_us = 60 * MINUTE_US
    decoded(decoder, [[5 + k] for k in range(20)], [k * hour_us for k in range(20)])  # a clock that is much too slow
    assert decoder.restarts == decoder.late == decoder.malformed == 0


def test_a_datagram_of_the_stream_in_between_starts_the_count_anew():
    decoder = Decoder(max_jump_s=JUMP_S)
    datagrams = [[MINUTE_US + k] if k % FOLLOW_AFTER == 0 else [k] for k in range(20 * FOLLOW_AFTER)]
    assert decoded(decoder, datagrams) == datagrams and decoder.restarts == 0
    both = [[MINUTE_US, 5]] * 20  # one datagram of both
    assert decoded(Decoder(max_jump_s=JUMP_S), both) == both


def test_datagrams_that_disagree_are_never_followed():
    """Nor are those that are ahead and behind by turns."""
    times = (np.random.default_rng(0).permutation(np.arange(1, 200)) * MINUTE_US).tolist()
    decoder = Decoder(max_jump_s=JUMP_S)
    assert decoded(decoder, [[200 * MINUTE_US], *[[t] for t in times]])[1:] == [[t] for t in times]
    by_turns = Decoder(max_jump_s=JUMP_S)
    decoded(by_turns, [[MINUTE_US], *[[0], [2 * MINUTE_US]] * FOLLOW_AFTER])
    assert decoder.restarts == by_turns.restarts == 0 and by_turns.ahead == FOLLOW_AFTER


def test_many_restarts_never_run_backwards():
    decoder = Decoder(max_jump_s=JUMP_S)
    one = [[MINUTE_US * k // 10] for k in range(11)] + [[MINUTE_US + k] for k in range(5)]
    got = decoded(decoder, one * 6)
    newest = 0
    for k, times in enumerate(got):
        if k < len(one) or k % len(one) >= FOLLOW_AFTER - 1:
            assert times and times[0] >= newest
            newest = times[0]
    assert decoder.restarts == 5


def test_a_stream_that_moves_ahead_after_a_restart_is_followed_too():
    decoder = Decoder(max_jump_s=JUMP_S)
    moved = [[5 * MINUTE_US + k] for k in range(FOLLOW_AFTER)]
    got = decoded(decoder, [[MINUTE_US], *[[0]] * FOLLOW_AFTER, *moved])
    assert got[-1] == [6 * MINUTE_US + FOLLOW_AFTER - 1] and decoder.ahead == FOLLOW_AFTER - 1


def test_a_time_that_would_go_on_beyond_all_bounds_is_malformed():
    decoder = Decoder(max_jump_s=JUMP_S)
    far_us = 2**61
    decoded(decoder, [[far_us]] * FOLLOW_AFTER)
    assert decoded(decoder, [[0]] * FOLLOW_AFTER)[-1] == [far_us] and decoder.restarts == 1
    malformed = decoder.malformed
    assert decoded(decoder, [[far_us - 1]] * FOLLOW_AFTER)[-1] == [2**62 - 1]
    assert decoded(decoder, [[far_us]]) == [[]]
    assert decoder.malformed == malformed + FOLLOW_AFTER - 1 + 1


def test_without_a_bound_times_stay_what_they_are():
    decoder = Decoder(max_jump_s=None)
    datagrams = [[MINUTE_US], *[[k] for k in range(3 * FOLLOW_AFTER)]]
    assert decoded(decoder, datagrams) == datagrams and decoder.restarts == 0


@settings(max_examples=200)
@given(
    starts=st.lists(st.integers(0, 4 * MINUTE_US), min_size=1, max_size=4),
    first=st.integers(0, LATEST_START_US),
    cut=st.integers(0, 130),
    format=st.sampled_from(TIMED),
)
def test_after_whatever_one_stream_is_heard_again(starts, first, cut, format):
    """However it began, and in two batches as in one: the last of the streams goes on, in order and at its own pace."""
    length = 4 * FOLLOW_AFTER  # 3 s: a fall by less than a second, which is none, is caught up with
    times = [first] + [start + k * 100_000 for start in starts for k in range(length)]
    parts = [encode(at(t), format) for t in times]
    one_by_one, in_two = Decoder(format, max_jump_s=JUMP_S), Decoder(format, max_jump_s=JUMP_S)
    got = np.concatenate([one_by_one.decode(part).events for part in parts])
    batched = [
        in_two.decode_datagrams(
            np.frombuffer(b"".join(batch), np.uint8),
            np.arange(1, len(batch) + 1),
            np.zeros(len(batch), np.int64),
            len(batch),
        )
        for batch in (parts[:cut], parts[cut:])
    ]
    assert np.concatenate(batched).tobytes() == got.tobytes()
    assert len(got) + one_by_one.malformed == len(times)
    end = got["t"][-FOLLOW_AFTER:].astype(np.int64)
    assert (np.diff(end) == 100_000).all() and end[-1] >= got["t"].astype(np.int64).max()


def test_a_first_event_of_the_year_2065_silences_nobody():
    """Without the bound it does: all else is older than the window that it opened."""
    events = random_events(4000, duration_us=80_000)
    config = TNTConfig(window_us=10_000)

    def n_decided(max_jump_s):
        with UdpSource(port=0, timeout_s=0.15, max_jump_s=max_jump_s) as source, UdpSender(port=source.port) as sender:
            sender.send(at(3_000_000_000_000_000))
            sender.send(events)
            processor = Processor(config, classifier=lambda volume: [float(volume.sum()), 1.0])
            decisions = list(stream(source, processor))
            assert source.counts.events == 4001 and source.counts.clock_restarts == (max_jump_s is not None)
            assert source.summary().endswith(", clock restarts: 1)") == (max_jump_s is not None)
            return sum(decision.events for decision in decisions)

    assert n_decided(None) == 1
    assert n_decided(10.0) == 4001 - (FOLLOW_AFTER - 1) * 100


def test_a_recording_sent_twice_is_decided_twice():
    events = random_events(4000, duration_us=80_000)
    config = TNTConfig(window_us=10_000)
    with UdpSource(port=0, timeout_s=5) as source, UdpSender(port=source.port) as sender:
        processor = Processor(config, classifier=lambda volume: [float(volume.sum()), 1.0])

        def send_twice():
            sender.send(events)
            time.sleep(FALL_US / 1e6 + 0.2)
            sender.send(events)
            time.sleep(0.2)
            source.close()

        sending = threading.Thread(target=send_twice)
        sending.start()
        decisions = list(stream(source, processor))
        sending.join()
    assert sum(decision.events for decision in decisions) == 8000 - (FOLLOW_AFTER - 1) * 100
    assert source.counts.late >= (FOLLOW_AFTER - 1) * 100 and source.counts.clock_restarts == 1
