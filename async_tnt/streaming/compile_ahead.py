"""Compile the kernels of a stream before its first event.

No event then waits for the compiler.
"""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

from async_tnt.base.checks import ParameterTypeError
from async_tnt.base.messages import short
from async_tnt.base.package import available_cores
from async_tnt.kernels.jit import can_be_cached, compile_for_types, is_cached
from async_tnt.kernels.network.forward import forward
from async_tnt.kernels.volume.absorb import absorb
from async_tnt.networks.loading import load_model
from async_tnt.networks.models.compiled import CompiledClassifier, CompiledRegressor
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.objects import ObjectReader
from async_tnt.streaming.entry_points import MAP_PARTS, NETWORK_PARTS, TYPES, Kernel
from async_tnt.streaming.triggers import Triggers, TriggerSettings
from async_tnt.streaming.window_classifier import WindowClassifier
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.events import EventDecoder
from async_tnt.volume.replay import ReplayBuffer
from async_tnt.volume.volume import TNTVolume

CHILD_S = 120.0
"""Seconds that this process waits for a second process that compiles."""

EVERY_STREAM = {*EventDecoder.KERNELS, *TNTVolume.KERNELS, *Triggers.KERNELS}
"""Kernels that every stream calls."""
OTHER_CLASSIFIERS = {*TNTVolume.ARRAY_KERNELS, *WindowClassifier.KERNELS}
"""Kernels that a stream also calls if its classifier is not a CompiledClassifier."""
NETWORKS = {
    *CompiledClassifier.KERNELS,
    *CompiledClassifier.MAP_KERNELS,
    *CompiledRegressor.KERNELS,
}
"""Kernels of networks. They and the kernels of events call no kernel in common: two processes can
compile them at the same time."""


def warmup(model: Model | TNTConfig | str | Path | None = None) -> float:
    """Compile everything that a stream may call, or load it from Numba's cache.

    The first time on a machine this takes some seconds: a line on stderr says so, and a second
    process compiles the network's kernels meanwhile. Later it takes a fraction of a second. After
    it, no event waits for the compiler.

    Parameters
    ----------
    model : the model of the streams, or its name or path, or a configuration for streams with other
        classifiers; by default everything is compiled, for any stream.

    Returns
    -------
    float : how many seconds the compilation took.
    """
    started_s = time.perf_counter()
    if isinstance(model, (str, Path)):
        model = load_model(model)
    if not isinstance(model, (Model, TNTConfig, type(None))):
        rule = "must be a Model, the name or path of one, or a TNTConfig"
        raise ParameterTypeError("model", rule, short(model))
    kernels = _kernels_for_any_settings(model)
    fill_cache(kernels)
    compile_kernels(kernels)
    return time.perf_counter() - started_s


def _kernels_for_any_settings(model: Model | TNTConfig | None) -> set[Kernel]:
    """All kernels that streams of a model, or of a configuration, may call.

    model : None stands for any model: all kernels are returned.
    """
    config = model.config if isinstance(model, Model) else model
    finds_objects = isinstance(model, Model) and model.places is not None
    classifies = isinstance(model, Model) and model.places is None

    kernels = EVERY_STREAM | OTHER_CLASSIFIERS
    kernels |= {*EventDecoder.LATE_KERNELS, *Triggers.EVENT_KERNELS}
    if config is None or config.needs_replay:
        kernels |= {*ReplayBuffer.KERNELS}
    if config is None or config.needs_regressor:
        kernels |= {*CompiledRegressor.KERNELS}
    if model is None or finds_objects:
        kernels |= {*CompiledClassifier.MAP_KERNELS, *ObjectReader.KERNELS}
    if model is None or classifies:
        kernels |= {*CompiledClassifier.KERNELS, *CompiledClassifier.STRETCH_KERNELS}
        kernels |= {*CompiledClassifier.ARRAY_KERNELS}
    return kernels


def compile_for(
    config: TNTConfig,
    classifier: object,
    regressor: object,
    triggers: TriggerSettings,
    finds_late: bool,
) -> None:
    """Compile the kernels that a Processor with these settings calls.

    They are compiled in this process, and nothing is printed.

    Parameters
    ----------
    config : TNTConfig.
    classifier : the callable that decides. Only our own code is compiled.
    regressor : the callable that finds the landmark, or None.
    triggers : when decisions are made.
    finds_late : whether late events are searched for.
    """
    kernels = set(EVERY_STREAM)
    if finds_late:
        kernels |= {*EventDecoder.LATE_KERNELS}
    if config.needs_replay:
        kernels |= {*ReplayBuffer.KERNELS}
    if triggers.by_event:
        kernels |= {*Triggers.EVENT_KERNELS}
    if type(regressor) is CompiledRegressor:
        kernels |= {*CompiledRegressor.KERNELS}

    if type(classifier) is not CompiledClassifier:
        kernels |= OTHER_CLASSIFIERS
        if getattr(classifier, "places", None) is not None:
            kernels |= {*ObjectReader.KERNELS}
    elif classifier.reader is not None:
        kernels |= {*CompiledClassifier.MAP_KERNELS}
    else:
        kernels |= {*CompiledClassifier.KERNELS}
        has_triggers = triggers.by_event or triggers.every_us is not None
        if has_triggers and not config.needs_replay:
            kernels |= {*CompiledClassifier.STRETCH_KERNELS}
    compile_kernels(kernels)


def compile_kernels(kernels: Iterable[Kernel]) -> None:
    """Compile these kernels, or load them from Numba's cache."""
    with _not_collecting():
        for kernel in _in_order(kernels):
            compile_for_types(kernel, TYPES[kernel])


def compile_named(names: Collection[str]) -> None:
    """Compile the kernels with these names. The second process calls this."""
    compile_kernels([kernel for kernel in TYPES if kernel.__name__ in names])


def fill_cache(
    kernels: Iterable[Kernel] | None = None,
    model: object = None,
    first: Callable[[], object] = lambda: None,
) -> None:
    """Compile kernels with two processes, if nothing has been compiled on this machine yet.

    A line on stderr says so. The commands call this with their model, for the largest kernels of
    its streams, before they make a `Processor`.

    Parameters
    ----------
    kernels : kernels to compile; by default the kernels that every stream of the model calls.
    model : the model of the streams.
    first : called before a compilation. It raises errors that would otherwise show only 20 s later.
    """
    if kernels is None:
        finds_objects = getattr(model, "places", None) is not None
        of_network = CompiledClassifier.MAP_KERNELS if finds_objects else CompiledClassifier.KERNELS
        wanted = EVERY_STREAM | {*of_network}
    else:
        wanted = set(kernels)
    with _not_collecting():
        if is_cached(absorb, TYPES[absorb]):
            return
    first()
    if not can_be_cached(absorb):
        _say(
            "compiling kernels, in every process, as no cache folder can be written; set "
            "NUMBA_CACHE_DIR to one that can ..."
        )
        return
    _say("compiling kernels, once on this machine (10 to 30 s) ...")
    _compile_with_a_second_process(wanted)


def _compile_with_a_second_process(kernels: set[Kernel]) -> None:
    """Let a second process compile the network's kernels, and compile the others here.

    `absorb_and_decide` calls kernels of both kinds, so it is compiled later.
    """
    of_network = kernels & NETWORKS
    if not of_network:
        return
    of_network.add(forward)  # the other kernels of networks call it
    child = _start_child([kernel.__name__ for kernel in _in_order(of_network)])
    if child is None:
        return
    try:
        # the child finds these kernels in the cache when it needs them
        finds_objects = not of_network.isdisjoint(CompiledClassifier.MAP_KERNELS)
        parts = NETWORK_PARTS + MAP_PARTS if finds_objects else NETWORK_PARTS
        for kernel in parts:
            compile_for_types(kernel, TYPES[kernel])
        compile_kernels(kernels - of_network - {*CompiledClassifier.STRETCH_KERNELS})
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(CHILD_S)
    finally:
        child.kill()
        child.wait()


def _say(text: str) -> None:
    print(f"async_tnt: {text}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def _not_collecting() -> Iterator[None]:
    """Run the block without garbage collection, which takes a tenth of the time.

    Numba makes no garbage in the meantime.
    """
    was_collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_collecting:
            gc.enable()


def _in_order(kernels: Iterable[Kernel]) -> list[Kernel]:
    """Kernels in the order of compilation: a kernel that calls others comes after them."""
    order = list(TYPES)
    return sorted(set(kernels), key=order.index)


def _start_child(names: list[str]) -> subprocess.Popen[bytes] | None:
    """Start a process that compiles these kernels into the cache.

    Returns None where a second process is impossible, or would save no time.
    """
    if available_cores() < 2 or not sys.executable or getattr(sys, "frozen", False):
        return None
    # -P, and our own path: the second process shall find the same modules as this process, and no
    # modules in the current folder
    path = os.pathsep.join(os.path.abspath(folder) for folder in sys.path if folder)
    code = f"from async_tnt.streaming.compile_ahead import compile_named; compile_named({names})"
    nothing: dict[str, Any] = {
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
    }
    environment = os.environ | {"PYTHONPATH": path}
    try:
        return subprocess.Popen([sys.executable, "-P", "-c", code], env=environment, **nothing)
    except OSError:
        return None
