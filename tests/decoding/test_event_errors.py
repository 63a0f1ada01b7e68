"""What is wrong with a packet is said exactly, and the packet stays as it is."""

import numpy as np
import pytest
from decoding.bad_events import BAD, SENSOR, columns_of, in_every_form

from async_tnt.events import NAMES, EventDecoder, as_events

X, Y, P = [1, 2, 3, 4, 5], [1, 2, 3, 4, 5], [1, 0, 1, 0, 1]
T = [10, 11, 12, 13, 14]


@pytest.mark.parametrize(("error", "message"), dict.fromkeys((error, message) for _, error, message in BAD.values()))
def test_message(error, message):
    packets = {name: bad[0] for name, bad in BAD.items() if bad[1:] == (error, message)}
    for name, events in packets.items():
        decoder = EventDecoder(SENSOR)
        for take in (
            decoder.decode,
            decoder.decode,
            lambda events: as_events(events, SENSOR),
        ):  # at the second, the layout is known
            with pytest.raises(error) as raised:
                take(events)
            assert str(raised.value) == message, name


def test_a_ragged_column():
    with pytest.raises(ValueError, match=r"^`x` must be a column of whole numbers: .*inhomogeneous"):
        EventDecoder(SENSOR).decode((T, [1, [2, 3], 4, 5, 6], Y, P))


def test_a_column_within_itself():
    column = []
    column.append(column)
    with pytest.raises(ValueError, match=r"^`t` must be a column of whole numbers: "):
        EventDecoder(SENSOR).decode((column, X, Y, P))


def test_a_packet_that_is_wrong_stays_as_it_is():
    for events, error, _ in BAD.values():
        arrays = [events] if isinstance(events, np.ndarray) else []
        if isinstance(events, tuple):
            arrays = [column for column in events if isinstance(column, np.ndarray)]
        before = [(array.tobytes(), array.dtype, str(array.flags)) for array in arrays]
        with pytest.raises(error):
            EventDecoder(SENSOR).decode(events)
        assert [(array.tobytes(), array.dtype, str(array.flags)) for array in arrays] == before


@pytest.mark.parametrize("last", range(5))
@pytest.mark.parametrize("field", NAMES)
def test_a_fault_is_found_wherever_it_is(field, last):
    for _, events in in_every_form(columns_of()):
        EventDecoder(SENSOR).decode(events)  # nothing is wrong with the packet itself
    columns = columns_of()
    columns[field] = columns[field].astype("<i4")
    columns[field][last] = -5
    for _, events in in_every_form(columns):
        with pytest.raises(ValueError, match=rf"^`{field}` must be .*, got -5 at event {last}$"):
            EventDecoder(SENSOR).decode(events)
