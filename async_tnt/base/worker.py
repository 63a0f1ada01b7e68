"""Worker processes, which call functions for this process and may crash or hang without harm to it.

Workers are started by `subprocess`, not by `multiprocessing`, for two reasons. `multiprocessing`
would import the user's script again, which then needs the line `if __name__ == "__main__":`. And
with it a daemonic process, such as a worker of torch's DataLoader, could not start any worker.
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

MAX_ANSWER_BYTES = 1 << 30
"""Most bytes of an answer. There is a limit, because a process that is about to crash may send
anything."""


class WorkerEnded(ChildProcessError):
    """A worker crashed or was killed, or did not answer in time."""


class Worker:
    """A process that calls importable functions until `end`, or until this process ends in any way.

    A worker has its own process group: Ctrl-C reaches this process alone, which then ends its
    workers.

    Attributes
    ----------
    pipe : a connection for `multiprocessing.connection.wait`. It is ready when there is an answer,
        or when the process has ended.
    """

    def __init__(self) -> None:
        self.pipe, worker_pipe = connection.Pipe()
        paths = os.pathsep.join(map(os.path.abspath, sys.path))
        stdin = worker_pipe.fileno()
        if sys.platform == "win32":
            import msvcrt

            stdin = msvcrt.open_osfhandle(stdin, 0)
        with worker_pipe:
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
        """Whether the process has not ended yet."""
        return self._process.poll() is None

    def submit(self, function: Callable[..., Any], *args: Any, limit_s: float = 0.0) -> None:
        """Call a function after the earlier calls have returned.

        If the call takes more than `limit_s` seconds, the process ends. 0 stands for no limit.
        """
        call = pickle.dumps((function, args, limit_s))
        # An error means that the process has ended. `result` then raises WorkerEnded.
        with contextlib.suppress(OSError):
            self.pipe.send_bytes(call)

    def result(self, limit_s: float | None = None) -> Any:
        """The value that the oldest call returned.

        limit_s : seconds to wait for the value; None: without a limit.

        Raises
        ------
        Exception : the error that the call raised, with the worker's traceback as a note.
        WorkerEnded : no answer came in time, or the process has ended.
        """
        ended_error = WorkerEnded(
            "a worker process crashed, hung, was killed, or ran out of memory"
        )
        try:
            if not connection.wait([self.pipe], limit_s):
                raise ended_error
            is_error, value = pickle.loads(self.pipe.recv_bytes(MAX_ANSWER_BYTES))
        except (EOFError, OSError, pickle.UnpicklingError):
            raise ended_error from None
        if is_error:
            raise value
        return value

    def end(self) -> None:
        """End the process, in the middle of its call if it has one."""
        self._process.kill()
        self._process.wait()
        self.pipe.close()


def serve() -> None:
    """Answer calls in a worker; they come through its standard input, a pipe in both directions."""
    # the pipe is moved away from standard input, so that no called function reads from it
    fd = os.dup(0)
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
    """Queue calls; when the parent is gone, end this process, even in the middle of a call."""
    try:
        while True:
            calls.put(pipe.recv_bytes())
    except (EOFError, OSError):
        os._exit(1)


def _answer(call: bytes) -> bytes:
    """Call a function, and return the pickle of (False, its value) or of (True, its error)."""
    try:
        function, args, limit_s = pickle.loads(call)
        # `faulthandler` ends the process, because a library that hangs may never let a thread of
        # Python run
        if limit_s:
            faulthandler.dump_traceback_later(limit_s, exit=True)
        return pickle.dumps((False, function(*args)), pickle.HIGHEST_PROTOCOL)
    except BaseException as error:  # a panic in Rust derives from BaseException alone
        traceback_text = traceback.format_exc()
        sendable = _sendable(error)
        sendable.add_note(traceback_text)
        return pickle.dumps((True, sendable))


def _sendable(error: BaseException) -> Exception:
    """The error itself if a pickle can hold it, else a RuntimeError with its text.

    An error that cannot be sent would look as if the worker had ended.
    """
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:
        copy = None
    if isinstance(error, Exception) and isinstance(copy, Exception):
        return error
    return RuntimeError(f"{type(error).__name__}: {error}")
