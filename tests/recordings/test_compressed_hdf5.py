"""HDF5 files that are really compressed, by the filters of h5py and of hdf5plugin; and what is said without them."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from recordings.damaging import read
from recordings.test_fuzzed_files import CASES, damaged
from recordings.written import WRITERS, made_events

from async_tnt.sources.files.recording import open_recording

EVENTS = made_events(5_000)
LAYOUTS = ["dsec.h5", "metavision.hdf5"]
FILTERS = {"Blosc": "32001", "Blosc2": "32026", "Zstd": "32015", "LZ4": "32004"}


def compressed(path, name):
    hdf5plugin = pytest.importorskip("hdf5plugin", reason="Blosc needs hdf5plugin")
    WRITERS[path.name](path, EVENTS, chunks=(1_000,), **getattr(hdf5plugin, name)())
    assert path.stat().st_size < EVENTS.nbytes  # it was compressed, not left out as filters may be
    return path


def first_line_without_hdf5plugin(path):
    """Of the process that reads the file, as if hdf5plugin were not installed."""
    program = f"""
import sys
sys.modules["hdf5plugin"] = None
from async_tnt.recordings.child_end import Out
from async_tnt.recordings.hdf5_child import write_events
write_events({str(path)!r}, Out(sys.stdout.buffer))
"""
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.split(b"\n")[0])


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", FILTERS)
def test_hdf5plugins_filters_are_read(tmp_path, layout, name):
    np.testing.assert_array_equal(open_recording(compressed(tmp_path / layout, name)).read(), EVENTS)


@pytest.mark.parametrize("name", FILTERS)
def test_without_hdf5plugin_one_line_says_what_to_install(tmp_path, name):
    told = first_line_without_hdf5plugin(compressed(tmp_path / "dsec.h5", name))["error"]
    assert told.startswith("its events are compressed by ")
    assert f"(filter {FILTERS[name]}), which is missing: pip install hdf5plugin, or let HDF5_PLUGIN_PATH" in told


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(
    "how", [{"compression": "gzip", "shuffle": True}, {"compression": "lzf"}, {"fletcher32": True}]
)
def test_h5pys_own_filters_are_read(tmp_path, layout, how):
    WRITERS[layout](tmp_path / layout, EVENTS, chunks=(777,), **how)
    np.testing.assert_array_equal(open_recording(tmp_path / layout).read(), EVENTS)


def test_a_broken_check_sum_is_damage_where_the_chunk_begins(tmp_path):
    WRITERS["dsec.h5"](tmp_path / "dsec.h5", EVENTS, chunks=(1_000,), fletcher32=True)
    data = bytearray((tmp_path / "dsec.h5").read_bytes())
    place = data.find((EVENTS["x"][3_000:3_100]).astype("<u2").tobytes())
    assert place > 0
    data[place] ^= 1
    (tmp_path / "dsec.h5").write_bytes(data)
    got, told, _ = read(tmp_path / "dsec.h5")
    assert len(told) == 1 and "damaged recording: after event 0" in str(told[0].message)
    assert len(got) == 0  # a block has more chunks than one: what is before the broken one in it is lost


def test_random_damage_of_blosc_never_crashes(tmp_path):
    """Blosc of hdf5plugin 7.1 ends its process by a segmentation fault in one of 200 cases or so."""
    path = compressed(tmp_path / "dsec.h5", "Blosc")
    data = path.read_bytes()
    rng = np.random.default_rng(5)
    n_told = 0
    for _ in range(max(1, CASES // 100)):
        path.write_bytes(damaged(data, rng))
        got, told, _ = read(path)
        n_told += got is None or len(told) > 0
    assert n_told > CASES // 1000


@pytest.mark.parametrize("chunks", [None, (1_000,)])
def test_a_header_that_claims_a_million_million_events_is_refused_at_once(tmp_path, chunks):
    """HDF5 makes zeros of what was never written: events at t = 0, in a corner, for hours."""
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name, dtype in (("t", "u4"), ("x", "u2"), ("y", "u2"), ("p", "u1")):
            file.create_dataset(f"events/{name}", (10**12 if chunks else 10**6,), dtype, chunks=chunks)
    with pytest.raises(ValueError, match=r"a\.h5: /events/t says that it has 10*0 events, but the file holds 0 of"):
        open_recording(path)
