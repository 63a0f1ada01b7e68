"""Wait for a sign from another thread, task or process, for as long as a busy machine may take;
read in both ways."""

import asyncio
import threading
import time
from contextlib import contextmanager

import pytest

PATIENCE_S = 600


def until(condition):
    """Return when `condition()` is true."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "nothing happened"
        time.sleep(0.001)


@contextmanager
def meanwhile(function, *args):
    """Run a function in a thread during the block, which ends when the thread has."""
    thread = threading.Thread(target=function, args=args, daemon=True)
    thread.start()
    yield thread
    thread.join(PATIENCE_S)
    assert not thread.is_alive()


def in_a_loop(source):
    with source:
        return list(source)


def in_a_task(source):
    async def run():
        async with source:
            return [packet async for packet in source]

    return asyncio.run(run())


in_both_ways = pytest.mark.parametrize("read", [in_a_loop, in_a_task])
