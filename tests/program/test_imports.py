"""What the package costs: imports, compiled kernels and their cache, memory."""

import ast
import importlib
import inspect
import os
import pickle
import pydoc
import re
import shutil
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest
from held_memory import held
from made import random_events, random_model

import async_tnt
from async_tnt import Processor, TNTConfig
from async_tnt.cli.program import COMMANDS

STORE_ONE = """
import numpy as np
from async_tnt.kernels.volume.absorb import store_events
t, x, p, block = np.ones(1, np.int64), np.ones(1, np.uint16), np.ones(1, np.uint8), np.zeros(60)
block.view(np.int64)[25] = 5
store_events(block, t, x, x, p, 0, 1, t, x, x, p, 9)
print(block.view(np.int64)[31])
"""


def python(code, **settings):
    """What a new Python prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, **settings)
    return done.stdout.strip() or done.stderr.strip()


def test_import_brings_only_what_is_used():
    heavy = {"numpy", "numba", "torch", "onnx", "onnxruntime", "matplotlib"}
    heavy |= {"argparse", "typing", "signal", "asyncio", "concurrent.futures"}

    def brought(code):
        printed = python(
            f"import sys; before = set(sys.modules); {code}; print(*set(sys.modules) - before)"
        )
        return heavy & set(printed.split())

    assert not brought("import async_tnt, async_tnt.cli; async_tnt.__version__")
    assert "numba" not in brought("import async_tnt; async_tnt.TNTConfig()")
    engine = {"typing", "signal"} | brought("import numpy, numba")
    used = brought(
        "import async_tnt; async_tnt.Processor; async_tnt.load_model; async_tnt.sources.files"
    )
    assert "numba" in used <= engine
    assert brought("import async_tnt.cli.run") <= engine | {"argparse"}
    assert not brought("import async_tnt.networks, async_tnt.cli.export") & {
        "torch",
        "onnx",
        "onnxruntime",
    }


def test_public_names_are_there_in_every_way():
    """The import of a module sets its name in the package; so all of them are imported before."""
    for path in Path(async_tnt.__file__).parent.glob("*.py"):
        if path.stem not in ("__init__", "__main__"):
            importlib.import_module(f"async_tnt.{path.stem}")
    starred = {}
    exec("from async_tnt import *", starred)
    for name in async_tnt.__all__:
        value = getattr(async_tnt, name)
        assert starred[name] is value and name in dir(async_tnt)
        is_unnamed = value is async_tnt.sources.files or value is async_tnt.EVENT_DTYPE
        assert is_unnamed or value.__name__ == name
        if isinstance(value, type) or inspect.isfunction(value):
            assert pickle.loads(pickle.dumps(value)) is value
    helped = pydoc.plain(pydoc.render_doc(async_tnt))
    assert "class Processor" in helped and re.search(r"load_model\(\s*name_or_path: ", helped)
    assert async_tnt.sources.PixelFilter is async_tnt.PixelFilter
    with pytest.raises(AttributeError, match=r"^module 'async_tnt' has no attribute 'procesor'$"):
        async_tnt.procesor  # noqa: B018
    with pytest.raises(ImportError, match="cannot import name 'procesor'"):
        from async_tnt import procesor  # noqa: F401


@pytest.mark.parametrize("package", [async_tnt, async_tnt.sources, async_tnt.training])
def test_type_checkers_see_the_same_names(package):
    """The table of lazy names, the literal `__all__` and the imports for type checkers agree."""
    nodes = list(ast.walk(ast.parse(Path(package.__file__).read_text())))
    imports = [n for n in nodes if isinstance(n, ast.ImportFrom)]
    own = {"lazy_names", "__version__"}
    seen = {alias.name: n.module for n in imports for alias in n.names if alias.name not in own}
    calls = [n for n in nodes if isinstance(n, ast.Call) and ast.unparse(n.func) == "lazy_names"]
    table = ast.literal_eval(calls[0].args[1])
    lazy = {
        name: f"{package.__name__}.{module}"
        for module, names in table.items()
        for name in names.split()
    }
    assigned = {ast.unparse(n.targets[0]): n.value for n in nodes if isinstance(n, ast.Assign)}
    assert seen == lazy and sorted(seen) == sorted(ast.literal_eval(assigned["__all__"]))
    for name, module in seen.items():
        assert getattr(package, name) is getattr(importlib.import_module(module), name)


NO_FOLDER = """
from numba.core import caching
from async_tnt.kernels import entry_points

def refuse(locator):
    raise PermissionError("no folder can be written")

caching._CacheLocator.ensure_cache_path = refuse
entry_points.WARN_AFTER_S = 0
"""


def test_works_where_nothing_can_be_cached():
    """Numba refuses cache=True where no folder for a cache can be written.

    A wait for the compiler is said to come again.
    """
    env = os.environ | {"NUMBA_OPT": "3"}  # the kernel is compiled, even if the package has code
    command = [sys.executable, "-c", NO_FOLDER + STORE_ONE]
    done = subprocess.run(command, capture_output=True, text=True, env=env)
    assert done.stdout == "1\n"
    assert "in every process, as no cache folder can be written" in done.stderr


def test_without_numbas_compiler_commands_and_imports_say_so_in_one_line():
    """Plain Python cannot do what kernels do.

    They read records at any address, and release the GIL.
    """
    code = (
        "import async_tnt\n"
        "from async_tnt.cli import main\n"
        "from async_tnt.cli.program import COMMANDS\n"
        "codes = {main([name, '--help']) for name in COMMANDS}\n"
        "try: async_tnt.Processor\n"
        "except ImportError as error: print(codes, len(COMMANDS), error)"
    )
    env = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    line = (
        "async_tnt cannot run with NUMBA_DISABLE_JIT=1, which switches Numba's compiler off: unset "
        "it\n"
    )
    assert done.stdout == f"{{2}} {len(COMMANDS)} {line}"
    assert done.stderr == f"async-tnt: {line}" * len(COMMANDS)


def test_processors_may_be_made_in_several_threads_at_once():
    code = (
        "import threading, async_tnt; failed = []\n"
        "def make():\n"
        "    try: async_tnt.Processor(async_tnt.TNTConfig(), classifier=len).push(([1], [1], [1], "
        "[1]))\n"
        "    except Exception as error: failed.append(error)\n"
        "threads = [threading.Thread(target=make) for _ in range(8)]\n"
        "[t.start() for t in threads]; [t.join() for t in threads]; print(failed)"
    )
    assert python(code) == "[]"


def test_an_edited_constant_reaches_kernels_that_were_cached_before(tmp_path):
    """By itself Numba would serve the old machine code: it looks only at the kernel's own file."""
    package = tmp_path / "async_tnt"
    shutil.copytree(
        Path(async_tnt.__file__).parent,
        package,
        ignore=shutil.ignore_patterns("__pycache__", "assets"),
    )
    env = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    assert python(STORE_ONE, env=env, cwd=tmp_path) == "1"
    state = package / "kernels" / "volume" / "state.py"
    state.write_text(state.read_text().replace("RECEIVED = 31", "RECEIVED = 45"))
    assert python(STORE_ONE, env=env, cwd=tmp_path) == "0"


@pytest.mark.parametrize("landmark", ["running", "window"])
def test_memory_does_not_grow_with_a_long_stream(landmark):
    config = TNTConfig(window_us=5_000, landmark=landmark)
    processor = Processor(random_model(config), every_us=1_000, hop_us=2_500)
    packet = random_events(2_000, duration_us=5_000)
    tracemalloc.start()
    try:
        for k in range(120):
            processor.push(packet)
            packet["t"] += 5_000
            if k == 20:
                before = held()
        after = held()
    finally:
        tracemalloc.stop()
    assert processor.counts.received == 240_000 and before > 0 and after - before < 20_000
