"""The scripts under benchmarks/, and the modules beside them."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


def load_benchmark(name: str) -> ModuleType:
    """`load_benchmark("peers")`; skips where the folder is missing, as beside an installed package."""
    if not FOLDER.is_dir():
        pytest.skip("benchmarks/ is not part of an installed package", allow_module_level=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FOLDER)  # not for good: tests/ has folders with the names of scripts
        if name.startswith("measure_"):
            return importlib.import_module(name)  # the module that scripts import
        spec = importlib.util.spec_from_file_location(f"benchmark_{name}", FOLDER / f"{name}.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        patch.setitem(sys.modules, spec.name, module)  # dataclasses look there
        spec.loader.exec_module(module)
    return module
