"""stream and astream: a source of events in, decisions out."""

import asyncio
import warnings
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
from deciding import key
from made import opened, random_events, random_model, raw_model

from async_tnt import Processor, TNTConfig, astream, stream, volumes
from async_tnt.streaming.streams import Settings

MODEL = random_model(TNTConfig(window_us=1000))
EVENTS = random_events(400, seed=1, duration_us=4000)


def packets(size):
    return (EVENTS[first : first + size] for first in range(0, len(EVENTS), size))


def keys(decisions):
    return [key(d) for d in decisions]


@pytest.fixture(scope="module")
def expected():
    decisions = keys(stream([EVENTS], MODEL))
    assert len(set(decisions)) == 4
    return decisions


@pytest.mark.parametrize(
    "source",
    [
        lambda: packets(70),
        lambda: EVENTS.tolist(),  # single tuples
        lambda: [None, EVENTS[:0], EVENTS, None],
        lambda: (tuple(packet[name] for name in "txyp") for packet in packets(33)),
    ],
    ids=["packets", "tuples", "empty", "columns"],
)
def test_any_source_gives_the_same_decisions(source, expected):
    assert keys(stream(source(), MODEL)) == expected


def test_a_source_of_the_other_kind_is_refused_at_the_call():
    for use, model in ((stream, MODEL), (volumes, MODEL.config)):
        with pytest.raises(
            TypeError, match="`source` must be an iterable of packets or of events, got int"
        ):
            use(5, model)
        for path in ("five.bin", Path("five.bin")):
            with pytest.raises(
                TypeError, match=r"`source` must yield events, got the path five\.bin; open_record"
            ):
                use(path, model)
    with pytest.raises(TypeError, match=r"`source` must be asynchronous, got list; `stream` takes"):
        astream([], MODEL)
    with pytest.raises(FileNotFoundError, match="no model file digitz"):
        stream([EVENTS], "digitz")


def test_a_source_may_have_items_alone(expected):
    """An object with `__getitem__`, and without `__iter__`, is an iterable of Python's."""

    class Packets:
        def __getitem__(self, k):
            return [EVENTS[:150], EVENTS[150:]][k]

    assert keys(stream(Packets(), MODEL)) == expected


@pytest.mark.parametrize(
    "use",
    [
        lambda source: stream(source, MODEL),
        lambda source: stream(source, raw_model(MODEL.config)),
        lambda source: volumes(source, MODEL.config),
    ],
    ids=["decisions", "outputs", "volumes"],
)
def test_an_event_of_a_larger_camera_is_told_what_helps(use):
    message = r"got 34 at event 1; `PixelFilter` cuts a part out of a larger camera's image$"
    with pytest.raises(ValueError, match=message):
        list(use([([1, 2], [3, 34], [5, 6], [0, 1])]))


def test_astream_equals_stream(expected):
    async def source():
        for packet in packets(70):
            await asyncio.sleep(0)
            yield packet

    async def collect():
        return [decision async for decision in astream(source(), MODEL)]

    assert keys(asyncio.run(collect())) == expected


def test_the_model_may_be_a_path_or_a_processor(tmp_path, expected):
    path = MODEL.save(tmp_path / "m.safetensors")
    processor = Processor(MODEL)
    for model in (path, str(path), processor):
        assert keys(stream([EVENTS], model)) == expected
    with pytest.raises(TypeError, match="a Processor has its settings already, got also every_us"):
        next(stream([EVENTS], processor, every_us=5))
    triggers = {d.trigger for d in stream([EVENTS], MODEL, every_events=10)}
    assert triggers == {"every_events", "window", "end"}


def test_settings_are_the_keywords_of_a_processor():
    keywords = get_type_hints(Processor.__init__)
    assert get_type_hints(Settings) == {
        name: keywords[name] for name in keywords if name not in ("model", "return")
    }


SPARSE = random_events(100, duration_us=300_000_000)  # 0.3 s in nanoseconds
UNIT = (
    "32 of the first 32 windows hold 2 events or fewer: "
    "times are read as microseconds, divide nanoseconds by 1000"
)


@pytest.mark.parametrize("settings", [{}, {"every_us": 70}, {"every_events": 1}])
@pytest.mark.parametrize("way", ["stream", "astream"])
def test_nanoseconds_read_as_microseconds_are_warned_of_once(way, settings):
    async def asynchronous():
        for event in SPARSE.tolist():
            yield event

    async def collected():
        return [decision async for decision in astream(asynchronous(), MODEL, **settings)]

    with pytest.warns(UserWarning, match=UNIT) as warned:
        if way == "stream":
            assert list(stream(iter(SPARSE.tolist()), MODEL, **settings))
            assert warned[0].filename == __file__
        else:
            assert asyncio.run(collected())
    assert len(warned) == 1


@pytest.mark.parametrize("n_small", [16, 17])
@pytest.mark.parametrize("n_events", [2, 3])
def test_small_windows_are_more_than_half_of_the_first_32_with_two_events_or_fewer(
    n_small, n_events
):
    """However many of the later ones are small."""
    sizes = [n_events] * n_small + [9] * (32 - n_small) + [1] * 40
    times = [1000 * k + i for k, size in enumerate(sizes) for i in range(size)]
    events = EVENTS[np.arange(len(times)) % len(EVENTS)]
    events["t"] = times
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        list(stream([events], MODEL.config, classifier=lambda volume: [0.0], start_us=0))
    assert [str(one.message)[:34] for one in warned] == (
        ["17 of the first 32 windows hold 2 e"[:34]] if n_small > 16 and n_events == 2 else []
    )


def test_other_small_windows_are_no_reason_to_warn():  # warnings are errors in these tests
    # so many are wanted
    assert list(stream([SPARSE], random_model(MODEL.config.replace(window_events=2))))
    assert list(stream([SPARSE], MODEL, confidence=0.01))  # windows that the first event decides


@pytest.mark.parametrize(
    "settings", [{}, {"every_us": 300}, {"hop_us": 400}], ids=["windows", "moments", "overlapping"]
)
def test_volumes_are_those_that_a_decision_would_have_seen(settings):
    config = TNTConfig(window_us=1000, bins=3)
    decisions = list(stream([EVENTS], config, classifier=lambda volume: [0.0], **settings))
    found = list(volumes([*EVENTS[:90].tolist(), EVENTS[90:]], config, **settings))
    assert [(one.start_us, one.events) for one in found] == [
        (d.window_start_us, d.events) for d in decisions
    ]
    for one, decision in zip(found, decisions, strict=True):
        inside = EVENTS[EVENTS["t"] >= decision.window_start_us][: decision.events]
        np.testing.assert_array_equal(
            one.volume, opened(config, inside, decision.window_start_us).array
        )
    with pytest.raises(
        TypeError, match="`config` must be a TNTConfig, got 'digits'; a model has one as `config`"
    ):
        volumes([EVENTS], "digits")


@pytest.mark.parametrize(
    "settings", [{"classifier": len}, {"classes": ["a"]}, {"confidence": 0.9}], ids=str
)
def test_volumes_take_no_setting_that_decides(settings):
    with pytest.raises(
        TypeError, match=r"^`classifier`, `classes` and `confidence` are for decisi"
    ):
        volumes([EVENTS], TNTConfig(), **settings)


@pytest.mark.parametrize("form", ["packets", "tuples", "columns"])
def test_volumes_do_with_late_events_what_a_stream_does(form):
    """`accept` adds them, `drop` leaves them out, `raise` refuses the packet."""
    config = TNTConfig(window_us=1000, bins=3)
    events = EVENTS.copy()
    events["t"][7::9] = np.maximum(0, events["t"][7::9] - 300)
    in_order = events[events["t"] >= np.maximum.accumulate(events["t"])]
    assert 300 < len(in_order) < len(events)
    make = {
        "packets": lambda: [events[:90], events[90:]],
        "tuples": lambda: events.tolist(),
        "columns": lambda: [tuple(events[name] for name in "txyp")],
    }[form]

    def found(source, **settings):
        return [
            (one.start_us, one.events, one.volume.tobytes())
            for one in volumes(source, config, **settings)
        ]

    dropped = found(make(), late="drop")
    accepted = found(make(), late="accept")
    assert dropped == found([in_order]) != accepted == found(make()) == found([events])
    with pytest.raises(ValueError, match=r"`t` must not run backwards \(late=\"raise\"\)"):
        found(make(), late="raise")
    assert found([in_order], late="raise") == dropped
    counts = [
        (d.window_start_us, d.events)
        for d in stream(make(), config, classifier=lambda v: [0.0], late="drop")
    ]
    assert counts == [one[:2] for one in dropped]
