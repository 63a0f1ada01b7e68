"""The rule for clocks, once: jumps are dropped until eight packets agree, and times continue.

UDP applies it.

That cameras do, too, is in test_cameras.py.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import events_of

from async_tnt.kernels.sources.clock import AGREEING_PACKETS as N
from async_tnt.kernels.sources.clock import BACK_US, LATEST_START_US, REORDERED_US
from async_tnt.sources import Clock, encode
from async_tnt.sources.live.datagrams import Decoder

JUMP_US = 10_000_000
MINUTE_US = 60_000_000
HOUR_US = 60 * MINUTE_US
UNSIGNED = np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
SIGNED = np.dtype(
    {"names": ["t", "x"], "formats": ["<i8", "<i2"], "offsets": [4, 0], "itemsize": 16}
)


def by_clock(packets, arrivals=None, *, max_jump_s=10.0, dtype=UNSIGNED):
    """The times that are kept of each packet, and (jumped, late, restarts)."""
    clock = Clock(max_jump_s)
    kept = []
    for k, times in enumerate(packets):
        events = np.zeros(len(times), dtype)
        events["t"] = times
        events["x"] = range(len(times))
        events = clock(events, "t", 0 if arrivals is None else arrivals[k])
        assert np.all(np.diff(events["x"]) > 0)  # whole records are moved, in their order
        kept.append(events["t"].tolist())
    return kept, (clock.jumped, clock.late, clock.restarts)


def flat(packets):
    return [t for times in packets for t in times]


@pytest.mark.parametrize(
    ("time", "arrival_us", "kept"),
    [
        (MINUTE_US + JUMP_US, 0, True),
        (MINUTE_US + JUMP_US + 1, 0, False),
        (MINUTE_US - BACK_US, 0, True),
        (MINUTE_US - BACK_US - 1, 0, False),
        (MINUTE_US + 3 * JUMP_US, 2 * JUMP_US, True),  # a pause by both clocks
        (MINUTE_US - BACK_US // 4 - 1, 3 * BACK_US // 4, False),  # sent again
        (MINUTE_US - REORDERED_US - 1, 2 * JUMP_US, False),
        (MINUTE_US + 1, HOUR_US, True),  # a slow clock
        (
            MINUTE_US + JUMP_US,
            -3 * JUMP_US,
            True,
        ),  # the receiver's own clock was set back: nothing has passed
        (MINUTE_US + JUMP_US + 1, -3 * JUMP_US, False),
        (MINUTE_US - BACK_US - 1, -3 * JUMP_US, False),
    ],
)
def test_the_bounds_by_hand(time, arrival_us, kept):
    expected = [[MINUTE_US], [time] if kept else []], (not kept, kept and time < MINUTE_US, 0)
    assert by_clock([[MINUTE_US], [time]], [0, arrival_us]) == expected


@pytest.mark.parametrize(
    ("packets", "arrivals", "is_last_kept"),
    [
        ([[60_000_000], [59_000_000]], None, True),  # a second back
        ([[60_000_000], [58_999_999]], None, False),
        ([[60_000_000], [59_980_000]], [0, 10_000_000], True),  # 20 ms back, after a pause
        ([[60_000_000], [59_979_999]], [0, 10_000_000], False),
        ([[60_000_000], *[[0]] * 7], None, False),  # eight packets agree
        ([[60_000_000], *[[0]] * 8], None, True),
        ([[4_102_444_800_000_000]], None, True),  # the year 2100
        ([[4_102_444_800_000_001]], None, False),
    ],
)
def test_the_limits_that_the_rule_names(packets, arrivals, is_last_kept):
    kept, _ = by_clock(packets, arrivals)
    assert bool(kept[-1]) is is_last_kept


@pytest.mark.parametrize(
    ("max_jump_s", "jump_us"),
    [(0.25, 250_000), (2.5, 2_500_000), (0.000_001_6, 2), (1.1, 1_100_000)],
)
def test_the_largest_jump_is_rounded_to_a_microsecond(max_jump_s, jump_us):
    for too_far in (0, 1):
        time = MINUTE_US + jump_us + too_far
        kept, _ = by_clock([[MINUTE_US], [time]], max_jump_s=max_jump_s)
        assert kept == [[MINUTE_US], [] if too_far else [time]]


@pytest.mark.parametrize("place", [0, 3])
@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("garbled", [21 * MINUTE_US, 2**62, 2**63 + 5])
def test_one_garbled_time_costs_its_event_and_no_more(place, number, garbled):
    """This also holds in the first packet, and whatever follows."""
    packets = [[MINUTE_US + 10 * k + i for i in range(3)] for k in range(3)]
    received = [list(times) for times in packets]
    received[number].insert(place, garbled)
    assert by_clock(received) == (packets, (garbled < 2**62, 0, 0))


@pytest.mark.parametrize("late", [[MINUTE_US - 10], [MINUTE_US - 10, HOUR_US]])
def test_late_events_do_not_tell_how_much_time_has_passed(late):
    kept, _ = by_clock(
        [[MINUTE_US], late, [MINUTE_US + 3 * JUMP_US]], [0, 2 * JUMP_US, 2 * JUMP_US]
    )
    assert kept == [[MINUTE_US], late[:1], [MINUTE_US + 3 * JUMP_US]]


def test_packets_of_a_moved_clock_agree_however_rare_they_are():
    times = [3 * JUMP_US // 2 * k for k in range(N)]
    kept, counts = by_clock([[HOUR_US], *[[t] for t in times]], [0, *times])
    assert kept == [[HOUR_US], *NOTHING, [HOUR_US]] and counts == (N - 1, 0, 1)


AHEAD = [[15 * MINUTE_US + k, 15 * MINUTE_US + k] for k in range(N + 2)]
AGAIN = [[k, 10 + k] for k in range(N + 1)]
WENT_ON = [[MINUTE_US, MINUTE_US + 10], [MINUTE_US + 1, MINUTE_US + 11]]
NOTHING = [[]] * (N - 1)
OLD_STREAM_NOW_AND_THEN = [
    [MINUTE_US + k] if k % N == 0 else [30 * MINUTE_US + k] for k in range(10 * N)
]
MOVES = {
    "ahead: keeps its times": ([[5], *AHEAD], [[5], *NOTHING, *AHEAD[N - 1 :]], (2 * N - 2, 0, 0)),
    "back: times continue": (
        [[MINUTE_US], *AGAIN],
        [[MINUTE_US], *NOTHING, *WENT_ON],
        (2 * N - 2, 1, 1),
    ),
    "back, twice": (
        [[MINUTE_US], *[[0]] * N, [JUMP_US], *[[0]] * N],
        [
            [MINUTE_US],
            *NOTHING,
            [MINUTE_US],
            [MINUTE_US + JUMP_US],
            *NOTHING,
            [MINUTE_US + JUMP_US],
        ],
        (2 * N - 2, 0, 2),
    ),
    "one packet of the old stream ends the vote": (
        OLD_STREAM_NOW_AND_THEN,
        [times if k % N == 0 else [] for k, times in enumerate(OLD_STREAM_NOW_AND_THEN)],
        (10 * (N - 1), 0, 0),
    ),
    "packets that disagree": (
        [[MINUTE_US], *[[0], [2 * MINUTE_US]] * N],
        [[MINUTE_US], *[[], []] * N],
        (2 * N, 0, 0),
    ),
    "the first packet's oldest event starts": (
        [[9, 5, 5 + JUMP_US, 6 + JUMP_US]],
        [[9, 5, 5 + JUMP_US]],
        (1, 1, 0),
    ),
    "a start beyond 2100 does not": (
        [[2**62 - 1], [LATEST_START_US + 1], [LATEST_START_US - 9]],
        [[], [], [LATEST_START_US - 9]],
        (2, 0, 0),
    ),
    "unless a stream agrees on it": (
        [[2**61 + k] for k in range(N)],
        [*NOTHING, [2**61 + N - 1]],
        (N - 1, 0, 0),
    ),
}


@pytest.mark.parametrize(("packets", "kept", "counts"), MOVES.values(), ids=MOVES)
def test_a_clock_that_moves(packets, kept, counts):
    for dtype in (UNSIGNED, SIGNED):
        assert by_clock(packets, dtype=dtype) == (kept, counts)


def test_times_that_no_clock_shows_are_dropped_and_vote_for_nothing():
    impossible = [-1, 2**62, -(2**63)]
    assert flat(by_clock([[5], *[impossible] * 2 * N, [6, -1, 7]], dtype=SIGNED)[0]) == [5, 6, 7]
    far = 2**61
    kept, _ = by_clock([[far]] * N + [[0]] * N + [[far - 1]] * N + [[far]], dtype=SIGNED)
    assert kept[N - 1 :: N] == [[far], [far], [2**62 - 1]]  # the last one would go on beyond


@given(
    packets=st.lists(st.lists(st.integers(0, 40 * MINUTE_US), max_size=6), max_size=40),
    passed=st.lists(st.integers(0, 3 * JUMP_US), min_size=40, max_size=40),
)
def test_times_never_fall_far_and_every_event_is_counted(packets, passed):
    kept, (jumped, late, _) = by_clock(packets, np.cumsum(passed).tolist())
    newest = 0
    n_late = 0
    for times in kept:
        assert min(times, default=newest) >= newest - BACK_US
        for t in times:
            n_late += t < newest
            newest = max(newest, t)
    assert jumped + len(flat(kept)) == len(flat(packets)) and late == n_late


@given(
    starts=st.lists(st.integers(0, 4 * MINUTE_US), min_size=1, max_size=4),
    first=st.integers(0, LATEST_START_US),
)
def test_after_anything_one_stream_is_followed_again(starts, first):
    """The last of several streams, in order and at its own pace."""
    length = 4 * N  # 3 s: a fall by less than a second, which is no jump, is caught up with
    kept, _ = by_clock(
        [[first]] + [[start + k * 100_000] for start in starts for k in range(length)]
    )
    assert np.diff(flat(kept[-N:])).tolist() == [100_000] * (N - 1)
    assert flat(kept)[-1] == max(flat(kept))


@pytest.mark.parametrize(("apart", "agree"), [(JUMP_US, True), (JUMP_US + 1, False)])
def test_votes_agree_within_the_largest_jump_of_each_other_either_way(apart, agree):
    times = [20 * MINUTE_US + k % 2 * apart for k in range(N)]
    kept, _ = by_clock([[5], *[[t] for t in times]])
    assert kept == [[5], *NOTHING, times[-1:] if agree else []]


def test_a_packet_with_one_event_of_the_old_stream_ends_the_vote_though_another_jumps():
    """Seven votes, then such a packet, over and over: the clock never moves."""
    moved = [[30 * MINUTE_US]] * (N - 1)
    kept, (_, _, restarts) = by_clock([[MINUTE_US], *[*moved, [MINUTE_US + 1, 30 * MINUTE_US]] * 4])
    assert flat(kept) == [MINUTE_US, *[MINUTE_US + 1] * 4] and restarts == 0


def test_time_that_passed_before_the_previous_vote_is_no_reason_to_agree():
    """Votes that come an hour after the newest event, and each further ahead than a jump."""
    ahead = [[5 * HOUR_US + 2 * k * JUMP_US] for k in range(2 * N)]
    kept, _ = by_clock([[MINUTE_US], *ahead], [0, *[HOUR_US] * 2 * N])
    assert kept == [[MINUTE_US], *[[]] * 2 * N]


def test_without_a_limit_every_time_below_the_largest_is_kept_as_it_is():
    """This holds in whole packets, and in packets of which some events are dropped."""
    packets = [[5], [2**62 - 1], [2**62], [0], [2**62, 7], [2**61, 2**62 - 1, 2**62], [-1, 3]]
    expected = [[5], [2**62 - 1], [], [0], [7], [2**61, 2**62 - 1], [3]]
    kept, (jumped, late, restarts) = by_clock(packets, max_jump_s=None, dtype=SIGNED)
    assert kept == expected and (jumped, restarts) == (0, 0)
    assert late == 4  # 0, 7, 2**61 and 3; 2**62 - 1 is no older than itself


def test_wrong_arguments():
    for max_jump_s in (0, -1, float("nan"), float("inf"), 1e9):
        with pytest.raises(
            ValueError, match="`max_jump_s` must be a positive number of seconds, or None, got"
        ):
            Clock(max_jump_s)


@pytest.mark.parametrize("dtype", [[("t", "<u4"), ("x", "<u2")], "<u8"])
def test_times_of_32_bits_and_what_has_no_fields_are_refused(dtype):
    """The kernel would read beyond a time of 32 bits."""
    with pytest.raises(TypeError, match=r"^the field `t` must be a time of 64 bits, got "):
        Clock(10.0)(np.zeros(3, dtype), "t", 0)


# -- applied to the network ------------------------------------------------------------------------


def at(*times):
    """Events at these times, all at one pixel."""
    n = len(times)
    return events_of(times, [1] * n, [2] * n, [1] * n)


@pytest.mark.parametrize("format", ["t64_x16_y16_on8", "t32_x16_y15_on1", "spif_t32"])
@pytest.mark.parametrize("move", ["ahead: keeps its times", "back, twice"])
def test_datagrams_have_one_clock(move, format):
    packets, kept, counts = MOVES[move]
    decoder = Decoder(format, max_jump_s=10.0)
    assert [decoder.decode(encode(at(*times), format))["t"].tolist() for times in packets] == kept
    assert (decoder.clock.jumped, decoder.clock.late, decoder.clock.restarts) == counts
    assert decoder.malformed == counts[0]
    silence = decoder.decode(encode(at(7 * HOUR_US), format), arrival_us=8 * HOUR_US)
    assert len(silence) == (format == "t64_x16_y16_on8")  # 32 bits of time cannot show it
