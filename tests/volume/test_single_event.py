"""A single event in the forms in which loops and libraries give it, read without columns."""

import copy
import pickle
from collections import namedtuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from volume.test_event_forms import LAYOUTS, SENSOR, records

from async_tnt import Processor, TNTConfig, TNTVolume
from async_tnt.volume.events import EVENT_DTYPE, EventDecoder
from async_tnt.volume.single_event import SingleEventReader

CONFIG = TNTConfig(sensor=SENSOR)
Event = namedtuple("Event", "t x y p")
ForeignOrder = namedtuple("ForeignOrder", "x y t p")
EVENT = (60_000, 5, 6, 1)

READ = {
    "Python integers": EVENT,
    "a bool": (60_000, 5, 6, True),
    "a named tuple": Event(*EVENT),
    "NumPy's numbers": tuple(np.int64(number) for number in EVENT),
    "numbers of columns": (np.int64(60_000), np.uint16(5), np.uint16(6), np.bool_(True)),
    "a record": np.array([EVENT], EVENT_DTYPE)[0],
    "a record of a recarray": np.rec.array([EVENT], EVENT_DTYPE)[0],
    "with other fields": np.array(
        [(0, *EVENT, "a")], [("i", "i1"), *EVENT_DTYPE.descr, ("n", "U1")]
    )[0],
}
LEFT = {
    "columns": tuple(np.array([number]) for number in EVENT),
    "a packet": np.array([EVENT], EVENT_DTYPE),
    "a list": list(EVENT),
    "floats": (60_000.0, 5, 6, 1),
    "a float column": (60_000, 5.0, 6, 1),
    "a time that is a bool": (True, 5, 6, 1),
    "a polarity that is a float": (60_000, 5, 6, 1.0),
    "three numbers": EVENT[:3],
    "other names": ForeignOrder(5, 6, 60_000, 1),
    "a record of floats": np.array([EVENT], [(name, "f8") for name in "txyp"])[0],
    "a record of times": np.array([EVENT], [("t", "m8[us]"), *EVENT_DTYPE.descr[1:]])[0],
    "two names of one field": np.array([(*EVENT, 1)], [*EVENT_DTYPE.descr, ("on", "u1")])[0],
    "no polarity": np.array([EVENT[:3]], EVENT_DTYPE.descr[:3])[0],
    "bytes": np.void(b"1234"),
    "nothing": None,
}


@pytest.mark.parametrize("event", READ.values(), ids=READ)
def test_four_integers(event):
    numbers = SingleEventReader()(event)
    assert numbers == EVENT and all(type(number) is int for number in numbers)


@pytest.mark.parametrize("event", LEFT.values(), ids=LEFT)
def test_other_forms_are_left_to_the_decoder(event):
    assert SingleEventReader()(event) is None


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_records_of_every_layout_are_read_as_the_decoder_reads_them(layout):
    events = records(layout)
    read = SingleEventReader()
    for k, event in enumerate(events):
        t, x, y, p, _ = EventDecoder(SENSOR).decode(events[k : k + 1])
        assert read(event) == (t[0], x[0], y[0], p[0])


def test_fields_that_are_renamed_in_place_are_found_by_their_new_names():
    events = np.array([(5, 1, 3, 1)], EVENT_DTYPE.descr)
    event = events[0]
    read = SingleEventReader()
    assert read(event) == (5, 1, 3, 1)
    event.dtype.names = ("t", "y", "x", "p")
    assert read(event) == (5, 3, 1, 1)


@pytest.mark.parametrize("name", READ)
def test_a_stream_takes_it_as_four_integers(name):
    """So does a copy, whose reader goes on."""
    taken = []
    for event in (READ[name], EVENT):
        volume = TNTVolume(CONFIG)
        processor = Processor(CONFIG, classifier=lambda volume: volume.sum((1, 2)))
        for stream in (volume, copy.copy(volume), pickle.loads(pickle.dumps(volume))):
            stream.update(event)
            stream.update(Event(60_001, np.int16(7), 6, -1))
            stream.update(event)
            taken.append((stream.array.tolist(), stream.counts))
        for _ in range(2):
            processor.push(event)
            processor = copy.copy(processor)
        taken.append((processor.fire().logits.tolist(), processor.counts))
    assert taken[:4] == taken[4:]


@given(
    st.lists(st.integers(-(2**64), 2**65) | st.integers(-2, 300), min_size=3, max_size=3),
    st.integers(-3, 3),
)
def test_an_invalid_event_is_refused_in_the_words_for_four_integers(numbers, p):
    event = Event(*numbers, p)
    answers = []
    for form in (event, tuple(event)):
        processor = Processor(CONFIG, classifier=len)
        try:
            answers.append(processor.push(form))
        except (ValueError, TypeError) as error:
            answers.append((type(error), str(error)))
        assert processor.counts.received in (0, 1)
    assert answers[0] == answers[1]
