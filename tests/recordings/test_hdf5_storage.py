"""Where an HDF5 file keeps its events: in chunks, which are decompressed once, and nowhere but in the file itself."""

import signal
import subprocess
import sys
from collections import Counter
from io import BytesIO, FileIO
from pathlib import Path

import numpy as np
import pytest
from recordings.written import dsec, made_events, metavision

from async_tnt.sources.files import hdf5_child
from async_tnt.sources.files.child_end import Out
from async_tnt.sources.files.recording import open_recording

h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")

EVENTS = made_events(5_000)
SETS = [f"events/{name}" for name in "txyp"]


class Watched(FileIO):
    """A file that counts where reads begin."""

    def __init__(self, path):
        super().__init__(path)
        self.reads = Counter()

    def readinto(self, buffer):
        self.reads[self.tell()] += 1
        return super().readinto(buffer)


@pytest.mark.parametrize("chunks", [(5_000,) * 4, (5_000, 700, 3_333, 90), (64,) * 4, (100, 101, 5_000, 1)])
def test_each_chunk_is_read_once(tmp_path, monkeypatch, chunks):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name, chunk in zip(SETS, chunks, strict=True):
            file.create_dataset(name, data=EVENTS[name[-1]], chunks=(chunk,), compression="gzip")
    with h5py.File(path) as file:
        ids = [file[name].id for name in SETS]
        places = [each.get_chunk_info(i).byte_offset for each in ids for i in range(each.get_num_chunks())]
    watched = Watched(path)
    real = h5py.File
    monkeypatch.setattr(h5py, "File", lambda path, mode: real(watched, mode, rdcc_nbytes=1))  # no chunk fits its cache
    monkeypatch.setattr(hdf5_child, "BLOCK_EVENTS", 100)
    out = BytesIO()
    hdf5_child.write_events(str(path), Out(out))
    watched.close()
    assert out.getvalue().endswith(bytes(4) + b"{}\n")
    assert {watched.reads[place] for place in places} == {1}
    monkeypatch.undo()
    np.testing.assert_array_equal(open_recording(path).read(), EVENTS)


STUCK = """
import runpy, signal, sys, time
import h5py

def stuck(*args):
    if not signal.getitimer(signal.ITIMER_REAL)[0]:
        sys.exit(3)  # nobody would end this
    signal.setitimer(signal.ITIMER_REAL, 0.01)
    while True:
        time.sleep(1)

h5py.Dataset.__getitem__ = stuck
write_events = runpy.run_path({reader!r})["write_events"]
"""


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no alarms on this system")
def test_a_chunk_that_takes_forever_is_ended(tmp_path):
    """After the file was opened; the alarm then comes sooner than set."""
    metavision(tmp_path / "a.h5", EVENTS)
    here = Path(hdf5_child.__file__).parent
    (tmp_path / "stuck.py").write_text(STUCK.format(reader=str(here / "hdf5_child.py")))
    (tmp_path / "child_end.py").write_text((here / "child_end.py").read_text())
    words = [sys.executable, "-P", str(tmp_path / "child_end.py"), "stuck.py", str(tmp_path / "a.h5")]
    done = subprocess.run(words, stdout=subprocess.PIPE)
    assert done.returncode == -signal.SIGALRM
    assert done.stdout.startswith(b'{"sensor"') and done.stdout.count(b"\n") == 1


def link_elsewhere(path, name, link):
    """Another file gets what was at `name`, and this one a link to it."""
    (path.parent / "other.h5").write_bytes(path.read_bytes())
    with h5py.File(path, "r+") as file:
        del file[name]
        file[name] = link


def external_link(path, name):
    link_elsewhere(path, name, h5py.ExternalLink("other.h5", f"/{name}"))


def soft_link_to_an_external_one(path, name):
    link_elsewhere(path, name, h5py.SoftLink("/first"))
    with h5py.File(path, "r+") as file:
        file["first"] = h5py.SoftLink("second")
        file["second"] = h5py.ExternalLink("other.h5", f"/{name}")


def through_a_linked_group(path, name):
    link_elsewhere(path, name, h5py.SoftLink(f"/group/{name}"))
    with h5py.File(path, "r+") as file:
        file["group"] = h5py.ExternalLink("other.h5", "/")


def external_storage(path, name):
    with h5py.File(path, "r+") as file:
        values = np.atleast_1d(file[name][()])  # h5py keeps a single number in the file
        del file[name]
        raw = path.with_suffix(".raw")
        raw.write_bytes(values.tobytes())
        file.create_dataset(name, values.shape, values.dtype, external=[(str(raw), 0, values.nbytes)])


def virtual(path, name):
    with h5py.File(path, "r+") as file:
        layout = h5py.VirtualLayout(file[name].shape, file[name].dtype)
        layout[...] = h5py.VirtualSource("other.h5", name, file[name].shape)
    link_elsewhere(path, name, h5py.SoftLink("/virtual"))
    with h5py.File(path, "r+") as file:
        file.create_virtual_dataset("virtual", layout)


LINKS = (external_link, soft_link_to_an_external_one, through_a_linked_group)
STORED = (external_storage, virtual)
ELSEWHERE = [
    *[(dsec, name, move) for name in ("events/t", "events/p", "t_offset") for move in LINKS + STORED],
    *[(metavision, "CD/events", move) for move in LINKS + STORED],
    *[(dsec, "events", move) for move in LINKS],
    *[(metavision, "CD", move) for move in LINKS],
]


@pytest.mark.parametrize(("write", "name", "move"), ELSEWHERE)
def test_values_in_another_file_are_refused(tmp_path, write, name, move):
    path = tmp_path / "a.h5"
    write(path, EVENTS)
    move(path, name)
    with h5py.File(path) as file:
        assert name in file  # HDF5 itself would read it
    with pytest.raises(ValueError, match=r"a\.h5: \S+ must be stored in the file itself, but "):
        open_recording(path)


def test_links_within_the_file_are_followed(tmp_path):
    path = tmp_path / "a.h5"
    dsec(path, EVENTS)
    with h5py.File(path, "r+") as file:
        file.move("events", "recorded/left")
        file["events"] = h5py.SoftLink("/recorded/left")
        file.move("recorded/left/t", "recorded/left/times")
        file["recorded/left/t"] = h5py.SoftLink("times")
    np.testing.assert_array_equal(open_recording(path).read(), EVENTS)
    with h5py.File(path, "r+") as file:
        del file["recorded/left/t"]
        file["recorded/left/t"] = h5py.SoftLink("t")
    with pytest.raises(ValueError, match=r"a\.h5: t is a link to a link to a link"):
        open_recording(path)
