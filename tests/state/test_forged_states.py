"""A state may be forged: whatever numbers it holds, it is refused, or its stream continues to the end."""

import itertools
import os

import numpy as np
import pytest
from deciding import CONFIG
from made import random_events, random_model

from async_tnt import LeakyIntegrator, Processor
from async_tnt.checked_tensors import read_state, state_bytes

N_FORGED = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", 150))
SMALL = CONFIG.replace(sensor=(30, 24), grid=(12, 10), bins=3)
CASES = [
    (SMALL, {"hop_us": 300, "confidence": 0.4, "every_events": 25}),
    (SMALL.replace(landmark="line", remove_flow=True), {"every_us": 170, "activity": LeakyIntegrator(5, 300.0)}),
    (SMALL.replace(landmark="window"), {"every_events": 7, "hop_us": 450}),
    (SMALL.replace(landmark="regressor"), {"start_us": 40, "late": "drop"}),
    (SMALL.replace(transform="none", polarity="split"), {"every_us": 90}),
    (SMALL.replace(window_events=40), {"every_events": 7}),
    (SMALL.replace(representation="mean_time"), {"every_us": 90}),
    (SMALL.replace(representation="time_surface"), {"every_us": 90}),
    (SMALL.replace(representation="hats", polarity="unsigned", grid=(4, 4)), {"every_us": 90}),
    (SMALL.replace(representation="count_time", polarity="unsigned", window_events=60), {}),
]
of_all_cases = pytest.mark.parametrize("case", range(len(CASES)))
WHOLE = [sign * (1 << power) + off for power in (0, 8, 31, 40, 53, 62) for sign in (-1, 1) for off in (-1, 0, 1)]
NUMBERS = [*map(float, WHOLE), np.nan, np.inf, -np.inf, 1e308, 5e-324]
SETTINGS = [None, -1, 0, 1 << 62, 1 << 70, 1.5, float("nan"), float("inf"), "text", [], {}, {"threshold": -1}, True]


def make(case):
    config, settings = CASES[case]
    return Processor(random_model(config, classes=3, widths=(3, 4, 5), regressor_widths=(3, 3, 3)), **settings)


def stopped(case):
    """The state of a processor in the middle of a stream, and the rest of that stream."""
    events = random_events(260, seed=case, duration_us=4300, sensor=SMALL.sensor)
    events["t"][::17] = np.maximum(0, events["t"][::17] - 900)  # some late ones
    processor = make(case)
    processor.push(events[:150])
    assert processor.fire().events > 5 and processor.volume().any()
    return *read_state(processor.save_state()), events[150:]


def refused(case, arrays, about, rest):
    """Whether a state is refused, in one line; if not, its stream has continued to the end."""
    processor = make(case)
    try:
        processor.restore_state(state_bytes(arrays, about))
    except ValueError as error:
        assert "\n" not in str(error) and len(str(error)) < 1000
        assert str(error).startswith("`state` ")
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
    values = np.array(NUMBERS, array.dtype if array.dtype.kind == "f" else np.float64)
    if array.dtype == np.int64:  # slots hold floats by their bits, too
        values = np.concatenate((WHOLE, rng.integers(-(1 << 63), 1 << 63, 4), values.view(np.int64)))
    elif array.dtype.kind == "u":
        values = np.array([n for n in WHOLE if 0 <= n <= np.iinfo(array.dtype).max], array.dtype)
    for k, value in itertools.product(rng.permutation(array.size)[:24], values):
        forged = array.copy()
        forged.reshape(-1)[k] = value
        yield forged


def misshapen(array):
    """The same numbers where none, fewer, more or others are expected."""
    yield from (array[:0], array[:-1], np.concatenate((array, array)), array[:, None], array[..., None][:0])
    with np.errstate(invalid="ignore"):
        yield from (array.astype(dtype) for dtype in (np.int64, np.uint8, np.float64, np.float32, np.bool_))


@of_all_cases
def test_every_number(case):
    """The state itself is valid, and has a valid checksum after each change."""
    arrays, about, rest = stopped(case)
    assert not refused(case, arrays, about, rest)
    rng = np.random.default_rng(case)
    states = [{name: a for name, a in arrays.items() if name != missing} for missing in arrays]
    for name, array in arrays.items():
        states += [arrays | {name: forged} for forged in (*forged_numbers(array, rng), *misshapen(array))]
    chosen = rng.permutation(len(states))[:N_FORGED]
    n_refused = sum(refused(case, states[k], about, rest) for k in chosen)
    assert n_refused > 0.25 * len(chosen)  # the other numbers are recomputed anyway


@of_all_cases
def test_several_numbers_at_once(case):
    """So that one forged number fits the next."""
    arrays, about, rest = stopped(case)
    rng = np.random.default_rng(case)
    for _ in range(N_FORGED // 2):
        forged = {name: array.copy() for name, array in arrays.items()}
        value = int(rng.choice(WHOLE))
        for name in rng.choice(list(forged), 3):
            flat = forged[name].reshape(-1)
            if flat.size and flat.dtype == np.int64:
                flat[rng.integers(flat.size, size=rng.integers(1, 4))] = value
            elif flat.size and flat.dtype == np.float64:
                flat[rng.integers(flat.size)] = rng.choice(NUMBERS)
        refused(case, forged, about, rest)


def test_every_setting():
    arrays, about, rest = stopped(1)
    for name, value in itertools.product(about["triggers"], SETTINGS):
        refused(1, arrays, about | {"triggers": about["triggers"] | {name: value}}, rest)
    for value in SETTINGS:
        refused(1, arrays, about | {"triggers": value}, rest)
        assert value is None or refused(1, arrays, about | {"fixed": value}, rest)
    assert refused(1, arrays, {}, rest)
