"""The processor that kernels are compiled for."""

from __future__ import annotations

import os
from typing import Any

import llvmlite.binding as llvm
import numba

# Numba's settings, whose names mypy does not see.
_config: Any = numba.config

_V3 = ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "popcnt")
_V4 = (*_V3, "avx512bw", "avx512cd", "avx512dq", "avx512f", "avx512vl")
KINDS = {"x86-64-v4": _V4, "x86-64-v3": _V3}
"""Kind of processor, in LLVM's words -> the instructions that it has. The best kind comes first."""
GENERIC = "generic"
"""The kind of all processors of another architecture."""

OTHERWISE = ("NUMBA_BOUNDSCHECK", "NUMBA_DEBUGINFO", "NUMBA_ENABLE_AVX", "NUMBA_OPT")
"""Variables of the environment that change what Numba compiles, for any processor."""


def settings_for(kind: str) -> dict[str, str]:
    """Variables of the environment that make Numba compile for a kind of processor."""
    features = ",".join(f"+{name}" for name in KINDS.get(kind, ()))
    return {"NUMBA_CPU_NAME": kind, "NUMBA_CPU_FEATURES": features}


def is_x86() -> bool:
    """Whether this process runs on an x86 processor."""
    return llvm.get_process_triple().startswith(("x86", "i686"))


def best_kind() -> str | None:
    """The best of `KINDS` that this machine's processor belongs to; GENERIC if it is no x86.

    None if it is an x86 processor that lacks instructions of all kinds.
    """
    if not is_x86():
        return GENERIC
    features = llvm.get_host_cpu_features()
    for kind, needs in KINDS.items():
        if all(features.get(name, False) for name in needs):
            return kind
    return None


def chosen_kind() -> str | None:
    """The kind of processor that this process compiles for; None if it is none of the kinds.

    It is the best kind, unless NUMBA_CPU_NAME or NUMBA_CPU_FEATURES is set.
    """
    if _config.CPU_NAME is None and _config.CPU_FEATURES is None:
        return best_kind()
    for kind in (*KINDS, GENERIC):
        settings = settings_for(kind)
        if tuple(settings.values()) == (_config.CPU_NAME, _config.CPU_FEATURES):
            return kind
    return None


def other_settings() -> list[str]:
    """The variables of `OTHERWISE` that are set."""
    return [name for name in OTHERWISE if os.environ.get(name)]


def _lanes() -> int:
    """Numbers in a register: 16 with AVX-512, otherwise 8."""
    if _config.CPU_NAME is not None:
        return 16 if "+avx512f" in (_config.CPU_FEATURES or "") else 8
    return 16 if llvm.get_host_cpu_features().get("avx512f", False) else 8


LANES = _lanes()
"""Float32 numbers in a register. The layout of weights depends on it; results do not."""
