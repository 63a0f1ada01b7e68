"""Where a file is read, anything but a regular file is refused.

Otherwise a pipe without a writer would be waited for forever.
"""

import os
import threading
from functools import partial

import numpy as np
import pytest

from async_tnt import load_model
from async_tnt.evaluation.object_tables import find_tables, read_table
from async_tnt.networks.engines import choose_engine
from async_tnt.simulation.pictures import SUFFIXES, read_picture
from async_tnt.sources import PixelFilter, load_mask, open_recording
from async_tnt.sources.files.labelled_recordings import find_recordings
from async_tnt.sources.files.recording import READERS
from async_tnt.training.simulated_pictures import check_pictures, find_pictures

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
NOT_REGULAR = (
    "a pipe or a device|no model file|must be a file that can be read|no recordings NAME|"
    "no class folders"
)


@pytest.fixture
def pipe(tmp_path):
    """A named pipe, which must not be opened: a reader is let go, and the test fails."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    is_over = threading.Event()
    opened = []

    def let_go():
        while not is_over.wait(0.01):
            try:
                os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK))
            except OSError:  # nobody reads
                continue
            opened.append("a reader waited at the pipe")

    thread = threading.Thread(target=let_go)
    thread.start()
    yield path
    is_over.set()
    thread.join()
    assert not opened


def readers(folder):
    """Yields the name of a file, and what reads it."""
    yield from ((f"a{suffix}", open_recording) for suffix in READERS)
    yield from ((f"a{suffix}", read_picture) for suffix in SUFFIXES)
    yield from ((f"a{suffix}", load_model) for suffix in (".safetensors", ".onnx", ""))
    yield "c.json", lambda path: choose_engine("digits.onnx", config=path)
    yield "m.npy", load_mask
    yield "m.npy", lambda path: PixelFilter((34, 34), mask=path)
    yield "a_objects.csv", partial(read_table, classes=("a",))
    yield "a_bbox.npy", partial(read_table, classes=("a",))
    yield "a_objects.csv", lambda path: find_tables(path.parent)
    yield "a_labels.csv", lambda path: find_recordings(path.parent)


@pytest.mark.parametrize("link", [False, True], ids=["a pipe", "a link to one"])
def test_pipes_and_devices_are_refused(pipe, link, tmp_path):
    n = 0
    for name, read in readers(tmp_path):
        folder = tmp_path / f"{n}"
        folder.mkdir()
        if link:
            (folder / name).symlink_to(pipe)
        else:
            os.link(pipe, folder / name)
        if name.startswith("a_"):
            np.save(folder / "a.npy", np.zeros((1, 4), np.int64))
        with pytest.raises((OSError, ValueError), match=NOT_REGULAR) as caught:
            read(folder / name)
        assert "\n" not in str(caught.value) and str(folder) in str(caught.value)
        n += 1
    assert n > 30
    for device in ("/dev/zero", "/dev/null"):
        (tmp_path / "zero.png").symlink_to(device)
        with pytest.raises(OSError, match="a pipe or a device, expected a regular file"):
            read_picture(tmp_path / "zero.png")
        (tmp_path / "zero.png").unlink()


def test_a_folder_in_a_files_place_is_called_neither(tmp_path):
    n = 0
    for name, read in readers(tmp_path):
        if name.startswith("a_"):  # a table beside a recording
            continue
        folder = tmp_path / f"{n}"
        (folder / name).mkdir(parents=True)
        with pytest.raises((OSError, ValueError)) as caught:
            read(folder / name)
        assert "a pipe or a device" not in str(caught.value)
        n += 1
    assert n > 30


def test_training_leaves_a_link_to_a_pipe_out(pipe, tmp_path):
    folder = tmp_path / "set" / "disc"
    folder.mkdir(parents=True)
    (folder / "a.pgm").write_bytes(b"P5 9 9 255\n" + bytes(range(81)))
    (folder / "b.pgm").symlink_to(pipe)
    found = find_pictures(folder.parent)
    good, left_out = check_pictures(found, ["disc"], np.zeros(0, np.int64))
    assert [picture.path.name for picture in good] == ["a.pgm"]
    (line,) = left_out
    assert line.startswith("disc/b.pgm: ") and "a pipe or a device" in line
