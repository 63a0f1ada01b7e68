"""A clock that begins again: told once, or a new stream, or an error, however the events come."""

import asyncio
import itertools
import warnings

import numpy as np
import pytest
from deciding import CONFIG, key, total_and_size
from made import events_of, random_events

from async_tnt import Processor, astream, load_model, stream
from async_tnt.sources.files.recording import open_recording, sample_recordings

WARNING = (
    r"times went back by 0\.\d+ s, from \d+ to \d+ us: .*on_restart=\"reset\" .*`reset\(\)`.*Clock"
)


LONG = CONFIG.replace(window_us=200_000)


def recorded(digit):
    return open_recording(sample_recordings()[digit]).read()


SEVEN = recorded(7)
ONE = recorded(1)


def packets_of(events, size):
    return [events[first : first + size] for first in range(0, len(events), size)]


def singles(events):
    return events.tolist()


WAYS = {
    "packets": lambda events: packets_of(events, 1_000),
    "small packets": lambda events: packets_of(events, 10),
    "single events": singles,
    "one packet each": lambda events: [events],
    "columns": lambda events: [
        tuple(np.ascontiguousarray(part[f]) for f in "txyp") for part in packets_of(events, 500)
    ],
}
WAYS["lists"] = lambda events: [
    tuple(column.tolist() for column in columns) for columns in WAYS["columns"](events)
]
SETTINGS = [{}, {"every_events": 700}, {"late": "drop"}, {"hop_us": 50_000}, {"confidence": 0.9}]


def decided(decisions):
    return [(d.label, d.window_start_us, d.events, d.trigger) for d in decisions]


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
@pytest.mark.parametrize("way", WAYS)
def test_reset_gives_what_two_streams_give(way, settings):
    model = load_model("digits")
    expected = [d for events in (SEVEN, ONE) for d in stream([events], model, **settings)]
    source = itertools.chain(WAYS[way](SEVEN), WAYS[way](ONE))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = list(stream(source, model, on_restart="reset", **settings))
    assert decided(found) == decided(expected)


def test_reset_finds_the_restart_inside_a_packet():
    model = load_model("digits")
    expected = [d for events in (SEVEN, ONE) for d in stream([events], model)]
    assert decided(stream([np.concatenate([SEVEN, ONE])], model, on_restart="reset")) == decided(
        expected
    )


@pytest.mark.parametrize("way", WAYS)
def test_by_default_one_warning_names_how_much_and_both_cures(way):
    source = itertools.chain(WAYS[way](SEVEN), WAYS[way](ONE), WAYS[way](ONE))
    with pytest.warns(UserWarning, match=WARNING) as caught:
        list(stream(source, "digits"))
    assert len(caught) == 1 and caught[0].filename == __file__


@pytest.mark.parametrize("way", WAYS)
def test_raise_raises_and_the_processor_goes_on(way):
    processor = Processor(load_model("digits"), on_restart="raise")
    assert processor.on_restart == "raise"
    for events in WAYS[way](SEVEN):
        processor.push(events)
    with pytest.raises(ValueError, match=WARNING):
        for events in WAYS[way](ONE):
            processor.push(events)
    processor.reset()
    expected = decided(stream([ONE], load_model("digits")))
    found = [d for events in WAYS[way](ONE) for d in processor.push(events)]
    found += processor.finish()
    assert decided(found) == expected


def test_astream_and_push_warn_too():
    async def both():
        for packet in (SEVEN, ONE):
            yield packet

    async def all_of(decisions):
        return [d async for d in decisions]

    with pytest.warns(UserWarning, match=WARNING):
        asyncio.run(all_of(astream(both(), "digits")))
    found = asyncio.run(all_of(astream(both(), "digits", on_restart="reset")))
    assert decided(found) == [
        row for events in (SEVEN, ONE) for row in decided(stream([events], "digits"))
    ]
    processor = Processor(load_model("digits"))
    for push in (processor.push, lambda events: [processor.push_one(*e) for e in events.tolist()]):
        push(SEVEN)
        with pytest.warns(UserWarning, match=WARNING) as caught:
            push(ONE)
        assert len(caught) == 1 and caught[0].filename == __file__
        processor.reset()
    processor.push(SEVEN)
    with pytest.warns(UserWarning, match=WARNING):  # another stream
        processor.push(ONE)


@pytest.mark.parametrize(
    ("times", "is_restart"),
    [
        ([0] * 31, False),
        ([0] * 32, True),
        ([0] * 31 + [250_000] + [0] * 31, False),  # one event of the old clock ends a row
        ([149_999] * 32, True),
        ([150_000] * 32, False),  # late, but only by the jitter of a driver
        # back within the open window
        ([390_000] + [210_000] * 31, False),
        ([390_000] + [210_000] * 32, True),
    ],
)
@pytest.mark.parametrize("way", ["packet", "packets of 7", "single events"])
@pytest.mark.parametrize("late", ["accept", "drop"])
def test_a_restart_by_hand(times, is_restart, way, late):
    """32 events in a row that are 0.1 s older than the newest: windows last longer."""
    processor = Processor(LONG, classifier=total_and_size, on_restart="raise", late=late)
    processor.push(events_of([0, 250_000], [1, 1], [1, 1], [1, 1]))
    n = len(times)
    events = events_of(times, [1] * n, [1] * n, [1] * n)
    size = {"packet": n, "packets of 7": 7, "single events": 1}[way]
    packets = singles(events) if size == 1 else packets_of(events, size)
    if is_restart:
        with pytest.raises(ValueError, match=r"times went back by 0\.[12]"):
            for packet in packets:
                processor.push(packet)
    else:
        for packet in packets:
            processor.push(packet)


@pytest.mark.parametrize("size", [1, 7, 41])
def test_a_restart_is_told_from_the_newest_time_to_the_first_one_behind(size):
    """Wherever packets are cut: the first event behind may be in an earlier packet, and the newest
    one in the same packet."""
    times = [0, 250_000, 260_000, *range(1_000, 1_040)]
    n = len(times)
    events = events_of(times, [1] * n, [1] * n, [1] * n)
    processor = Processor(LONG, classifier=total_and_size, on_restart="raise")
    processor.push(events[:2])
    message = r"^times went back by 0\.259 s, from 260000 to 1000 us: "
    with pytest.raises(ValueError, match=message):
        for packet in singles(events[2:]) if size == 1 else packets_of(events[2:], size):
            processor.push(packet)


@pytest.mark.parametrize(
    ("packets", "n_new"),
    [
        # a new stream begins at the end of a packet, and goes on in the next one
        ([[250_001] + [0] * 10, [0] * 30], 40),
        # an event of the old clock ends the rows before it
        ([[0] * 3 + [250_001] + [0] * 10, [0] * 30], 40),
        ([[0] * 5, [0] * 3 + [250_001] + [0] * 40], 40),
        ([[0] * 20, [250_001], [0] * 20, [0] * 20], 40),
        # no restart: all events are of one stream
        ([[0] * 20, [250_001], [0] * 20], 2 + 41),
    ],
)
@pytest.mark.parametrize("late", ["accept", "drop"])
def test_a_new_stream_begins_with_the_first_event_of_its_row(packets, n_new, late):
    processor = Processor(LONG, classifier=total_and_size, on_restart="reset", late=late)
    processor.push(events_of([0, 250_000], [1, 1], [1, 1], [1, 1]))
    for times in packets:
        n = len(times)
        processor.push(events_of(times, [1] * n, [1] * n, [1] * n))
    assert processor.counts.received == n_new


@pytest.mark.parametrize("settings", [{}, {"late": "drop"}, {"every_events": 7}], ids=str)
@pytest.mark.parametrize("size", [0, 1, 45, 333, 10_000])
def test_any_number_of_restarts_in_any_packets(size, settings):
    """Each part of the source is a stream of its own, with rows of late events that are short."""
    rng = np.random.default_rng(0)
    parts = []
    for _ in range(6):
        times = rng.integers(200_000, 300_000) + np.cumsum(rng.integers(2_000, 4_000, 130))
        times[100:115] = 1_000
        n = len(times)
        parts.append(events_of(times, rng.integers(0, 34, n), [7] * n, [1] * n))
    expected = []
    for part in parts:
        alone = Processor(LONG, classifier=total_and_size, **settings)
        expected += [key(d) for d in alone.push(part) + alone.finish()]

    processor = Processor(LONG, classifier=total_and_size, on_restart="reset", **settings)
    source = np.concatenate(parts)
    packets = packets_of(source, size) if size else singles(source)
    decisions = [d for packet in packets for d in processor.push(packet)] + processor.finish()
    assert [key(d) for d in decisions] == expected
    assert processor.counts == alone.counts


def test_after_an_error_a_row_is_counted_anew():
    processor = Processor(LONG, classifier=total_and_size, on_restart="raise")
    processor.push(events_of([0, 250_000], [1, 1], [1, 1], [1, 1]))
    for _ in range(2):
        for _ in range(31):
            processor.push_one(0, 1, 1, 1)
        with pytest.raises(ValueError, match=WARNING):
            processor.push_one(0, 1, 1, 1)


def test_windows_shorter_than_the_limit_are_the_limit():
    processor = Processor(
        CONFIG.replace(window_us=1_000), classifier=total_and_size, on_restart="raise"
    )
    processor.push(events_of([0, 5_000], [1, 1], [1, 1], [1, 1]))
    processor.push(events_of([4_000] * 40, [1] * 40, [1] * 40, [1] * 40))
    with pytest.raises(ValueError, match=r"back by 0\.001 s, from 5000 to 3999 us"):
        processor.push(events_of([3_999] * 40, [1] * 40, [1] * 40, [1] * 40))


@pytest.mark.parametrize(
    "settings", [{"start_us": 10**9}, {"confidence": 0.1}, {"hop_us": 30}], ids=str
)
def test_a_late_start_and_windows_decided_early_are_no_restart(settings):
    """Late events are dropped without a warning in two cases.

    They lie before `start_us`, or in a window that has been decided.
    """
    processor = Processor(CONFIG, classifier=total_and_size, on_restart="raise", **settings)
    events = random_events(3_000, start_us=1_000, duration_us=500_000)
    events["t"] += np.random.default_rng(0).integers(-40, 41, len(events))
    for packet in packets_of(events, 50):
        processor.push(packet)


def test_counts_begin_again_with_a_reset():
    processor = Processor(load_model("digits"), on_restart="reset")
    for packet in packets_of(SEVEN, 10) + packets_of(ONE, 10):
        processor.push(packet)
    assert (processor.counts.received, processor.counts.dropped_late) == (len(ONE), 0)


def test_a_recording_that_is_streamed_twice_through_one_processor_is_a_restart():
    """The first stream has closed its windows."""
    processor = Processor(load_model("digits"))
    list(stream(packets_of(SEVEN, 500), processor))
    with pytest.warns(UserWarning, match=WARNING):
        list(stream(packets_of(SEVEN, 500), processor))
    processor = Processor(load_model("digits"), on_restart="reset")
    once = decided(stream(packets_of(SEVEN, 500), processor))
    assert decided(stream(packets_of(SEVEN, 500), processor)) == once != []


def test_an_unknown_policy_is_refused():
    with pytest.raises(
        ValueError, match="`on_restart` must be one of warn, reset, raise, got 'ignore'"
    ):
        Processor(CONFIG, classifier=total_and_size, on_restart="ignore")


def test_a_stream_left_open_goes_on_with_the_next_source():
    model = load_model("digits")
    expected = [key(d) for d in stream([SEVEN], model)]
    for at in (0, 7, 2_000, len(SEVEN)):
        processor = Processor(model)
        decisions = list(stream([SEVEN[:at]], processor, finish=False))
        decisions += stream([SEVEN[at:]], processor)
        assert [key(d) for d in decisions] == expected
        assert processor.counts.dropped_late == 0


def test_an_asynchronous_stream_left_open_goes_on_with_the_next_source():
    async def source(events):
        yield events

    async def decided_in_parts():
        processor = Processor(load_model("digits"))
        found = [d async for d in astream(source(SEVEN[:2_000]), processor, finish=False)]
        return found + [d async for d in astream(source(SEVEN[2_000:]), processor)]

    assert [key(d) for d in asyncio.run(decided_in_parts())] == [
        key(d) for d in stream([SEVEN], "digits")
    ]
