"""Worker processes, which call one function after another and may crash or hang without harm to
this process.

`subprocess` starts them: a process of `multiprocessing` imports the user's script again, which then
needs the line `if __name__ == "__main__":`, and a daemonic process, such as a worker of torch's
DataLoader, may not start any.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import pickle
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from multiprocessing import connection
from queue import SimpleQueue
from typing import Any

MAX_ANSWER_BYTES = 1 << 30  # a process that is about to crash may send anything


class WorkerEnded(ChildProcessError):
    """A worker crashed or was killed, or did not answer in time."""


class Worker:
    """A process that calls importable functions until `end`, or until this process ends in any way.

    It has its own process group, so that Ctrl-C reaches this process alone, which ends its workers.

    Attributes
    ----------
    pipe : ready, for `multiprocessing.connection.wait`, when there is an answer or the process has
        ended.
    """

    def __init__(self) -> None:
        self.pipe, theirs = connection.Pipe()
        paths = os.pathsep.join(map(os.path.abspath, sys.path))
        stdin = theirs.fileno()
        if sys.platform == "win32":
            import msvcrt

            stdin = msvcrt.open_osfhandle(stdin, 0)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", "from async_tnt.base.worker import serve; serve()"],
                stdin=stdin,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": paths, "RUST_BACKTRACE": "0"},
                process_group=0,
            )

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None

    def submit(self, function: Callable[..., Any], *args: Any, limit_s: float = 0.0) -> None:
        """Call a function after those before have returned; a call that takes more than `limit_s`
        ends the process."""
        call = pickle.dumps((function, args, limit_s))
        with contextlib.suppress(OSError):  # the process has ended: `result` raises
            self.pipe.send_bytes(call)

    def result(self, limit_s: float | None = None) -> Any:
        """What the oldest call returned, or its error, raised, with the worker's traceback as a
        note.

        Raises
        ------
        WorkerEnded : no answer within `limit_s` (None: however long it takes), or none any more.
        """
        try:
            answer = (
                self.pipe.recv_bytes(MAX_ANSWER_BYTES)
                if connection.wait([self.pipe], limit_s)
                else b""
            )
            is_error, value = pickle.loads(answer)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise WorkerEnded(
                "a worker process crashed, hung, was killed, or ran out of memory"
            ) from None
        if is_error:
            raise value
        return value

    def end(self) -> None:
        """End the process, in the middle of its call if it has one."""
        self._process.kill()
        self._process.wait()
        self.pipe.close()


def serve() -> None:
    """In a worker: answer the calls that come through its standard input, a pipe in both
    directions."""
    fd = os.dup(0)  # nothing that is called may read it
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    if sys.platform == "win32":
        import msvcrt

        pipe = connection.PipeConnection(msvcrt.get_osfhandle(fd))
    else:
        pipe = connection.Connection(fd)
    calls: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_receive, args=(pipe, calls), daemon=True).start()
    while True:
        answer = _answer(calls.get())
        faulthandler.cancel_dump_traceback_later()  # the parent may be slow to read
        pipe.send_bytes(answer)


def _receive(pipe: Any, calls: SimpleQueue[bytes]) -> None:
    """Queue calls; when the parent is gone, end this process, also in the middle of a call."""
    try:
        while True:
            calls.put(pipe.recv_bytes())
    except (EOFError, OSError):
        os._exit(1)


def _answer(call: bytes) -> bytes:
    try:
        function, args, limit_s = pickle.loads(call)
        if limit_s:  # a library that hangs may never let a thread of Python run
            faulthandler.dump_traceback_later(limit_s, exit=True)
        return pickle.dumps((False, function(*args)), pickle.HIGHEST_PROTOCOL)
    except BaseException as error:  # a panic in Rust derives from BaseException alone
        note = traceback.format_exc()
        try:
            is_plain = isinstance(pickle.loads(pickle.dumps(error)), Exception)
        except Exception:  # what cannot be sent would look like the worker's end
            is_plain = False
        if not is_plain:
            error = RuntimeError(f"{type(error).__name__}: {error}")
        error.add_note(note)
        return pickle.dumps((True, error))
