"""Shared by all tests: where the data is, and a compiler cache that no edited kernel can make stale."""

import hashlib
import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

# Numba looks only at the file of the function it caches, not at those that are compiled into it. A folder of
# its own for each state of the kernels makes an edit of a shared formula count.
_sources = hashlib.sha256(b"".join(p.read_bytes() for p in sorted((ROOT / "async_tnt").rglob("*.py"))))
_mode = "bounds" if os.environ.get("NUMBA_BOUNDSCHECK") == "1" else "plain"
os.environ.setdefault("NUMBA_CACHE_DIR", str(ROOT / ".numba_cache" / f"{_sources.hexdigest()[:16]}-{_mode}"))
os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder with `nmnist/` and `mnist/`, or skip."""
    folder = Path(os.environ.get("TNT_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "nmnist" / "Test").is_dir():
        pytest.skip(f"no recordings in {folder} (TNT_DATA names another folder)")
    return folder
