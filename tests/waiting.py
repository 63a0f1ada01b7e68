"""Waiting for another thread, task or process, for as long as a busy machine may take.

Reading a source in both ways, in a loop and in a task.
"""

import asyncio
import threading
import time
from contextlib import contextmanager

import pytest

PATIENCE_S = 600
"""Seconds after which nothing more is expected to happen."""


def until(condition):
    """Return when `condition()` is true."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "nothing happened"
        time.sleep(0.001)


@contextmanager
def meanwhile(function, *args):
    """Run a function in a thread during the block. The block waits at its end for the thread."""
    thread = threading.Thread(target=function, args=args, daemon=True)
    thread.start()
    yield thread
    thread.join(PATIENCE_S)
    assert not thread.is_alive()


def in_a_loop(source):
    """All packets of a source, read by `for`."""
    with source:
        return list(source)


def in_a_task(source):
    """All packets of a source, read by `async for`."""

    async def run():
        async with source:
            return [packet async for packet in source]

    return asyncio.run(run())


in_both_ways = pytest.mark.parametrize("read", [in_a_loop, in_a_task])
