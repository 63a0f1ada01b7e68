"""What importing costs, and what it must not bring along."""

import ast
import importlib
import inspect
import os
import pickle
import pydoc
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import async_tnt


def modules_after(code):
    """The names of all modules that are loaded after this code."""
    done = subprocess.run(
        [sys.executable, "-c", f"{code}; import sys; print(*sys.modules)"], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_import_brings_only_what_is_used():
    heavy = {"numpy", "numba", "torch", "matplotlib", "argparse", "typing", "signal"}
    nothing = modules_after("pass")
    for code in ("import async_tnt", "import async_tnt.cli"):
        assert not heavy & (modules_after(code) - nothing)
    assert "numba" not in modules_after("import async_tnt; async_tnt.TNTConfig()")
    used = modules_after("import async_tnt; async_tnt.Processor; async_tnt.load_model; async_tnt.sources.files")
    assert "numba" in used and not {"torch", "matplotlib"} & used


def test_public_names_are_there_in_every_way():
    """Whatever has been imported before: a module's import sets its name in the package."""
    for path in Path(async_tnt.__file__).parent.glob("*.py"):
        if path.stem not in ("__init__", "__main__"):
            importlib.import_module(f"async_tnt.{path.stem}")
    starred = {}
    exec("from async_tnt import *", starred)
    for name in async_tnt.__all__:
        value = getattr(async_tnt, name)
        assert starred[name] is value and name in dir(async_tnt)
        assert value is async_tnt.sources.files or value is async_tnt.EVENT_DTYPE or value.__name__ == name
        if isinstance(value, type) or inspect.isfunction(value):
            assert pickle.loads(pickle.dumps(value)) is value
    helped = pydoc.plain(pydoc.render_doc(async_tnt))
    assert "class Processor" in helped and "load_model(name_or_path" in helped
    assert async_tnt.sources.PixelFilter is async_tnt.PixelFilter
    with pytest.raises(AttributeError, match=r"^module 'async_tnt' has no attribute 'procesor'$"):
        async_tnt.procesor  # noqa: B018
    with pytest.raises(ImportError, match="cannot import name 'procesor'"):
        from async_tnt import procesor  # noqa: F401


@pytest.mark.parametrize("package", [async_tnt, async_tnt.sources, async_tnt.training])
def test_type_checkers_see_the_same_names(package):
    imports = [n for n in ast.walk(ast.parse(Path(package.__file__).read_text())) if isinstance(n, ast.ImportFrom)]
    seen = {alias.name: n.module for n in imports for alias in n.names if alias.name != "lazy_names"}
    assert sorted(seen) == package.__all__
    for name, module in seen.items():
        assert getattr(package, name) is getattr(importlib.import_module(module), name)


def test_a_package_that_is_missing_is_named():
    code = "import sys; sys.modules['numba'] = None; import async_tnt; async_tnt.Processor"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1 and "import of numba halted" in done.stderr.splitlines()[-1]


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
        "import numpy as np; from async_tnt.kernels.absorb import store_events; "
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
