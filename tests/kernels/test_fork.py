"""A fork waits until no other thread compiles, so that its child can compile."""

import os
import subprocess
import sys

import pytest

# A thread compiles until the main thread, which forks, waits for it. If the fork does not wait, the
# test ends at once.
FORK = """
import contextlib, os, signal, sys, threading, time, traceback
import numba
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from async_tnt import Processor, TNTConfig
from async_tnt.kernels import jit

begun, may_end, forked = threading.Event(), threading.Event(), threading.Event()
compile = Dispatcher.compile

def compile_slowly(kernel, types):
    with HELD:
        begun.set()
        may_end.wait()
        return compile(kernel, types)

def make_processor():
    return Processor(TNTConfig(), classifier=len).push(([1], [1], [1], [1]))

def compile_another():
    return numba.njit(lambda x: x + 1)(1)

def is_waited_for():
    frame = sys._current_frames()[threading.main_thread().ident]
    files = [call.f_code.co_filename for call, line in traceback.walk_stack(frame)]
    return jit.__file__ in files

def end_when_waited_for():
    while not (is_waited_for() or forked.is_set()):
        time.sleep(0.001)
    may_end.set()

Dispatcher.compile = compile_slowly
for work in (WORK, end_when_waited_for):
    threading.Thread(target=work, daemon=True).start()
    begun.wait()
child = os.fork()
if child == 0:
    make_processor()
    os._exit(0)
has_waited = may_end.is_set()
forked.set()
if not has_waited:
    os.kill(child, signal.SIGKILL)
print(has_waited, os.waitpid(child, 0)[1])
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.parametrize(
    ("work", "held"),
    [("make_processor", "contextlib.nullcontext()"), ("compile_another", "global_compiler_lock")],
    ids=["a Processor is made", "a function of the user is compiled"],
)
def test_a_fork_waits_for_a_thread_that_compiles(work, held):
    code = FORK.replace("WORK", work).replace("HELD", held)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "True 0\n", done.stderr
