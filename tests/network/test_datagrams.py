"""Events to bytes and back: by hand, round trip, any bytes at all."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import events_of, random_events

from async_tnt.events import EVENT_DTYPE, as_events
from async_tnt.sources.datagrams import EVENT_BYTES, Decoder, decode, encode

FORMATS = tuple(EVENT_BYTES)
EVENT = events_of([0x1_0000_0203], [0x0405], [0x0607], [1])
BY_HAND = {
    "t64_x16_y16_on8": "03 02 00 00 01 00 00 00 05 04 07 06 01",
    "t32_x16_y15_on1": "03 02 00 00 05 04 0f 0c",
    "spif": "07 86 05 84",
    "spif_t32": "07 86 05 04 03 02 00 00",
}


@pytest.mark.parametrize("format", FORMATS)
def test_one_event_by_hand(format):
    assert encode(EVENT, format) == bytes.fromhex(BY_HAND[format])
    events, malformed = decode(bytes.fromhex(BY_HAND[format]), format, arrival_us=77)
    t = {"t64_x16_y16_on8": 0x1_0000_0203, "spif": 77}.get(format, 0x203)
    assert events.tolist() == [(t, 0x0405, 0x0607, 1)] and malformed == 0


@pytest.mark.parametrize("format", FORMATS)
def test_what_is_encoded_is_decoded(format):
    events = random_events(500, sensor=(1 << 15, 1 << 15))
    data = encode(events, format)
    assert len(data) == 500 * EVENT_BYTES[format]
    if format == "spif":
        events["t"] = 77  # it has no time
    decoded, malformed = decode(data, format, arrival_us=77)
    assert decoded.dtype == EVENT_DTYPE and decoded.tobytes() == events.tobytes() and malformed == 0


@pytest.mark.parametrize("format", FORMATS[1:])
def test_coordinates_without_bits_are_refused(format):
    with pytest.raises(ValueError, match=rf"`y` must be in \[0, 32768\) for {format}, got 32768 at event 1"):
        encode(events_of([0, 0], [0, 0], [0, 32768], [0, 0]), format)


def test_unknown_format():
    for call in (encode, decode):
        with pytest.raises(ValueError, match=r"`format` must be one of t64_x16_y16_on8, .*, got 'aer'"):
            call(EVENT[:0], "aer")


@given(data=st.binary(max_size=400), format=st.sampled_from(FORMATS), sided=st.booleans())
def test_any_bytes_become_good_events_and_a_count(data, format, sided):
    sensor = (300, 200) if sided else None
    events, malformed = decode(data, format, sensor, arrival_us=5)
    assert len(events) + malformed == -(-len(data) // EVENT_BYTES[format])
    assert len(as_events(events, sensor or (1 << 16, 1 << 16))) == len(events)  # the door takes them all


@given(
    steps=st.lists(st.integers(-(2**31) + 1, 2**31 - 1), max_size=30),
    cuts=st.sets(st.integers(0, 30)),
    format=st.sampled_from(("t32_x16_y15_on1", "spif_t32")),
)
def test_times_of_32_bits_are_unwrapped_however_the_stream_is_cut(steps, cuts, format):
    t = np.cumsum([5, *steps])
    t[t < 0] = 0  # what a stream cannot hold; a step may then be too long to follow
    newest_before = np.maximum.accumulate(t)[:-1]
    if (np.abs(t[1:] - newest_before) >= 2**31).any():
        return
    events = events_of(t, t % 7, t % 5, t % 2)
    decoder = Decoder(format)
    parts = np.split(events, sorted(cut for cut in cuts if cut <= len(t)))
    decoded = np.concatenate([decoder.decode(encode(part, format)).events for part in parts])
    assert decoded.tolist() == events.tolist()


def test_an_hour_and_a_half_wraps_once_by_hand():
    t = [2**32 - 2, 2**32 - 1, 2**32, 2**32 + 5]
    data = encode(events_of(t, [0] * 4, [0] * 4, [0] * 4), "t32_x16_y15_on1")
    assert decode(data, "t32_x16_y15_on1").events["t"].tolist() == t


def test_a_malformed_event_does_not_lead_times_astray():
    t = [10, 2**31 + 5, 2**32 - 20, 30]
    data = encode(events_of(t, [1, 99, 99, 2], [0] * 4, [0] * 4), "t32_x16_y15_on1")
    events, malformed = decode(data, "t32_x16_y15_on1", sensor=(34, 34))
    assert events["t"].tolist() == [10, 30] and malformed == 2


def test_older_than_the_first_event_and_before_zero_is_malformed():
    data = encode(events_of([5, 2**32 - 3, 6], [0] * 3, [0] * 3, [0] * 3), "t32_x16_y15_on1")
    events, malformed = decode(data, "t32_x16_y15_on1")
    assert events["t"].tolist() == [5, 6] and malformed == 1


def test_spif_words_of_the_other_kind_are_malformed():
    assert decode(encode(EVENT, "spif_t32"), "spif").malformed == 2  # the word, and its time
    assert decode(encode(np.repeat(EVENT, 2), "spif"), "spif_t32").malformed == 1


def test_a_polarity_beyond_one_and_impossible_times_are_malformed():
    events = np.repeat(EVENT, 4)
    events["p"][1] = 2
    events["t"][2], events["t"][3] = -1, 2**62
    decoded, malformed = decode(events.tobytes())
    assert decoded.tolist() == EVENT.tolist() and malformed == 3


def test_decoded_events_are_the_callers():
    data = bytearray(encode(EVENT))
    events = decode(data).events
    data[:] = bytes(13)
    assert events.tolist() == EVENT.tolist() and events.flags.writeable
