"""Readers in a process of their own that hang, when the process that started them is gone and cannot end them."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from recordings.written import WRITERS, made_events

import async_tnt.sources.files.child as child

pytestmark = pytest.mark.skipif(not hasattr(signal, "alarm"), reason="no alarms on this system")

READERS = [("hdf5_child.py", "dsec.h5", "h5py"), ("aedat4_child.py", "dv.aedat4", "faery")]


def impatient(script, path, folder, read_s):
    """A reader that waits for its library so long instead of two minutes, reading a file."""
    here = Path(child.__file__).parent
    text = (here / "child_end.py").read_text()
    assert text.count("READ_S = 120 ") == 1
    (folder / "child_end.py").write_text(text.replace("READ_S = 120 ", f"READ_S = {read_s} "))
    (folder / script).write_text((here / script).read_text())
    words = [sys.executable, "-P", str(folder / "child_end.py"), script, str(path)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)


@pytest.mark.parametrize(("script", "name", "library"), READERS)
def test_a_read_that_never_ends_is_ended(tmp_path, script, name, library):
    """Of a pipe that nobody writes to, the library waits for the first byte."""
    pytest.importorskip(library, reason=f"read by {library}")
    os.mkfifo(tmp_path / name)
    process = impatient(script, tmp_path / name, tmp_path, read_s=1)
    try:
        said, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == -signal.SIGALRM and said == b""


@pytest.mark.parametrize(("script", "name", "library"), READERS)
def test_who_reads_slowly_gets_it_all(tmp_path, script, name, library):
    pytest.importorskip(library, reason=f"read by {library}")
    WRITERS[name](tmp_path / name, made_events(30_000))  # more than a pipe holds
    process = impatient(script, tmp_path / name, tmp_path, read_s=4)  # a busy machine may take a while to import it
    try:
        begun = process.stdout.readline()
        time.sleep(4.5)
        assert process.poll() is None
        said, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert b"sensor" in begun and said.endswith(bytes(4) + b"{}\n") and len(said) > 150_000
    assert process.returncode == 0
