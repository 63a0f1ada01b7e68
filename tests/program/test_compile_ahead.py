"""When a stream opens, all that it calls has been compiled, and a second process has taken half of the work."""

import subprocess
import sys

import pytest

import async_tnt
from async_tnt import compile_ahead

STREAMS = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from async_tnt import CompiledClassifier, EVENT_DTYPE, LeakyIntegrator, Processor, TNTConfig, warmup
from made import random_model

def compiled():
    # also what was loaded from the cache: on a new machine it would be compiled
    modules = [module for name, module in sys.modules.items() if name.startswith("async_tnt.kernels.")]
    kernels = [kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Dispatcher)]
    return {(kernel.py_func.__name__, types) for kernel in kernels for types in kernel.signatures}

records = np.zeros(4, EVENT_DTYPE)
records["t"] = [0, 3, 50_000, 250_000]
columns = tuple(records[name].copy() for name in ("t", "x", "y", "p"))
TRIGGERS = {}, {"every_events": 1}, {"activity": LeakyIntegrator(1, 1000)}, {"confidence": 0.5, "late": "drop"}

def stream_all(model, **networks):
    for settings in TRIGGERS:
        processor = Processor(model, **networks, **settings)
        for packet in (records, columns, (300_000, 1, 1, 1), (300_001, 1, 1, 1)):
            processor.push(packet)
        processor.fire(), processor.finish()

MODELS = {kind: random_model(TNTConfig(landmark=kind), widths=(2, 2, 2)) for kind in ("running", "window", "regressor")}

"""
PUSH = """
before = compiled()
for processor in processors:
    for packet in (records, columns, (300_000, 1, 1, 1)):
        processor.push(packet)
    processor.fire(), processor.finish()
"""
CASES = {
    "warmup_for_anything": """
warmup()
before = compiled()
for model in MODELS.values():
    stream_all(model)
    CompiledClassifier(model)(np.zeros(model.config.shape))
stream_all(MODELS["running"].config, classifier=lambda volume: [0.0])
""",
    "warmup_for_a_model_and_for_a_configuration": """
warmup(MODELS["regressor"])
before = compiled()
stream_all(MODELS["regressor"])
missed = compiled() - before
warmup(TNTConfig(landmark="window"))
before = compiled() - missed
stream_all(TNTConfig(landmark="window"), classifier=lambda volume: [0.0])
""",
    "a_processor_is_made": """
other = {"classifier": lambda volume: [0.0], "classes": ("a",)}
streams = [*((model, {}) for model in MODELS.values()), (TNTConfig(), other), (MODELS["regressor"], other)]
processors = [Processor(model, **networks, **settings) for model, networks in streams for settings in TRIGGERS]
"""
    + PUSH,
    "a_trigger_is_set": """
processors = [Processor(model) for model in MODELS.values() for settings in TRIGGERS]
for processor, settings in zip(processors, TRIGGERS * len(MODELS)):
    for name in settings.keys() - {"late"}:
        setattr(processor, name, settings[name])
"""
    + PUSH,
    "a_classifier_is_set": """
processors = [Processor(TNTConfig(), classifier=lambda volume: [0.0], every_events=1)]
processors[0].classifier = CompiledClassifier(MODELS["running"])
"""
    + PUSH,
}


@pytest.mark.parametrize("case", CASES)
def test_nothing_is_compiled_after(case, pytestconfig):
    path = f"import sys; sys.path.insert(0, {str(pytestconfig.rootpath / 'tests')!r})"
    code = path + STREAMS + CASES[case] + "print(*compiled() - before)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "\n"), done.stderr


@pytest.mark.parametrize(
    "compiling, cached, told",
    [
        (True, True, "compiling kernels, once on this machine (about 10 s)"),
        (True, False, "in every process, as no cache folder can be written; set NUMBA_CACHE_DIR to one that can ("),
        (False, True, ""),
    ],
)
def test_a_long_wait_for_the_compiler_is_explained_and_one_for_the_disk_is_not(
    compiling, cached, told, monkeypatch, capsys
):
    monkeypatch.setattr(compile_ahead, "_is_compiled", lambda name: False)
    monkeypatch.setattr(compile_ahead, "_is_compiling", lambda: compiling)
    monkeypatch.setattr(compile_ahead, "can_be_cached", lambda kernel: cached)
    monkeypatch.setattr(compile_ahead, "_compile", lambda names: compile_ahead._explain_wait())
    assert async_tnt.warmup() > 0
    err = capsys.readouterr().err
    assert told in err and bool(err) == compiling and ("once on this machine" in err) == (compiling and cached)


@pytest.fixture
def cold(monkeypatch):
    """As on a machine with two cores where nothing has been compiled yet."""
    monkeypatch.setattr(compile_ahead, "_is_compiled", lambda name: False)
    monkeypatch.setattr(compile_ahead, "is_cached", lambda kernel, types: False)
    monkeypatch.setattr(compile_ahead, "available_cores", lambda: 2)


def test_a_second_process_compiles_the_network(cold):
    child = compile_ahead._start_child(["classify_cells", "softmax"])
    assert child.wait() == 0


def test_a_second_process_that_fails_leaves_the_work_to_the_first(cold, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    done = set()
    monkeypatch.setattr(compile_ahead, "_compile", done.update)
    assert async_tnt.warmup(async_tnt.load_model("digits")) > 0
    assert {"absorb", "classify_cells", "absorb_and_decide"} <= done


def test_no_second_process_where_it_would_not_pay(cold, monkeypatch):
    assert compile_ahead._start_child(["softmax"]) is None
    monkeypatch.setattr(compile_ahead, "available_cores", lambda: 1)
    assert compile_ahead._start_child(["classify_cells"]) is None
    monkeypatch.undo()
    async_tnt.warmup(async_tnt.load_model("digits"))
    assert compile_ahead._start_child(["classify_cells"]) is None  # the cache has it
