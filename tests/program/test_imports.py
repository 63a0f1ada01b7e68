"""What importing costs, and what it must not bring along."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import async_tnt

CODE = """
import sys, time
import numba, numpy, safetensors.numpy  # what they cost is not ours to change: 0.1 to 0.3 s
started = time.process_time()  # other processes must not decide
import async_tnt
took = time.process_time() - started
print(took, "torch" in sys.modules, "matplotlib" in sys.modules, "tqdm" in sys.modules)
"""


def test_import_brings_no_torch_and_is_quick():
    times = []
    for _ in range(3):
        out = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True).stdout.split()
        assert out[1:] == ["False", "False", "False"]
        times.append(float(out[0]))
    assert min(times) < 0.15


def test_kernels_import_nothing_of_the_package():
    kernels = Path(async_tnt.__file__).parent / "kernels"
    for path in kernels.glob("*.py"):
        source = path.read_text()
        assert "from .." not in source and "import async_tnt" not in source and "from async_tnt" not in source


def test_reference_imports_nothing_of_the_package():
    import tnt_reference

    for path in Path(tnt_reference.__file__).parent.glob("*.py"):
        assert "import async_tnt" not in path.read_text() and "from async_tnt" not in path.read_text()


def test_works_where_nothing_can_be_cached(tmp_path):
    """Numba refuses cache=True where neither the package nor the user's cache folder can be written."""
    code = (
        "import async_tnt; v = async_tnt.TNTVolume(async_tnt.TNTConfig()); v.update_one(5, 1, 1, 1); print(v.n_events)"
    )
    blocked = tmp_path / "file"
    blocked.write_text("a file, so that no folder can be made here")
    env = os.environ | {"NUMBA_CACHE_DIR": str(blocked / "cache")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env, timeout=120)
    assert done.stdout == "1\n", done.stderr


def test_warmup_tells_a_terminal_what_takes_so_long(monkeypatch, capsys):
    import importlib

    module = importlib.import_module("async_tnt.warmup")  # the package's `warmup` is the function
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setattr(module, "PATIENCE_S", 0.0)
    async_tnt.warmup()
    assert "compiling kernels, once on this machine" in capsys.readouterr().err


def test_warmup_says_how_long_it_took():
    assert 0 < async_tnt.warmup() < 60
    assert 0 < async_tnt.warmup(async_tnt.TNTConfig(grid=(20, 20))) < 60


def test_processors_may_be_made_in_several_threads_at_once():
    code = (
        "import threading, async_tnt; failed = []\n"
        "def make():\n"
        "    try: async_tnt.Processor(async_tnt.TNTConfig(), classifier=len).push(([1], [1], [1], [1]))\n"
        "    except Exception as error: failed.append(error)\n"
        "threads = [threading.Thread(target=make) for _ in range(8)]\n"
        "[t.start() for t in threads]; [t.join() for t in threads]; print(failed)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout == "[]\n", done.stdout + done.stderr


def test_an_edited_constant_reaches_kernels_that_were_cached_before(tmp_path):
    """By itself Numba would serve the old machine code: it looks only at the kernel's own file."""
    package = tmp_path / "async_tnt"
    shutil.copytree(Path(async_tnt.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__", "assets"))
    code = (
        "import numpy as np; from async_tnt.kernels.store import store_events; "
        "t = np.ones(1, np.int64); x = np.ones(1, np.uint16); p = np.ones(1, np.uint8); b = np.zeros(60); "
        "b.view(np.int64)[25] = 5; store_events(b, t, x, x, p, 0, 1, t, x, x, p, 0); print(b.view(np.int64)[31])"
    )
    env = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def received():
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, env=env, timeout=120, cwd=tmp_path
        )
        return done.stdout.strip() or done.stderr

    assert received() == "1"
    assert received() == "1"  # from the cache
    state = package / "kernels" / "state.py"
    state.write_text(state.read_text().replace("RECEIVED = 31", "RECEIVED = 45"))
    assert received() == "0"
