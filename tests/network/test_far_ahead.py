"""Times far ahead of the stream: one is left out, a stream that has moved is followed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import events_of, random_events

from async_tnt import EVENT_DTYPE, Processor, TNTConfig
from async_tnt.kernels.datagrams import FOLLOW_AFTER, LATEST_START_US
from async_tnt.sources.datagrams import EVENT_BYTES, Decoder, encode
from async_tnt.sources.udp import UdpSource
from async_tnt.sources.udp_sender import UdpSender

JUMP_S = 10.0
JUMP_US = 10_000_000
HOUR_US = 3_600_000_000
TIMED = ("t64_x16_y16_on8", "t32_x16_y15_on1", "spif_t32")
FORMATS = tuple(EVENT_BYTES)


def at(*times):
    """Events at these times, all at one pixel."""
    n = len(times)
    return events_of(times, [1] * n, [2] * n, [1] * n)


def decoded(decoder, datagrams, arrivals=None):
    """The times handed on of each datagram."""
    return [
        decoder.decode(encode(datagram, decoder.format), 0 if arrivals is None else arrivals[k]).events["t"].tolist()
        for k, datagram in enumerate(datagrams)
    ]


@pytest.mark.parametrize("format", TIMED)
def test_the_bound_by_hand(format):
    decoder = Decoder(format, max_jump_s=JUMP_S)
    datagrams = [at(5), at(5 + JUMP_US), at(6 + 2 * JUMP_US), at(5 + 2 * JUMP_US)]
    assert decoded(decoder, datagrams) == [[5], [5 + JUMP_US], [], [5 + 2 * JUMP_US]]
    assert (decoder.ahead, decoder.malformed, decoder.late) == (1, 1, 0)


@pytest.mark.parametrize("format", TIMED)
def test_one_event_hours_ahead_within_a_datagram_is_left_out(format):
    ahead_us = 20 * 60 * 1_000_000  # of 32 bits, no more than 36 minutes can be told from the past
    decoder = Decoder(format, max_jump_s=JUMP_S)
    assert decoded(decoder, [at(5, 6, ahead_us, 7), at(8)]) == [[5, 6, 7], [8]]
    assert (decoder.ahead, decoder.late) == (1, 0)


def test_a_pause_is_no_jump():
    """A still camera: no events for an hour, by both clocks."""
    decoder = Decoder(max_jump_s=JUMP_S)
    arrivals = [0, HOUR_US, 2 * HOUR_US]
    datagrams = [at(7), at(7 + HOUR_US + JUMP_US), at(8 + 2 * HOUR_US + 2 * JUMP_US)]
    assert decoded(decoder, datagrams, arrivals) == [[7], [7 + HOUR_US + JUMP_US], []]  # by a microsecond


@pytest.mark.parametrize("format", TIMED)
def test_a_stream_that_has_moved_is_followed(format):
    moved_us = 15 * 60 * 1_000_000
    decoder = Decoder(format, max_jump_s=JUMP_S)
    datagrams = [at(5), *(at(moved_us + k, moved_us + k) for k in range(FOLLOW_AFTER + 2))]
    got = decoded(decoder, datagrams)
    assert got[:FOLLOW_AFTER] == [[5]] + [[]] * (FOLLOW_AFTER - 1)
    assert got[FOLLOW_AFTER:] == [[moved_us + k] * 2 for k in range(FOLLOW_AFTER - 1, FOLLOW_AFTER + 2)]
    assert decoder.ahead == decoder.malformed == 2 * (FOLLOW_AFTER - 1)


def test_a_moving_stream_is_not_followed_while_the_old_one_goes_on():
    decoder = Decoder(max_jump_s=JUMP_S)
    datagrams = [at(k) if k % FOLLOW_AFTER == 0 else at(HOUR_US + k) for k in range(20 * FOLLOW_AFTER)]
    assert [t for times in decoded(decoder, datagrams) for t in times] == list(
        range(0, 20 * FOLLOW_AFTER, FOLLOW_AFTER)
    )


def test_a_datagram_of_the_old_stream_has_no_vote_though_it_ends_ahead():
    decoder = Decoder(max_jump_s=JUMP_S)
    datagrams = [at(5), *[at(HOUR_US)] * (FOLLOW_AFTER - 1), at(6, HOUR_US), at(7, HOUR_US)]
    assert decoded(decoder, datagrams) == [[5], *[[]] * (FOLLOW_AFTER - 1), [6], [7]]


def test_datagrams_that_disagree_are_never_followed():
    times = np.random.default_rng(0).permutation(np.arange(1, 200)) * HOUR_US
    decoder = Decoder(max_jump_s=JUMP_S)
    assert decoded(decoder, [at(5), *map(at, times)]) == [[5]] + [[]] * len(times)
    full = events_of(np.full(5000, HOUR_US), [0] * 5000, [0] * 5000, [0] * 5000)  # one datagram, one vote
    assert decoded(decoder, [full, at(6)]) == [[], [6]]


def test_garbage_before_the_stream_does_not_set_the_clock():
    decoder = Decoder(max_jump_s=JUMP_S)
    assert decoded(decoder, [at(2**62 - 1), at(LATEST_START_US + 1), at(LATEST_START_US - 9)]) == [
        [],
        [],
        [LATEST_START_US - 9],
    ]
    late_start = Decoder(max_jump_s=JUMP_S)  # nanoseconds, perhaps: if it is one stream, it is followed all the same
    assert decoded(late_start, [at(2**61 + k) for k in range(FOLLOW_AFTER)])[-1] == [2**61 + FOLLOW_AFTER - 1]


@pytest.mark.parametrize("max_jump_s", [0, -1, float("nan"), float("inf")])
def test_a_wrong_bound(max_jump_s):
    with pytest.raises(ValueError, match="`max_jump_s` must be a positive number of seconds, or None, got"):
        UdpSource(port=0, max_jump_s=max_jump_s)


def test_one_forged_datagram_does_not_silence_a_processor():
    """Without the bound it does: the last decision is that of the window before."""
    events = random_events(2500, duration_us=50_000)
    config = TNTConfig(window_us=10_000)

    def n_windows(max_jump_s):
        processor = Processor(config, classifier=lambda volume: [float(volume.sum()), 1.0])
        with UdpSource(port=0, timeout_s=0.15, max_jump_s=max_jump_s) as source, UdpSender(port=source.port) as sender:
            sender.send(events[:1200])
            sender.send(at(HOUR_US))
            sender.send(events[1200:])
            decisions = [decision for packet in source for decision in processor.push(packet)]
            assert source.counts.ahead == (max_jump_s is not None) == source.counts.malformed
            return [decision.events for decision in decisions + processor.finish()]

    expected = [int(((events["t"] - events["t"][0]) // 10_000 == k).sum()) for k in range(5)]
    assert n_windows(10.0) == expected
    assert n_windows(None)[:2] == expected[:2] and len(n_windows(None)) < 5


@settings(max_examples=300)
@given(
    datagrams=st.lists(
        st.one_of(
            st.binary(max_size=90),
            st.lists(st.integers(0, 2**63 - 1), min_size=1, max_size=5).map(lambda t: at(*t).tobytes()),
            st.lists(st.integers(0, 1000), min_size=1, max_size=5).map(lambda t: at(*t).tobytes()),
        ),
        max_size=30,
    ),
    format=st.sampled_from(FORMATS),
    bound=st.sampled_from([None, JUMP_S]),
    cut=st.integers(0, 30),
)
def test_any_datagrams_are_counted_to_the_event_however_they_are_batched(datagrams, format, bound, cut):
    size = EVENT_BYTES[format]
    whole = [datagram[: len(datagram) // size * size] for datagram in datagrams]
    one_by_one, in_two = Decoder(format, (34, 34), bound), Decoder(format, (34, 34), bound)
    parts = [one_by_one.decode(datagram) for datagram in whole]
    batches = [
        in_two.decode_datagrams(
            np.frombuffer(b"".join(batch), np.uint8),
            np.cumsum([0] + [len(d) // size for d in batch])[1:],
            np.zeros(len(batch), np.int64),
            len(batch),
        )
        for batch in (whole[:cut], whole[cut:])
    ]
    empty = np.empty(0, EVENT_DTYPE)
    events = np.concatenate([empty, *(part.events for part in parts)])
    assert events.tobytes() == np.concatenate(batches).tobytes()
    assert in_two.malformed == one_by_one.malformed == sum(part.malformed for part in parts)
    assert in_two.ahead == one_by_one.ahead <= one_by_one.malformed
    assert len(events) + one_by_one.malformed == sum(map(len, whole)) // size
    newest_before = np.maximum.accumulate(np.concatenate(([-1], events["t"])))[:-1]
    assert one_by_one.late == (events["t"] < newest_before).sum()


@pytest.mark.parametrize("format", FORMATS)
def test_thousands_of_random_datagrams_through_a_socket(format):
    rng = np.random.default_rng(1)
    n_bytes = n_places = n_events = 0
    with UdpSource(port=0, format=format, sensor=(34, 34)) as source, UdpSender(port=source.port) as sender:
        for k in range(3000):
            datagram = rng.bytes(int(rng.integers(0, 300)))
            if k % 3 == 0:  # good ones, with a byte fallen over
                good = bytearray(encode(at(*range(k, k + 9)), format))
                good[int(rng.integers(len(good)))] ^= 1 << int(rng.integers(8))
                datagram = bytes(good)
            sender._socket.send(datagram)
            n_bytes += len(datagram)
            n_places += -(-len(datagram) // EVENT_BYTES[format])
            if k % 20 == 19:
                while (packet := source.receive(0)) is not None or source.counts.bytes < n_bytes:
                    if packet is not None:
                        n_events += len(packet)
                        assert (packet["x"] < 34).all() and (packet["y"] < 34).all() and (packet["p"] <= 1).all()
                        if format != "spif":
                            assert packet["t"].max() < HOUR_US  # the stream was never led astray
        counts = source.counts
    assert counts.datagrams == 3000 and counts.bytes == n_bytes and counts.lost in (0, None)
    assert counts.events == n_events > 5000 and counts.events + counts.malformed == n_places
