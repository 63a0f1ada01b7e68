"""Compile the kernels that a stream will call before its first event: no event waits for the
compiler."""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from async_tnt.base.checks import short
from async_tnt.base.package import available_cores
from async_tnt.kernels.jit import can_be_cached, compile_for_types, is_cached
from async_tnt.networks.loading import load_model
from async_tnt.networks.models.compiled import CompiledClassifier, CompiledRegressor
from async_tnt.networks.models.model import Model
from async_tnt.streaming.entry_points import ENTRY_POINTS, MAP_PARTS, PARTS
from async_tnt.streaming.triggers import TriggerSettings
from async_tnt.volume.config import TNTConfig

CHILD_S = 120.0  # a second process that takes longer is not waited for

EVENTS = {"load_records", "check_columns", "empty_volume", "absorb", "absorb_one", "schedule"}
LATE = {"find_late"}
REPLAY = {"store_events", "cells_to_float32"}
CLASSIFIER = {"classify_cells"}
WHOLE_NETWORK = {"set_input", "forward"}
REGRESSOR = WHOLE_NETWORK | {"centroid"}
LOCATOR = {"locate_cells"}
OTHER_CLASSIFIERS = {"cells_to_float32", "softmax"}
EVENT_TRIGGERS = {"until_due", "why_due"}


def warmup(model: Model | TNTConfig | str | Path | None = None) -> float:
    """Compile everything that a stream may call, or load it from Numba's cache.

    The first time on a machine this takes some seconds: a line on stderr says so, and a second
    process compiles the network's kernels meanwhile. Later it takes a fraction of a second. After
    it, no event waits for the compiler.

    Parameters
    ----------
    model : for streams of this model, given also by its name or path, or configuration only; by
        default, for any.

    Returns
    -------
    float : seconds it took.
    """
    started = time.perf_counter()
    if isinstance(model, (str, Path)):
        model = load_model(model)
    if not isinstance(model, (Model, TNTConfig, type(None))):
        raise TypeError(
            f"`model` must be a Model, the name or path of one, or a TNTConfig, got {short(model)}"
        )
    config = model.config if isinstance(model, Model) else model
    names = EVENTS | LATE | OTHER_CLASSIFIERS | EVENT_TRIGGERS
    if config is None or config.needs_replay:
        names |= REPLAY
    if config is None or config.needs_regressor:
        names |= REGRESSOR
    if config is None or (isinstance(model, Model) and model.places is not None):
        names |= LOCATOR | {"locate_on_map"}
    if config is None or (isinstance(model, Model) and model.places is None):
        names |= CLASSIFIER | WHOLE_NETWORK | {"absorb_and_decide"}
    fill_cache(names)
    compile_kernels(names)
    return time.perf_counter() - started


def compile_for(
    config: TNTConfig,
    classifier: object,
    regressor: object,
    triggers: TriggerSettings,
    finds_late: bool,
) -> None:
    """Compile, in this process and without a word, what a Processor with these settings calls.

    Parameters
    ----------
    config : TNTConfig.
    classifier, regressor : what decides, and what finds the landmark or None; other code than ours
        is not compiled.
    triggers : when decisions are made.
    finds_late : whether late events are searched for.
    """
    compiled = classifier if type(classifier) is CompiledClassifier else None
    finds_objects = compiled is not None and compiled.reader is not None
    names = EVENTS | (
        OTHER_CLASSIFIERS if compiled is None else LOCATOR if finds_objects else CLASSIFIER
    )
    if compiled is None and getattr(classifier, "places", None) is not None:
        names |= {"locate_on_map"}
    if finds_late:
        names |= LATE
    if config.needs_replay:
        names |= REPLAY
    if type(regressor) is CompiledRegressor:
        names |= REGRESSOR
    if triggers.by_event:
        names |= EVENT_TRIGGERS
    if (
        (triggers.by_event or triggers.every_us)
        and compiled
        and not finds_objects
        and not config.needs_replay
    ):
        names |= {"absorb_and_decide"}
    compile_kernels(names)


def compile_kernels(names: Iterable[str]) -> None:
    """Compile these kernels, or load them from Numba's cache."""
    with _not_collecting():
        for name in _in_order(names):
            compile_for_types(*ENTRY_POINTS[name])


def fill_cache(
    names: Iterable[str] | None = None,
    model: object = None,
    first: Callable[[], object] = lambda: None,
) -> None:
    """Where nothing has been compiled yet, say so on stderr and compile these kernels with two
    processes.

    The commands call it with their model, for the largest kernels of its streams, before they make
    a `Processor`.

    Parameters
    ----------
    first : called before a compilation. It raises what would otherwise show only 20 s later.
    """
    names = names or EVENTS | (
        LOCATOR if getattr(model, "places", None) is not None else CLASSIFIER
    )
    absorb, types = ENTRY_POINTS["absorb"]
    with _not_collecting():
        if is_cached(absorb, types):
            return
    first()
    if not can_be_cached(absorb):
        told = "in every process, as no cache folder can be written; set NUMBA_CACHE_DIR to one that can"
        print(f"async_tnt: compiling kernels, {told} ...", file=sys.stderr, flush=True)
        return
    print(
        "async_tnt: compiling kernels, once on this machine (8 to 20 s) ...",
        file=sys.stderr,
        flush=True,
    )
    # the network's kernels and those for events have nothing in common; `absorb_and_decide` has
    # both
    network = (CLASSIFIER | LOCATOR | REGRESSOR).intersection(names)
    child = _start_child(_in_order(network | {"forward"})) if network else None
    if child is None:
        return
    try:
        # the child finds these in the cache when it needs them
        for kernel, types in PARTS + (MAP_PARTS if LOCATOR & network else ()):
            compile_for_types(kernel, types)
        compile_kernels(set(names) - network - {"forward", "absorb_and_decide"})
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(CHILD_S)
    finally:
        child.kill()
        child.wait()


@contextlib.contextmanager
def _not_collecting() -> Iterator[None]:
    """Without garbage collection: a tenth of the time, and Numba makes no garbage in the
    meantime."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


def _in_order(names: Iterable[str]) -> list[str]:
    """Kernels in the order of compilation: what is built of others comes after them."""
    wanted = set(names)
    return [name for name in ENTRY_POINTS if name in wanted]


def _start_child(names: list[str]) -> subprocess.Popen[bytes] | None:
    """Start a process that compiles these kernels into the cache; None where that cannot be or
    would save no time."""
    if available_cores() < 2 or not sys.executable or getattr(sys, "frozen", False):
        return None
    # -P, and our own path: it shall find the same modules as this process, and nothing in the
    # current folder
    path = os.pathsep.join(os.path.abspath(folder) for folder in sys.path if folder)
    nothing: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    code = (
        f"from async_tnt.streaming.compile_ahead import compile_kernels; compile_kernels({names})"
    )
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-c", code], env=os.environ | {"PYTHONPATH": path}, **nothing
        )
    except OSError:
        return None
