"""Columns that another thread changes while they are used.

Any numbers may come out, but no memory is damaged.

Each case runs in a process of its own, which a write beyond an array would end.
"""

import pytest
from processes import started

START = """
import threading
import numpy as np
from async_tnt import PixelFilter, Processor, TNTConfig, TNTVolume, load_model
from async_tnt.sources import learn_mask

n = 50_000
t = np.arange(n, dtype=np.int64)
x = np.full(n, 5, np.uint16)
y = np.full(n, 7, np.uint16)
p = np.ones(n, np.uint8)
columns = t, x, y, p
stop = threading.Event()

def change():
    valid = [column.copy() for column in columns]
    values = 1 << 61, 65_535, 65_535, 255
    beyond = [np.full(n, value, column.dtype) for value, column in zip(values, columns)]
    while not stop.is_set():
        for values in (beyond, valid):
            for column, new in zip(columns, values):
                column[:] = new

def again(use, times=120):
    thread = threading.Thread(target=change)
    thread.start()
    try:
        for _ in range(times):
            try:
                use()
            except ValueError:  # what was changed before it was checked
                pass
    finally:
        stop.set()
        thread.join()
"""
CASES = {
    "volume": """
volume = TNTVolume(TNTConfig(window_us=1_000_000_000))
def use():
    volume.open(0)
    volume.update(columns)
again(use)
""",
    "images of times": """
volume = TNTVolume(TNTConfig(window_us=1_000_000_000, representation="count_time"))
def use():
    volume.open(0)
    volume.update(columns)
again(use)
""",
    "events that are replayed": """
volume = TNTVolume(TNTConfig(window_us=1_000_000_000, landmark="window"))
def use():
    volume.open(0)
    volume.update(columns)
    volume.array
again(use, 40)
""",
    "decisions": """
processor = Processor(load_model("digits"), every_us=20_000)
def use():
    processor.reset()
    processor.push(columns)
again(use, 40)
""",
    "filter": """
pixel_filter = PixelFilter((34, 34), roi=(2, 2, 20, 20), crop=True)
again(lambda: pixel_filter(columns))
""",
    "mask": """
again(lambda: learn_mask([columns], (34, 34)))
""",
}


@pytest.mark.parametrize("case", CASES)
def test_columns_that_change_damage_no_memory(case):
    with started("-W", "ignore", "-c", START + CASES[case]) as process:
        _, err = process.communicate()
    assert (process.returncode, err) == (0, "")
