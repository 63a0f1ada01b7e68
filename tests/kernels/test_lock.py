"""Python's lock: other threads run while much is computed; for little it is kept."""

import ast
import itertools
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from made import opened, random_events, random_model, raw_model
from networks.random_spiking import CONFIG, random_spiking_model

from async_tnt import (
    CompiledClassifier,
    CompiledNetwork,
    Processor,
    SpikingVolume,
    TNTConfig,
    TNTVolume,
    kernels,
)
from async_tnt.kernels.jit import BOUNDS_CHECKED
from async_tnt.kernels.lock import LARGE
from async_tnt.sources import PixelFilter, learn_mask
from async_tnt.volume.events import EventDecoder


def calls(statement: ast.stmt, name: str) -> bool:
    """Whether a function of this name is called within a statement."""
    nodes = [node for node in ast.walk(statement) if isinstance(node, ast.Call)]
    return name in [ast.unparse(node.func) for node in nodes]


def test_what_releases_the_lock_takes_it_back():
    """Between the two stands no return, and no statement that raises."""
    n_found = 0
    for path in Path(kernels.__file__).parent.rglob("*.py"):
        for function in ast.walk(ast.parse(path.read_text())):
            if not isinstance(function, ast.FunctionDef):
                continue
            released = [i for i, line in enumerate(function.body) if calls(line, "release_gil")]
            taken = [i for i, line in enumerate(function.body) if calls(line, "take_gil")]
            assert len(released) == len(taken) <= 1, function.name
            if released:
                n_found += 1
                assert released[0] < taken[0], function.name
                for line in function.body[released[0] : taken[0] + 1]:
                    assert isinstance(line, (ast.Assign, ast.Expr, ast.For, ast.While))
                    for node in ast.walk(line):
                        assert not isinstance(node, (ast.Return, ast.Raise, ast.Assert))
    assert n_found == 4


def others_run_during(compute) -> bool:
    """Whether another thread gets the lock while something is computed again and again."""
    ready = threading.Event()
    ran = []
    other = threading.Thread(target=lambda: ran.append(ready.wait()))
    compute()  # It is compiled by now.
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1000)  # seconds: only a release of the lock lets the other go on
    try:
        other.start()
        ready.set()
        for _ in range(1000):
            compute()
            if ran:
                break
        return bool(ran)
    finally:
        sys.setswitchinterval(interval)
        other.join()


def release_in_calls():
    """Name -> a call of a kernel that takes long enough for others to run meanwhile."""
    model = random_model()
    events = random_events(5_000, seed=1, duration_us=9_000, sensor=model.config.sensor)
    array = np.ones(model.config.shape, np.float32)
    pixels = PixelFilter(model.config.sensor, roi=(2, 2, 20, 20))
    network = CompiledNetwork(raw_model(model.config))
    volumes = itertools.cycle(opened(model.config, events) for _ in range(2))
    spikes = SpikingVolume(random_spiking_model(9))
    spikes.open(0)
    columns = EventDecoder(CONFIG.sensor).decode(random_events(LARGE, sensor=CONFIG.sensor))
    columns.t[:] = 5
    maps = np.zeros((2, 200, 200), np.float32)
    finder = Processor(TNTConfig(), classifier=lambda volume: maps, classes=("a",))
    return {
        "a whole pass": lambda: network(array),
        "raw outputs": lambda: network.refresh(next(volumes)),
        "a filter": lambda: pixels(events),
        "a mask": lambda: learn_mask([events], model.config.sensor),
        "objects": finder.fire,
        "spikes": lambda: spikes.absorb(columns, 0, LARGE),
    }


@pytest.mark.skipif(BOUNDS_CHECKED, reason="the lock is kept where indices are checked")
@pytest.mark.parametrize(
    "name", ["a whole pass", "raw outputs", "a filter", "a mask", "objects", "spikes"]
)
def test_others_run_during_every_long_call(name):
    assert others_run_during(release_in_calls()[name])


@pytest.mark.skipif(BOUNDS_CHECKED, reason="the lock is kept where indices are checked")
@pytest.mark.parametrize("n", [LARGE - 1, 50 * LARGE])
def test_others_run_while_large_packets_are_added_and_whole_windows_classified(n):
    model = random_model()
    events = random_events(n, seed=1, duration_us=9_000, sensor=model.config.sensor)
    decoder = EventDecoder(model.config.sensor)
    classifier = CompiledClassifier(model)
    volumes = [TNTVolume(model.config), TNTVolume(model.config)]
    for volume in volumes:
        volume.update(events)
    columns = EventDecoder(model.config.sensor).decode(events)
    is_large = n >= LARGE
    assert others_run_during(lambda: decoder.decode(events)) == is_large
    assert others_run_during(lambda: [classifier.answer(volume) for volume in volumes]) == is_large
    assert others_run_during(lambda: volumes[0].absorb(columns, 0, n)) == is_large
    # The processor's kernel releases the lock before it calls the others.
    processor = Processor(model, every_events=LARGE)
    assert others_run_during(lambda: processor.push(events))
