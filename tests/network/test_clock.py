"""One clock repair for cameras and the network: jumps are dropped until eight packets agree, and times go on."""

import threading
import time

import numpy as np
import pytest
from cameras.made_devices import RECORD
from hypothesis import given, settings
from hypothesis import strategies as st
from made import events_of, random_events

from async_tnt import EVENT_DTYPE, Processor, TNTConfig
from async_tnt.kernels.clock import AGREEING_PACKETS, BACK_US, LATEST_START_US, REORDERED_US
from async_tnt.sources.clock import Clock
from async_tnt.sources.datagrams import EVENT_BYTES, Decoder, encode
from async_tnt.sources.udp import UdpSource
from async_tnt.sources.udp_sender import UdpSender

JUMP_S = 10.0
JUMP_US = 10_000_000
MINUTE_US = 60_000_000
HOUR_US = 60 * MINUTE_US
N = AGREEING_PACKETS
TIMED = ("t64_x16_y16_on8", "t32_x16_y15_on1", "spif_t32")
FORMATS = tuple(EVENT_BYTES)
DV = np.dtype({"names": ["timestamp", "x"], "formats": ["<i8", "<i2"], "offsets": [0, 8], "itemsize": 16})


def at(*times):
    """Events at these times, all at one pixel."""
    n = len(times)
    return events_of(times, [1] * n, [2] * n, [1] * n)


def flat(packets):
    return [t for times in packets for t in times]


def by_camera(dtype, max_jump_s):
    clock = Clock(max_jump_s)
    field = dtype.names[0]

    def repair(times, arrival_us):
        events = np.zeros(len(times), dtype)
        events[field], events["x"] = times, range(len(times))
        kept = clock(events, field, arrival_us)
        assert np.all(np.diff(kept["x"]) > 0)  # whole records moved, in their order
        return kept[field].tolist()

    return repair, clock


def by_network(format, max_jump_s):
    decoder = Decoder(format, max_jump_s=max_jump_s)
    return lambda times, arrival_us: decoder.decode(encode(at(*times), format), arrival_us).events["t"].tolist(), (
        decoder.clock
    )


class Repaired:
    """The times that are kept of packets, and their clock."""

    def __init__(self, way, kind):
        self._way, self._kind = way, kind

    def __call__(self, packets, arrivals=None, max_jump_s=JUMP_S):
        repair, self.clock = self._way(self._kind, max_jump_s)
        return [repair(times, 0 if arrivals is None else arrivals[k]) for k, times in enumerate(packets)]

    @property
    def counts(self):
        return self.clock.jumped, self.clock.late, self.clock.restarts


@pytest.fixture(
    params=[(by_camera, RECORD), (by_camera, DV), *((by_network, format) for format in TIMED)],
    ids=["unsigned", "signed", *TIMED],
)
def repaired(request):
    return Repaired(*request.param)


@pytest.mark.parametrize(
    ("times", "arrival_us", "kept"),
    [
        ([MINUTE_US + JUMP_US], 0, True),
        ([MINUTE_US + JUMP_US + 1], 0, False),
        ([MINUTE_US - BACK_US], 0, True),
        ([MINUTE_US - BACK_US - 1], 0, False),
        ([MINUTE_US + 3 * JUMP_US], 2 * JUMP_US, True),  # a pause by both clocks
        ([MINUTE_US + 3 * JUMP_US + 1], 2 * JUMP_US, False),
        ([MINUTE_US - BACK_US // 4], 3 * BACK_US // 4, True),
        ([MINUTE_US - BACK_US // 4 - 1], 3 * BACK_US // 4, False),  # sent again
        ([MINUTE_US - REORDERED_US], 2 * JUMP_US, True),
        ([MINUTE_US - REORDERED_US - 1], 2 * JUMP_US, False),
    ],
)
def test_the_bounds_by_hand(repaired, times, arrival_us, kept):
    assert repaired([[MINUTE_US], times], [0, arrival_us]) == [[MINUTE_US], times if kept else []]
    assert repaired.counts == (not kept, kept and times[0] < MINUTE_US, 0)


@pytest.mark.parametrize("place", range(4))
def test_one_garbled_time_costs_its_event_and_no_more(repaired, place):
    """Also in the first packet, and whatever follows."""
    for number in range(3):
        packets = [[MINUTE_US + 10 * k + i for i in range(3)] for k in range(3)]
        garbled = [list(times) for times in packets]
        garbled[number].insert(place, MINUTE_US + 20 * MINUTE_US)
        assert repaired(garbled) == packets and repaired.counts == (1, 0, 0)


def test_a_clock_that_moved_ahead_keeps_its_times(repaired):
    moved = [[15 * MINUTE_US + k, 15 * MINUTE_US + k] for k in range(N + 2)]
    assert repaired([[5], *moved]) == [[5], *[[]] * (N - 1), *moved[N - 1 :]]
    assert repaired.counts == (2 * (N - 1), 0, 0)


def test_a_clock_that_starts_again_goes_on(repaired):
    again = [[k, 10 + k] for k in range(N + 1)]
    went_on = [[MINUTE_US, MINUTE_US + 10], [MINUTE_US + 1, MINUTE_US + 11]]
    assert repaired([[MINUTE_US], *again]) == [[MINUTE_US], *[[]] * (N - 1), *went_on]
    assert repaired.counts == (2 * (N - 1), 1, 1)
    ahead = [[5 * MINUTE_US + k] for k in range(N)]  # and ahead after that
    assert repaired([[MINUTE_US], *[[0]] * N, *ahead])[-1] == [6 * MINUTE_US + N - 1]
    six_times = ([[MINUTE_US * k // 10] for k in range(11)] + [[MINUTE_US + k] for k in range(5)]) * 6
    times = flat(repaired(six_times))
    assert times == sorted(times) and repaired.counts == (5 * (N - 1), 0, 5)


def test_a_clock_that_wraps_goes_on():
    """Of 24 bits, say; those of 32 bits are unwrapped before."""
    repaired = Repaired(by_camera, RECORD)
    packets = [[t % 2**24] for t in range(2**24 - 5000, 2**24 + 20_000, 1000)]
    times = flat(repaired(packets))
    assert np.diff(times).tolist() == [1000] * 4 + [0] + [1000] * (20 - N)
    assert repaired.counts == (N - 1, 0, 1)


def test_a_recording_sent_again_is_recognised_by_the_time_that_passed(repaired):
    """Of 0.3 s, after 5 s: less than a second behind the first, but it comes 5 s after it."""
    once = [[1000 * k] for k in range(300)]
    for pause_us, restarts in ((5_000_000, 1), (BACK_US - 600_000, 0)):
        arrivals = [*range(0, 300_000, 1000), *range(300_000 + pause_us, 600_000 + pause_us, 1000)]
        got = repaired(once + once, arrivals)
        assert repaired.clock.restarts == restarts
        if restarts:
            assert repaired.clock.jumped == N - 1 and got[-1] == [299_000 + 299_000 - (N - 1) * 1000]


def test_a_slow_clock_is_no_jump(repaired):
    packets = [[5 + k] for k in range(20)]
    assert repaired(packets, [k * HOUR_US for k in range(20)]) == packets and repaired.counts == (0, 0, 0)


@pytest.mark.parametrize("elsewhere", [0, 30 * MINUTE_US])
def test_one_packet_of_the_old_stream_ends_the_vote(repaired, elsewhere):
    packets = [[MINUTE_US + k] if k % N == 0 else [elsewhere + k] for k in range(10 * N)]
    assert repaired(packets) == [times if k % N == 0 else [] for k, times in enumerate(packets)]
    both = [[MINUTE_US], *[[elsewhere]] * (N - 1), [elsewhere, MINUTE_US + 6], *[[elsewhere]] * (N - 1)]
    assert flat(repaired(both)) == [MINUTE_US, MINUTE_US + 6]


def test_packets_that_disagree_are_never_followed(repaired):
    minutes = np.random.default_rng(0).permutation(np.arange(1, 30))
    assert flat(repaired([[5], *([int(k) * MINUTE_US] for k in minutes)])) == [5]
    assert flat(repaired([[MINUTE_US], *[[0], [2 * MINUTE_US]] * N])) == [MINUTE_US]
    assert flat(repaired([[5], [20 * MINUTE_US] * 1000, [6]])) == [5, 6]  # one packet, one vote


def test_a_stream_starts_at_the_oldest_event_of_its_first_packet(repaired):
    assert repaired([[9, 5, 5 + JUMP_US, 6 + JUMP_US]]) == [[9, 5, 5 + JUMP_US]]
    assert repaired.counts == (1, 1, 0)


def test_a_stream_starts_before_the_year_2100():
    for repaired in (Repaired(by_camera, DV), Repaired(by_network, TIMED[0])):
        start = LATEST_START_US - 9
        assert repaired([[2**62 - 1], [LATEST_START_US + 1], [start]]) == [[], [], [start]]
        nanoseconds = [[2**61 + k] for k in range(N)]  # perhaps; one stream is followed all the same
        assert repaired(nanoseconds) == [*[[]] * (N - 1), nanoseconds[-1]]


def test_times_that_no_clock_shows_are_dropped_and_vote_for_nothing():
    repaired = Repaired(by_camera, DV)
    assert flat(repaired([[5], *[[-1, 2**62, -(2**63)]] * 2 * N, [6, -1, 7]])) == [5, 6, 7]
    far = 2**61
    packets = [[far]] * N + [[0]] * N + [[far - 1]] * N + [[far]]
    assert repaired(packets)[N - 1 :: N] == [[far], [far], [2**62 - 1]]  # the last one would go on beyond
    unsigned = Repaired(by_camera, RECORD)
    assert unsigned([[5, 2**63 + 6, 7]]) == [[5, 7]]


def test_without_a_bound_times_stay_what_they_are(repaired):
    packets = [[MINUTE_US], *[[k] for k in range(3 * N)], [30 * MINUTE_US, 5]]
    assert repaired(packets, max_jump_s=None) == packets and repaired.counts == (0, 3 * N + 1, 0)


def test_nothing_is_copied():
    events = np.zeros(3, RECORD)
    assert Clock(1)(events, "t", 0) is events
    events["t"][1] = HOUR_US
    assert Clock(1)(events, "t", 0).base is events
    with pytest.raises(TypeError, match="the field `x` must be a time of 64 bits"):
        Clock(1)(events, "x", 0)


@pytest.mark.parametrize("max_jump_s", [0, -1, float("nan"), float("inf")])
def test_a_wrong_bound(max_jump_s):
    with pytest.raises(ValueError, match="`max_jump_s` must be a positive number of seconds, or None, got"):
        UdpSource(port=0, max_jump_s=max_jump_s)


@given(
    packets=st.lists(st.lists(st.integers(0, 40 * MINUTE_US), max_size=6), max_size=40),
    passed=st.lists(st.integers(0, 3 * JUMP_US), min_size=40, max_size=40),
)
def test_times_never_fall_far_and_every_event_is_counted(packets, passed):
    repaired = Repaired(by_camera, RECORD)
    kept = repaired(packets, np.cumsum(passed).tolist())
    newest = late = 0
    for times in kept:
        assert not times or min(times) >= newest - BACK_US
        for t in times:
            late += t < newest
            newest = max(newest, t)
    assert repaired.clock.jumped + len(flat(kept)) == len(flat(packets)) and repaired.clock.late == late


@settings(max_examples=200)
@given(
    starts=st.lists(st.integers(0, 4 * MINUTE_US), min_size=1, max_size=4),
    first=st.integers(0, LATEST_START_US),
    kind=st.sampled_from([(by_camera, RECORD), *((by_network, format) for format in TIMED)]),
)
def test_after_anything_one_stream_is_heard_again(starts, first, kind):
    """The last of the streams goes on, in order and at its own pace."""
    length = 4 * N  # 3 s: a fall by less than a second, which is no jump, is caught up with
    packets = [[first]] + [[start + k * 100_000] for start in starts for k in range(length)]
    repaired = Repaired(*kind)
    got = flat(repaired(packets))
    assert len(got) + repaired.clock.jumped == len(packets)
    assert np.diff(got[-N:]).tolist() == [100_000] * (N - 1) and got[-1] >= max(got)


@settings(max_examples=200)
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
    events = np.concatenate([np.empty(0, EVENT_DTYPE), *(part.events for part in parts)])
    assert events.tobytes() == np.concatenate(batches).tobytes()
    assert in_two.malformed == one_by_one.malformed == sum(part.malformed for part in parts)
    assert in_two.clock.state.tolist() == one_by_one.clock.state.tolist()
    assert one_by_one.clock.jumped + one_by_one.off_sensor <= one_by_one.malformed
    assert len(events) + one_by_one.malformed == sum(map(len, whole)) // size
    newest_before = np.maximum.accumulate(np.concatenate(([-1], events["t"])))[:-1]
    assert one_by_one.clock.late == (events["t"] < newest_before).sum()


@pytest.mark.parametrize("format", FORMATS)
def test_thousands_of_random_datagrams_through_a_socket(format):
    rng = np.random.default_rng(1)
    n_bytes = n_places = n_events = 0
    with UdpSource(port=0, format=format, sensor=(34, 34)) as source, UdpSender(port=source.port) as sender:
        for k in range(3000):
            datagram = rng.bytes(int(rng.integers(0, 300)))
            if k % 3 == 0:  # good ones with one wrong bit
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


def decided(send, max_jump_s=10.0):
    """The windows' numbers of events, of what is sent, and the counts."""
    config = TNTConfig(window_us=10_000)
    processor = Processor(config, classifier=lambda volume: [float(volume.sum()), 1.0])
    decisions = []
    with UdpSource(port=0, max_jump_s=max_jump_s) as source, UdpSender(port=source.port) as sender:
        sending = threading.Thread(target=send, args=(sender,))
        sending.start()
        while sending.is_alive() or source.counts.datagrams + (source.counts.lost or 0) < sender.datagrams:
            decisions += processor.push(source.receive(0.05))
        decisions += processor.finish()
        return [decision.events for decision in decisions], source.counts, source.summary()


def test_one_forged_datagram_does_not_silence_a_processor():
    """Without the bound it does: the last decision is that of the window before."""
    events = random_events(2500, duration_us=50_000)
    expected = [int(((events["t"] - events["t"][0]) // 10_000 == k).sum()) for k in range(5)]

    def send(sender):
        sender.send(events[:1200])
        sender.send(at(HOUR_US))
        sender.send(events[1200:])

    windows, counts, _ = decided(send)
    assert windows == expected and counts.jumped == counts.malformed == 1
    windows, counts, _ = decided(send, None)
    assert windows[:2] == expected[:2] and len(windows) < 5 and counts.malformed == 0


def test_a_first_event_of_the_year_2065_silences_nobody():
    """Without the bound it does: all else is older than the window that it opened."""

    def send(sender):
        sender.send(at(3_000_000_000_000_000))
        sender.send(random_events(4000, duration_us=80_000))

    windows, counts, summary = decided(send)
    assert sum(windows) == counts.events == 4001 - (N - 1) * 100 and counts.clock_restarts == 1
    assert summary.endswith(", clock restarts: 1)")
    windows, counts, summary = decided(send, None)
    assert windows == [1] and counts.events == 4001 and "restarts" not in summary


def test_a_recording_sent_twice_is_decided_twice():
    events = random_events(4000, duration_us=80_000)

    def send(sender):
        sender.send(events)
        time.sleep(BACK_US / 1e6 + 0.2)
        sender.send(events)

    windows, counts, _ = decided(send)
    assert sum(windows) == counts.events == 8000 - (N - 1) * 100
    assert counts.jumped == (N - 1) * 100 and counts.clock_restarts == 1
