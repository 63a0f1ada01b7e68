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
    Model,
    Processor,
    SpikingVolume,
    TNTConfig,
    TNTVolume,
    kernels,
)
from async_tnt.kernels.jit import BOUNDS_CHECKED
from async_tnt.kernels.lock import LARGE
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.forward import forward
from async_tnt.kernels.sources.pixels import RECORD_BYTES, count_events, keep_events
from async_tnt.networks.layers.program import make_program
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


LARGE_SENSOR = TNTConfig(sensor=(200, 150), grid=(200, 150), transform="none")


def whole_passes():
    model = raw_model(LARGE_SENSOR)
    arrays = make_program(model.network["classifier"], LARGE_SENSOR.shape, model.weights).arrays

    def compute():
        arrays.program[P.STALE] = 1
        forward(*arrays)

    return compute


def raw_outputs():
    """A call that reads two volumes in turn, so that it always computes the whole network."""
    network = CompiledNetwork(raw_model(LARGE_SENSOR))
    events = random_events(5_000, duration_us=9_000, sensor=LARGE_SENSOR.sensor)
    volumes = itertools.cycle([opened(LARGE_SENSOR, events), opened(LARGE_SENSOR, events)])
    return lambda: network.refresh(next(volumes))


def objects():
    conv = {"op": "conv", "name": "map", "inputs": ["volume"], "weights": {"weight": "w"}}
    sides = {"kernel": [3, 3], "stride": [1, 1], "padding": [1] * 4, "dilation": [1, 1]}
    weights = {"w": np.random.default_rng(0).normal(size=(2, LARGE_SENSOR.channels, 3, 3))}
    network = {"classifier": [{**conv, **sides, "groups": 1}]}
    model = Model(LARGE_SENSOR, weights, ["a"], network=network)
    classifier = CompiledClassifier(model)
    tracks = Processor(model)._classifier._tracks
    events = random_events(5_000, duration_us=9_000, sensor=LARGE_SENSOR.sensor)
    volumes = itertools.cycle([opened(LARGE_SENSOR, events), opened(LARGE_SENSOR, events)])
    return lambda: classifier.locate(next(volumes), tracks, 0, False)


def filtering():
    n = 50 * LARGE
    columns = EventDecoder((34, 34)).decode(random_events(n))
    verdicts = np.zeros((34, 34), np.uint8)
    records = np.empty(RECORD_BYTES * n, np.uint8)
    return lambda: keep_events(*columns[:4], n, verdicts, 0, 0, records)


def counting():
    n = 50 * LARGE
    columns = EventDecoder((34, 34)).decode(random_events(n))
    counts = np.zeros((34, 34), np.int64)
    return lambda: count_events(columns.x, columns.y, n, counts)


def spikes():
    volume = SpikingVolume(random_spiking_model(9))
    volume.open(0)
    events = random_events(LARGE, duration_us=CONFIG.window_us, sensor=CONFIG.sensor)
    columns = EventDecoder(CONFIG.sensor).decode(events)
    return lambda: volume.absorb(columns, 0, LARGE)


@pytest.mark.skipif(BOUNDS_CHECKED, reason="the lock is kept where indices are checked")
@pytest.mark.parametrize("made", [whole_passes, raw_outputs, objects, filtering, counting, spikes])
def test_others_run_during_every_call_that_takes_long(made):
    assert others_run_during(made())


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
