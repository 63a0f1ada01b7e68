"""Events to bytes and back: by hand, round trip, any bytes at all."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from made import events_of

from async_tnt.sources import encode
from async_tnt.sources.live.datagrams import EVENT_BYTES, Decoder
from async_tnt.volume.events import EVENT_DTYPE, as_events

FORMATS = tuple(EVENT_BYTES)
EVENT = events_of([0x1_0000_0203], [0x0405], [0x0607], [1])
ONE = events_of([5], [1], [2], [1])
BY_HAND = {
    "t64_x16_y16_on8": "03 02 00 00 01 00 00 00 05 04 07 06 01",
    "t32_x16_y15_on1": "03 02 00 00 05 04 0f 0c",
    "spif": "07 86 05 84",
    "spif_t32": "07 86 05 04 03 02 00 00",
}
of_all_formats = pytest.mark.parametrize("format", FORMATS)


@of_all_formats
def test_one_event_by_hand(format):
    data = bytes.fromhex(BY_HAND[format])
    assert encode(EVENT, format) == data
    decoder = Decoder(format)
    events = decoder.decode(bytearray(data), arrival_us=77)
    t = {"t64_x16_y16_on8": 0x1_0000_0203, "spif": 77}.get(format, 0x203)
    assert events.tolist() == [(t, 0x0405, 0x0607, 1)]
    assert decoder.malformed == 0
    assert events.flags.writeable


def test_a_time_of_arrival_is_trusted_whatever_the_limit():
    """Events of `spif` have no time of their own that could jump."""
    decoder = Decoder("spif", max_jump_s=1.0)
    arrivals = [7, 10**9, 5]
    decoded = [decoder.decode(encode(ONE, "spif"), arrival_us=t) for t in arrivals]
    assert [events["t"].tolist() for events in decoded] == [[t] for t in arrivals]
    assert decoder.malformed == 0


@of_all_formats
def test_the_sensors_borders_by_hand(format):
    events = events_of(range(6), [33, 34, 0, 33, 1280, 0], [19, 0, 20, 0, 720, 0], [1] * 6)
    decoder = Decoder(format, (34, 20))
    of_any_sensor = Decoder(format)
    decoded = decoder.decode(encode(events, format))
    assert decoded["x"].tolist() == [33, 33, 0] and decoder.malformed == decoder.off_sensor == 3
    assert len(of_any_sensor.decode(encode(events, format))) == 6 and of_any_sensor.off_sensor == 0


@pytest.mark.parametrize(
    ("data", "format", "times", "malformed"),
    [
        (encode(ONE, "spif_t32"), "spif", [], 2),  # the word, and its time
        (events_of([5, 6], [0] * 2, [0] * 2, [1, 2]).tobytes(), "t64_x16_y16_on8", [5], 1),
        (
            events_of([5, -1, 2**62, 6], [0] * 4, [0] * 4, [1] * 4).tobytes(),
            "t64_x16_y16_on8",
            [5, 6],
            2,
        ),
        (encode(ONE)[:-1], "t64_x16_y16_on8", [], 1),
        # 32 bits: older than the first event and before zero; times of malformed events are not
        # followed
        (
            encode(events_of([5, 2**32 - 3, 6], [0] * 3, [0] * 3, [0] * 3), "spif_t32"),
            "spif_t32",
            [5, 6],
            1,
        ),
        (
            encode(
                events_of([10, 2**31 + 5, 2**32 - 20, 30], [1, 99, 99, 2], [0] * 4, [0] * 4),
                "t32_x16_y15_on1",
            ),
            "t32_x16_y15_on1",
            [10, 30],
            2,
        ),
    ],
)
def test_malformed_events_by_hand(data, format, times, malformed):
    decoder = Decoder(format, (34, 34))
    assert decoder.decode(data)["t"].tolist() == times and decoder.malformed == malformed


def test_what_a_format_cannot_hold_is_refused():
    for format in FORMATS:
        for x in (-1, 32768, 70000):
            with pytest.raises(
                ValueError, match=rf"`x` must be in \[0, 32768\), got {x} at event 1"
            ):
                encode(([0, 0], [0, x], [0, 0], [0, 1]), format)
        with pytest.raises(TypeError, match="`t` must be integer microseconds"):
            encode(
                np.array([(0.75, 1, 2, 1)], [("t", "f8"), ("x", "i4"), ("y", "i4"), ("p", "i1")]),
                format,
            )
    for call in (lambda: encode(EVENT, "aer"), lambda: Decoder("aer")):
        with pytest.raises(
            ValueError, match=r"`format` must be one of t64_x16_y16_on8, .*, got 'aer'"
        ):
            call()
    for sensor in ((0, 5), (34.5, 34), "ab"):
        with pytest.raises(ValueError, match="`sensor` must"):
            Decoder(sensor=sensor)


@given(
    start=st.sampled_from((5, 2**32 - 50)),
    steps=st.lists(
        st.one_of(st.integers(-100, 100), st.integers(-(2**31) + 1, 2**31 - 1)), max_size=30
    ),
    cuts=st.sets(st.integers(0, 30)),
    format=st.sampled_from(("t32_x16_y15_on1", "spif_t32")),
)
@example(2**32 - 50, [60, -20, 2**31 - 1, 2**31 - 1], {1}, "spif_t32")  # across a wrap, and back
def test_times_of_32_bits_are_unwrapped_however_the_stream_is_cut(start, steps, cuts, format):
    t = np.cumsum([start, *steps])
    t[t < 0] = 0  # what a stream cannot hold; a step may then be too long to follow
    newest_before = np.maximum.accumulate(t)[:-1]
    if (np.abs(t[1:] - newest_before) >= 2**31).any():
        return
    events = events_of(t, t % 7, t % 5, t % 2)
    decoder = Decoder(format)
    parts = np.split(events, sorted(cut for cut in cuts if cut <= len(t)))
    decoded = np.concatenate([decoder.decode(encode(part, format)) for part in parts])
    assert decoded.tolist() == events.tolist()


@st.composite
def any_datagrams(draw):
    """Any bytes, or valid events of the first format with any or with nearby times."""
    times = st.one_of(
        st.lists(st.integers(0, high), min_size=1, max_size=5) for high in (2**63 - 1, 1000)
    )
    valid = times.map(lambda t: events_of(t, [1] * len(t), [2] * len(t), [1] * len(t)).tobytes())
    return draw(st.lists(st.one_of(st.binary(max_size=90), valid), max_size=30))


@given(
    datagrams=any_datagrams(),
    format=st.sampled_from(FORMATS),
    bound=st.sampled_from([None, 10.0]),
    sensor=st.sampled_from([None, (34, 34), (30_000, 200)]),
    cut=st.integers(0, 30),
)
def test_any_datagrams_are_counted_to_the_event_however_they_are_batched(
    datagrams, format, bound, sensor, cut
):
    size = EVENT_BYTES[format]
    one_by_one = Decoder(format, sensor, bound)
    in_two = Decoder(format, sensor, bound)
    arrivals = [1_000 * k for k in range(len(datagrams))]
    parts = [
        one_by_one.decode(datagram, arrival)
        for datagram, arrival in zip(datagrams, arrivals, strict=True)
    ]
    whole = [datagram[: len(datagram) // size * size] for datagram in datagrams]
    n_whole = sum(map(len, whole)) // size
    n_cut = sum(len(datagram) % size > 0 for datagram in datagrams)
    batches = [
        in_two.decode_datagrams(
            np.frombuffer(b"".join(batch), np.uint8),
            np.cumsum([0] + [len(d) // size for d in batch])[1:].tolist(),
            came,
        )
        for batch, came in ((whole[:cut], arrivals[:cut]), (whole[cut:], arrivals[cut:]))
    ]
    events = np.concatenate([np.empty(0, EVENT_DTYPE), *parts])
    assert events.tobytes() == np.concatenate(batches).tobytes()
    assert in_two.clock.state.tolist() == one_by_one.clock.state.tolist()
    assert one_by_one.malformed - n_cut == in_two.malformed == n_whole - len(events)
    assert one_by_one.clock.jumped + one_by_one.off_sensor <= one_by_one.malformed
    newest_before = np.maximum.accumulate(np.concatenate(([-1], events["t"])))[:-1]
    assert one_by_one.clock.late == (events["t"] < newest_before).sum()
    assert len(as_events(events, sensor or (1 << 16, 1 << 16))) == len(events)  # all are valid
