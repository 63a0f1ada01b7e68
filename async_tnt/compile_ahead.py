"""Compile the kernels that a stream will call before it opens, on two cores where there are two."""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from typing import Any

from async_tnt.config import TNTConfig
from async_tnt.kernels.entry_points import ENTRY_POINTS
from async_tnt.kernels.jit import can_be_cached, compile_for_types, is_cached
from async_tnt.networks.compiled import CompiledClassifier, CompiledRegressor
from async_tnt.networks.model import Model
from async_tnt.process import available_cores

PATIENCE_S, PATIENCE_OF_LOGS_S = 1.0, 5.0  # silent until then, on a terminal and elsewhere
CHILD_S = 120.0  # a child that takes longer is not waited for

EVENTS = {"load_records", "check_columns", "empty_volume", "absorb", "absorb_one"}
LATE = {"find_late"}
REPLAY = {"store_events", "cells_to_float32"}
CLASSIFIER = {"classify_cells"}
WHOLE_NETWORK = {"set_input", "forward"}
REGRESSOR = WHOLE_NETWORK | {"centroid"}
OTHER_CLASSIFIERS = {"cells_to_float32", "softmax"}
EVENT_TRIGGERS = {"advance_triggers", "why_due"}
# What another process compiles meanwhile: about half of the work, and nothing of it is part of the other half.
OTHER_HALF = CLASSIFIER | REGRESSOR | {"cells_to_float32"}
_ahead = threading.Lock()


def warmup(model: Model | TNTConfig | None = None) -> float:
    """Compile everything that a stream may call, or load it from Numba's cache.

    The first time on a machine this takes some seconds, later a fraction of one. After it, no event waits for
    the compiler. A line on stderr explains a long wait.

    Parameters
    ----------
    model : for streams of this model or configuration only; by default, for any.

    Returns
    -------
    float : seconds it took.
    """
    config = model.config if isinstance(model, Model) else model
    kernels = EVENTS | LATE | OTHER_CLASSIFIERS | EVENT_TRIGGERS
    if config is None or config.needs_replay:
        kernels |= REPLAY
    if config is None or config.needs_regressor:
        kernels |= REGRESSOR
    if config is None or isinstance(model, Model):
        kernels |= CLASSIFIER | WHOLE_NETWORK | {"absorb_and_decide"}
    return compile_kernels(kernels)


def compile_for(config: TNTConfig, classifier: Any, regressor: Any, *, late: str, by_event: bool) -> float:
    """`warmup` for a Processor with these settings: what it calls, and nothing else.

    Parameters
    ----------
    config : TNTConfig.
    classifier, regressor : what decides, and what finds the landmark or None; other code than ours is not compiled.
    late : see `Processor`.
    by_event : whether a trigger looks at every event.
    """
    compiled = type(classifier) is CompiledClassifier
    kernels = EVENTS | (CLASSIFIER if compiled else OTHER_CLASSIFIERS)
    if late != "accept":
        kernels |= LATE
    if config.needs_replay:
        kernels |= REPLAY
    if type(regressor) is CompiledRegressor:
        kernels |= REGRESSOR
    if by_event:
        kernels |= EVENT_TRIGGERS
        if compiled and not config.needs_replay:
            kernels |= {"absorb_and_decide"}
    return compile_kernels(kernels)


def compile_kernels(names: Iterable[str]) -> float:
    """Compile these kernels, or load them from Numba's cache; returns the seconds it took."""
    started = time.perf_counter()
    missing = {name for name in names if not _is_compiled(name)}
    if not missing:
        return 0.0
    with _ahead:  # of two threads the second one waits, and finds all or most of it done
        _compile_missing(missing)
    return time.perf_counter() - started


def _compile_missing(missing: Iterable[str]) -> None:
    patience_s = PATIENCE_S if sys.stderr.isatty() else PATIENCE_OF_LOGS_S
    notice = threading.Timer(patience_s, _explain_wait)
    notice.daemon = True
    notice.start()
    try:
        wanted = [name for name in ENTRY_POINTS if name in missing]  # in the order of compilation
        child = _start_child([name for name in wanted if name in OTHER_HALF])
        if child is not None:
            with _ending(child):
                _compile(name for name in wanted if name not in OTHER_HALF | {"absorb_and_decide"})
        _compile(wanted)  # what the child has compiled is loaded
    finally:
        notice.cancel()


def _compile(names: Iterable[str]) -> None:
    collecting = gc.isenabled()
    try:
        gc.disable()  # a tenth of the time, and Numba makes no garbage in the meantime
        for name in names:
            if not _is_compiled(name):
                compile_for_types(*ENTRY_POINTS[name])
    finally:
        if collecting:
            gc.enable()


def _is_compiled(name: str) -> bool:
    kernel, types = ENTRY_POINTS[name]
    return types in kernel.overloads


def _start_child(names: list[str]) -> subprocess.Popen[bytes] | None:
    """Start a process that fills the cache with these kernels; None where that would not pay."""
    kernel, types = ENTRY_POINTS["absorb"]
    is_python = bool(sys.executable) and not getattr(sys, "frozen", False)
    worthwhile = "classify_cells" in names and can_be_cached(kernel) and available_cores() > 1 and is_python
    if not worthwhile or is_cached(kernel, types) or is_cached(*ENTRY_POINTS["classify_cells"]):
        return None
    # it ends without a word on Ctrl-C, which a terminal sends to it, too
    code = "import signal; signal.signal(signal.SIGINT, signal.SIG_DFL)\n"
    code += f"from async_tnt.compile_ahead import _compile; _compile({names})"
    # -P, and our own path: it shall find the same modules as this process, and nothing in the current folder
    path = os.pathsep.join(os.path.abspath(folder) for folder in sys.path if folder)
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            env=os.environ | {"PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return None


@contextlib.contextmanager
def _ending(child: subprocess.Popen[bytes]) -> Iterator[None]:
    """Wait for it at the end; kill it if it takes too long, or if we are interrupted."""
    try:
        yield
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(CHILD_S)
    finally:
        child.kill()
        child.wait()


def _explain_wait() -> None:
    if not _is_compiling():
        return
    how_often = "once on this machine"
    if not can_be_cached(ENTRY_POINTS["absorb"][0]):
        how_often = "in every process, as no cache folder can be written; set NUMBA_CACHE_DIR to one that can"
    print(f"async_tnt: compiling kernels, {how_often} (about 10 s) ...", file=sys.stderr, flush=True)


def _is_compiling() -> bool:
    """Whether anything was not in the cache: on a busy machine, loading may take long, too."""
    return any(any(kernel.stats.cache_misses.values()) for kernel, _ in ENTRY_POINTS.values())
