"""What Numba keeps on disk is discarded when any file that is compiled into it was edited."""

import os
import subprocess
import sys

import pytest
from numba import config

OTHER = """
from async_tnt.kernels.jit import inlined

@inlined
def step(x):
    return x + {step}
"""
KERNEL = """
from async_tnt.kernels.jit import compiled
from steps.other import step

@compiled
def twice(x):
    return step(step(x))
"""
PROGRAM = "from steps.kernel import twice; value = twice(0); print(value, sum(twice.stats.cache_hits.values()))"


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled, so nothing is kept")
def test_a_kernel_outside_the_kernels_is_compiled_again_when_a_file_beside_it_changes(tmp_path):
    folder = tmp_path / "steps"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "kernel.py").write_text(KERNEL)

    def run():
        path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
        env = os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        done = subprocess.run(
            [sys.executable, "-B", "-c", PROGRAM], env=env, capture_output=True, text=True, timeout=60
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    (folder / "other.py").write_text(OTHER.format(step=1))
    assert run() == ["2", "0"]
    assert run() == ["2", "1"]  # kept
    (folder / "other.py").write_text(OTHER.format(step=10))
    assert run() == ["20", "0"]  # and not 2 from the cache
