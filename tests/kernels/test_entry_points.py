"""Entry points: one compiled code for fixed types, which other kernels call by its symbol."""

import os
import subprocess
import sys

import numpy as np
import pytest
from numba import float64, int64

from async_tnt.kernels.decisions.classify import classify_cells, softmax
from async_tnt.kernels.entry_points import ENTRY_POINTS, EntryPoint, entry_point
from async_tnt.kernels.jit import BOUNDS_CHECKED


@entry_point(float64[::1], int64)
def element(numbers, place):
    return numbers[place]


@entry_point(float64[::1], int64, calls=(element,))
def twice(numbers, place):
    return 2.0 * element(numbers, place)


@pytest.fixture(autouse=True)
def made_here():
    """The entry points above are this file's own."""
    for entry in (element, twice):
        if entry in ENTRY_POINTS:
            ENTRY_POINTS.remove(entry)


def called_by(entry):
    """The symbols of entry points that the code of one calls, also if the code was loaded."""
    module = entry.result.library._get_module_for_linking()
    names = {function.name for function in module.functions if function.is_declaration}
    return {name for name in names if name.startswith("async_tnt.")}


def test_what_an_entry_point_calls_is_compiled_once_and_with_it():
    numbers = np.array([1.0, 2.5])
    assert twice.call(numbers, 1) == twice(numbers, 1) == twice.checked(numbers, 1) == 5.0
    assert element.is_ready and len(element.kernel.overloads) == 1
    # the caller's code names the callee's symbol, and does not contain its code
    assert called_by(twice) == {element.symbol}


def test_other_arguments_are_refused_and_not_compiled_for():
    softmax.prepare()
    with pytest.raises(TypeError):
        softmax(np.zeros(3), np.zeros(3))
    with pytest.raises(TypeError):
        softmax(np.zeros(6, np.float32)[::2], np.zeros(3))
    assert len(softmax.kernel.overloads) == 1


def test_callees_are_listed_before_their_callers():
    places = {entry.name: k for k, entry in enumerate(ENTRY_POINTS)}
    assert len(places) == len(ENTRY_POINTS)
    for entry in ENTRY_POINTS:
        assert all(places[called.name] < places[entry.name] for called in entry.calls)


def test_an_entry_point_states_what_it_calls():
    """Its code would otherwise be loaded before a symbol that it needs."""
    for entry in ENTRY_POINTS:
        entry.prepare()
        assert called_by(entry) == {called.symbol for called in entry.calls}, entry.name


@pytest.mark.skipif(not BOUNDS_CHECKED, reason="indices are checked with NUMBA_BOUNDSCHECK=1 only")
def test_an_index_out_of_bounds_passes_through_the_caller():
    with pytest.raises(IndexError):
        twice.call(np.zeros(2), 7)


IN_TWO_THREADS = """
import threading
from async_tnt.kernels.decisions.classify import classify_cells
threads = [threading.Thread(target=classify_cells.prepare) for _ in range(4)]
[thread.start() for thread in threads], [thread.join() for thread in threads]
print(classify_cells.is_ready, len(classify_cells.kernel.overloads))
"""


def test_threads_may_prepare_the_same_kernel():
    done = subprocess.run([sys.executable, "-c", IN_TWO_THREADS], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("True 1\n", "")


COMPILING = """
import logging, sys
from async_tnt.kernels import entry_points, jit
entry_points.WARN_AFTER_S = SECONDS
from async_tnt.kernels.decisions import trigger
entries = trigger.schedule, trigger.until_due, trigger.why_due
print([entry.is_quick for entry in entries])
for entry in entries:
    entry.prepare()
"""


def test_a_wait_is_said_once(tmp_path):
    """A process that compiles says so, after some time; a process that loads says nothing."""
    # where a variable such as NUMBA_OPT is set, here to its default, the package's code is not used
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cold"), "NUMBA_OPT": "3"}
    for seconds, n_lines in (("0", 1), ("0", 0)):
        code = COMPILING.replace("SECONDS", seconds)
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert (done.returncode, done.stderr.count("\n")) == (0, n_lines)
        assert done.stdout == f"{[n_lines == 0] * 3}\n"  # what was compiled before is quick
        if n_lines:
            assert "once on this machine" in done.stderr and " is set" in done.stderr
    environment["NUMBA_CACHE_DIR"] = str(tmp_path / "another")
    command = [sys.executable, "-c", COMPILING.replace("SECONDS", "1e9")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


SWITCHED = """
import gc
gc.SWITCH()
from async_tnt import TNTConfig, TNTVolume
TNTVolume(TNTConfig()).update(([1], [2], [3], [1]))
print(gc.isenabled())
"""


@pytest.mark.parametrize(("switch", "is_on"), [("enable", True), ("disable", False)])
def test_a_program_without_garbage_collection_remains_so(switch, is_on):
    """While a kernel is compiled or loaded, there is none. It is on afterwards if it was before."""
    code = SWITCHED.replace("SWITCH", switch)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    # it may also say, as a warning, that it compiles
    assert done.stdout == f"{is_on}\n", done.stderr


def test_every_entry_point_has_a_name_and_a_description():
    assert isinstance(classify_cells, EntryPoint)
    assert classify_cells.name == "decisions.classify.classify_cells"
    assert all(entry.__doc__ for entry in ENTRY_POINTS)
