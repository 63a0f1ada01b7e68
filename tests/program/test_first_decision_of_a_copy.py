"""A Processor from a pickle, in a new process, has compiled its kernels before its first event."""

import pickle

import pytest
from deciding import CONFIG, total_and_size
from made import random_events, random_model, random_regressor_model
from processes import started

from async_tnt import Processor

SCRIPT = """
import pickle
import sys
from async_tnt.kernels.entry_points import ENTRY_POINTS

def ready():
    # also what was loaded: on another machine it would be compiled
    return {entry.name for entry in ENTRY_POINTS if entry.is_ready}

made = pickle.load(open(sys.argv[1], "rb"))
events = pickle.load(open(sys.argv[2], "rb"))
before = ready()
made.push(events)
made.push_one(*events.tolist()[-1])
made.push(tuple(events[-3:][name].copy() for name in "txyp"))
made.fire()
print(sorted(ready() - before))
"""
MADE = {
    "classes": lambda: Processor(random_model(CONFIG)),
    "every_us": lambda: Processor(random_model(CONFIG), every_us=300, late="drop"),
    "every_events": lambda: Processor(random_model(CONFIG), every_events=5),
    "regressor": lambda: Processor(random_regressor_model(CONFIG.replace(landmark="regressor"))),
    "landmark window": lambda: Processor(
        CONFIG.replace(landmark="window"), classifier=total_and_size, late="drop"
    ),
}


@pytest.mark.parametrize("name", MADE)
def test_an_unpickled_stream_does_not_compile_while_events_come(name, tmp_path):
    (tmp_path / "made").write_bytes(pickle.dumps(MADE[name]()))
    (tmp_path / "events").write_bytes(pickle.dumps(random_events(600, duration_us=2_500)))
    with started("-c", SCRIPT, tmp_path / "made", tmp_path / "events") as process:
        out, err = process.communicate()
    assert out == "[]\n", err
