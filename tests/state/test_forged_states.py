"""A state comes from elsewhere: whatever numbers it holds, it is refused or its stream goes on to the end."""

import itertools
import os

import numpy as np
import pytest
from deciding import CONFIG
from made import random_events, random_model

from async_tnt import LeakyIntegrator, Processor
from async_tnt.checked_tensors import read_state, state_bytes

N_FORGED = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", 1000))
SMALL = CONFIG.replace(sensor=(30, 24), grid=(12, 10), bins=3)
CASES = [
    (SMALL, {"hop_us": 300, "confidence": 0.4, "every_events": 25}),
    (SMALL.replace(landmark="line", remove_flow=True), {"every_us": 170, "activity": LeakyIntegrator(5, 300.0)}),
    (SMALL.replace(landmark="window"), {"every_events": 7, "hop_us": 450}),
    (SMALL.replace(landmark="regressor"), {"start_us": 40, "late": "drop"}),
    (SMALL.replace(transform="none", polarity="split"), {"every_us": 90}),
]
WHOLE = [sign * (1 << power) + off for power in (0, 8, 31, 40, 53, 62) for sign in (-1, 1) for off in (-1, 0, 1)]
NUMBERS = [*map(float, WHOLE), np.nan, np.inf, -np.inf, 1e308, 5e-324]
SETTINGS = [None, -1, 0, 1 << 62, 1 << 70, 1.5, float("nan"), float("inf"), "text", [], {}, {"threshold": -1}, True]


def make(case):
    config, settings = CASES[case]
    return Processor(random_model(config, classes=3, widths=(3, 4, 5), regressor_widths=(3, 3, 3)), **settings)


def stopped(case):
    """A processor in the midst of a stream, and the rest of that stream."""
    events = random_events(260, seed=case, duration_us=4300, sensor=SMALL.sensor)
    events["t"][::17] = np.maximum(0, events["t"][::17] - 900)  # some late ones
    processor = make(case)
    processor.push(events[:150])
    assert processor.fire().events > 5 and processor.volume().any()
    return processor.save_state(), events[150:]


def refused(case, arrays, about, rest):
    """Whether a state is refused; if not, its stream has gone on to the end."""
    processor = make(case)
    try:
        processor.restore_state(state_bytes(arrays, about))
    except ValueError as error:
        assert "\n" not in str(error) and len(str(error)) < 1000
        assert processor.counts.received == 0
        return True
    for event in rest[:5].tolist():
        processor.push_one(*event)
    processor.push(rest[5:])
    assert np.isfinite(processor.volume()).all() and np.isfinite(processor.landmark).all()
    processor.fire()
    processor.finish()
    return False


def forged_numbers(array, rng):
    """One number of an array replaced by each that may do harm, and by random ones."""
    for k in rng.permutation(array.size)[:24]:
        kinds = [WHOLE, rng.integers(-(1 << 63), 1 << 63, 4)] if array.dtype.kind in "iu" else [NUMBERS]
        info = np.iinfo(array.dtype) if array.dtype.kind in "iu" else None
        for value in itertools.chain(*kinds):
            if info is None or info.min <= value <= info.max:
                forged = array.copy()
                forged.reshape(-1)[k] = value
                yield forged
        for value in NUMBERS if array.dtype == np.int64 else ():  # slots hold floats by their bits, too
            forged = array.copy()
            forged.reshape(-1)[k] = np.float64(value).view(np.int64)
            yield forged


def misshapen(array):
    """The same numbers where none, fewer, more or others are expected."""
    yield from (array[:0], array[:-1], np.concatenate((array, array)), array[:, None], array[..., None][:0])
    with np.errstate(invalid="ignore"):
        yield from (array.astype(dtype) for dtype in (np.int64, np.uint8, np.float64, np.float32, np.bool_))


@pytest.mark.parametrize("case", range(len(CASES)))
def test_every_number(case):
    """The state itself is fine, and what is done to it afterwards is signed as if it were."""
    state, rest = stopped(case)
    arrays, about = read_state(state)
    assert not refused(case, arrays, about, rest)
    rng = np.random.default_rng(case)
    states = [
        arrays | {name: forged}
        for name, array in arrays.items()
        for forged in (*forged_numbers(array, rng), *misshapen(array))
    ]
    states += [{name: a for name, a in arrays.items() if name != missing} for missing in arrays]
    chosen = rng.permutation(len(states))[:N_FORGED]
    n_refused = sum(refused(case, states[k], about, rest) for k in chosen)
    assert n_refused > 0.25 * len(chosen)  # the others are of numbers that are not believed anyhow


@pytest.mark.parametrize("case", range(len(CASES)))
def test_several_numbers_at_once(case):
    """So that one forged number fits the next."""
    state, rest = stopped(case)
    arrays, about = read_state(state)
    rng = np.random.default_rng(case)
    for _ in range(N_FORGED // 2):
        forged = {name: array.copy() for name, array in arrays.items()}
        value = int(rng.choice(WHOLE))
        for name in rng.choice(list(forged), 3):
            whole = forged[name].reshape(-1)
            if whole.size and whole.dtype == np.int64:
                whole[rng.integers(whole.size, size=rng.integers(1, 4))] = value
            elif whole.size and whole.dtype == np.float64:
                whole[rng.integers(whole.size)] = rng.choice(NUMBERS)
        refused(case, forged, about, rest)


def test_every_setting():
    for case in (0, 1):
        state, rest = stopped(case)
        arrays, about = read_state(state)
        for name, value in itertools.product(about["triggers"], SETTINGS):
            refused(case, arrays, about | {"triggers": about["triggers"] | {name: value}}, rest)
        for value in SETTINGS:
            refused(case, arrays, about | {"triggers": value}, rest)
            if value is not None:
                assert refused(case, arrays, about | {"fixed": value}, rest)
        assert refused(case, arrays, {}, rest)


@pytest.mark.parametrize(
    "name, slot, value, message",
    [
        ("slots", 0, -(1 << 62), "its window from -4611686018427387904 us on cannot hold"),
        ("slots", 2, 1 << 40, "cannot hold 1099511627776 of"),
        ("slots", 3, -1, "its `sum_x` must be in"),
        ("slots", 6, 1 << 53, "its newest event at 9007199254740992 us is not in the window"),
        ("slots", 7, -1, "are not parts of -1 events"),
        ("slots", 13, -1, "its running line has the sums"),
        ("places", 0, 1 << 31, "its cells are not those of such a window"),
        ("cells", 0, np.inf, "its cells are not those of such a window"),
    ],
)
def test_what_is_said_of_a_volume(name, slot, value, message):
    state, _ = stopped(4)
    arrays, about = read_state(state)
    arrays = {key: array.copy() for key, array in arrays.items()}
    arrays[f"0.{name}"][slot] = value
    with pytest.raises(ValueError, match=f"`state` cannot be restored here: .*{message}"):
        make(4).restore_state(state_bytes(arrays, about))
