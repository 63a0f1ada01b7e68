"""Files with random damage, thousands of each format; ASYNC_TNT_FUZZ_CASES says how many, for a long run.

No crash, no hang, and no event moved by damage that lies behind it in the file.
"""

import os

import numpy as np
import pytest
from numba import config
from recordings.damaging import EVERY_WRITER, LINEAR, SLOWEST_S, read
from recordings.written import made_events

from async_tnt.sources.files import child

CASES = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", "200" if config.DISABLE_JIT else "2000"))  # of each format
SEED = int(os.environ.get("ASYNC_TNT_FUZZ_SEED", "0"))
SLOWER = {".aedat4": 100, ".h5": 100, ".hdf5": 100}  # a process of its own for each pass
SENSOR = (34, 34)


def damaged(data, rng):
    """Bytes changed, cut out, put in, doubled, set to zero or to ones; or the end lost."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        place = int(rng.integers(0, len(data))) if data else 0
        length = int(rng.integers(1, 12))
        kind = rng.integers(0, 8)
        if kind == 0 and data:
            data[place] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            data[place : place + length] = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        elif kind == 2:
            del data[place : place + length]
        elif kind == 3:
            data[place:place] = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        elif kind == 4:
            data[place : place + length] = bytes(length)
        elif kind == 5:
            data[place : place + length] = b"\xff" * length
        elif kind == 6:
            data[place:place] = data[place : place + 10 * length]
        elif rng.integers(0, 4) == 0:
            del data[place:]
    return bytes(data)


def first_difference(one, other):
    n = min(len(one), len(other))
    different = np.flatnonzero(np.frombuffer(one[:n], np.uint8) != np.frombuffer(other[:n], np.uint8))
    return int(different[0]) if len(different) else n


def cases(name, tmp_path):
    """The whole file's bytes, its events, and damaged copies of it, each written to the path."""
    events = made_events(60, step_us=3_000, sensor=SENSOR)
    path = tmp_path / name
    EVERY_WRITER[name](path, events, SENSOR)
    data = path.read_bytes()
    rng = np.random.default_rng((SEED, *name.encode()))
    for _ in range(max(1, CASES // SLOWER.get(path.suffix, 1))):
        torn = damaged(data, rng)
        path.write_bytes(torn)
        yield path, data, torn


@pytest.mark.parametrize("name", sorted(EVERY_WRITER.keys() - LINEAR.keys()))  # those are read below
def test_random_damage_never_crashes(tmp_path, name, monkeypatch):
    monkeypatch.setattr(child, "SILENCE_S", SLOWEST_S / 5)  # HDF5 reads some damage for ever
    n_told = n_cases = 0
    for path, _, _ in cases(name, tmp_path):
        got, told, _ = read(path)
        n_cases += 1
        n_told += got is None or len(told) > 0
    assert n_told > n_cases // 100


@pytest.mark.parametrize("name", sorted(LINEAR))
def test_damage_moves_no_event_before_it(tmp_path, name):
    events = made_events(60, step_us=3_000, sensor=SENSOR)
    n_before = [len(LINEAR[name](events[:n], SENSOR)) for n in range(len(events) + 1)]  # bytes of the first n
    n_kept = 0
    for path, data, torn in cases(name, tmp_path):
        place = first_difference(data, torn)
        got, _, _ = read(path)
        if got is None or place < n_before[1]:
            continue
        # in text, the number next to the damage may be another: so the row before it does not count
        n = np.searchsorted(n_before, place, side="right") - 1 - (path.suffix in (".txt", ".csv"))
        np.testing.assert_array_equal(got[:n], events[:n])
        n_kept += 1
    assert n_kept > CASES // 20
