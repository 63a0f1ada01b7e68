"""The scripts under benchmarks/, as modules."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="session")
def load_benchmark() -> Callable[[str], ModuleType]:
    """`load_benchmark("peers")`; skips where the folder is missing, as beside an installed package."""
    if not FOLDER.is_dir():
        pytest.skip("benchmarks/ is not part of an installed package")

    def load(name: str) -> ModuleType:
        spec = importlib.util.spec_from_file_location(f"benchmark_{name}", FOLDER / f"{name}.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(FOLDER)  # a script finds the others beside it
            spec.loader.exec_module(module)
        return module

    return load
