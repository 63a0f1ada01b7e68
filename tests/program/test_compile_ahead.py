"""When a stream opens, all kernels that it calls have been compiled.

A second process helps where it is asked for.
"""

import socket
import subprocess
import sys

import pytest

import async_tnt
from async_tnt.kernels import jit
from async_tnt.sources import sample_recordings
from async_tnt.streaming import compile_ahead

STREAMS = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from async_tnt import CompiledClassifier, EVENT_DTYPE, Processor, TNTConfig, load_model, warmup
from made import random_model

def compiled():
    # also what was loaded from the cache: on a new machine it would be compiled
    found = set()
    for name, module in list(sys.modules.items()):
        if name.startswith("async_tnt.kernels."):
            for kernel in vars(module).values():
                if isinstance(kernel, Dispatcher):
                    found |= {(kernel.py_func.__name__, types) for types in kernel.signatures}
    return found

records = np.zeros(4, EVENT_DTYPE)
records["t"] = [0, 3, 50_000, 250_000]
columns = tuple(records[name].copy() for name in ("t", "x", "y", "p"))
TRIGGERS = {}, {"every_events": 1}, {"confidence": 0.5, "late": "drop"}

def stream_all(model, **networks):
    for settings in TRIGGERS:
        processor = Processor(model, **networks, **settings)
        for packet in (records, columns, (300_000, 1, 1, 1), (300_001, 1, 1, 1)):
            processor.push(packet)
        processor.fire(), processor.finish()

MODELS = {
    kind: random_model(TNTConfig(landmark=kind), widths=(2, 2, 2))
    for kind in ("running", "window", "regressor")
}
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
finder = Processor(load_model("digits-everywhere"), every_events=1)
finder.push(columns), finder.fire()
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
streams = [(model, {}) for model in MODELS.values()]
streams += [(TNTConfig(), other), (MODELS["regressor"], other)]
processors = [
    Processor(model, **networks, **settings)
    for model, networks in streams
    for settings in TRIGGERS
]
"""
    + PUSH,
    "a_trigger_or_a_classifier_is_set": """
processors = [Processor(model) for model in MODELS.values() for settings in TRIGGERS]
for processor, settings in zip(processors, TRIGGERS * len(MODELS)):
    for name in settings.keys() - {"late"}:
        setattr(processor, name, settings[name])
processors.append(Processor(TNTConfig(), classifier=lambda volume: [0.0], every_events=1))
processors[-1].classifier = CompiledClassifier(MODELS["running"])
"""
    + PUSH,
}

OF_EVERY_STREAM = {
    "load_records",
    "check_columns",
    "empty_volume",
    "absorb",
    "absorb_one",
    "schedule",
}


@pytest.mark.parametrize("case", CASES)
def test_nothing_is_compiled_after(case, pytestconfig):
    path = f"import sys; sys.path.insert(0, {str(pytestconfig.rootpath / 'tests')!r})"
    code = path + STREAMS + CASES[case] + "print(*compiled() - before)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "\n"), done.stderr


@pytest.fixture
def cold(monkeypatch):
    """A machine with two cores where nothing has been compiled yet.

    Gives the kernels that are then compiled in this process.
    """
    here: list[str] = []

    def note(kernels):
        here.extend(kernel.__name__ for kernel in kernels)

    monkeypatch.setattr(compile_ahead, "is_cached", lambda kernel, types: False)
    monkeypatch.setattr(compile_ahead, "can_be_cached", lambda kernel: True)
    monkeypatch.setattr(compile_ahead, "available_cores", lambda: 2)
    monkeypatch.setattr(compile_ahead, "compile_kernels", note)
    return here


def test_a_processor_starts_no_process_and_prints_nothing(cold, monkeypatch, capsys):
    monkeypatch.setattr(subprocess, "Popen", None)
    async_tnt.Processor(async_tnt.TNTConfig(), classifier=len)
    assert set(cold) >= OF_EVERY_STREAM and capsys.readouterr() == ("", "")


def test_a_second_process_compiles_the_network(cold, capsys, monkeypatch):
    children = []
    start = compile_ahead._start_child

    def start_noted(names):
        child = start(names)
        children.append((names, child))
        return child

    monkeypatch.setattr(compile_ahead, "_start_child", start_noted)
    compile_ahead.fill_cache()
    [(names, child)] = children
    assert names == ["forward", "classify_cells"] and child.returncode == 0
    assert set(cold) == OF_EVERY_STREAM
    assert "compiling kernels, once on this machine" in capsys.readouterr().err


def test_warmup_compiles_what_a_second_process_failed_to(cold, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    assert async_tnt.warmup(async_tnt.load_model("digits")) > 0
    assert {"absorb", "classify_cells", "absorb_and_decide"} <= set(cold)


@pytest.mark.parametrize(
    ("words", "messages"),
    [
        ("run camera", ["camera: "]),
        ("run nowhere.bin gone.npy", ["nowhere.bin", "gone.npy"]),
        ("run udp://127.0.0.1:TAKEN", ["udp://127.0.0.1:TAKEN: Address already in use"]),
        (
            "run udp://127.0.0.1:TAKEN camera nowhere.bin",
            ["udp://127.0.0.1:TAKEN: ", "camera: ", "nowhere.bin"],
        ),
        ("view camera --out a.rrd", ["camera: "]),
        ("view nowhere.bin --out a.rrd", ["nowhere.bin"]),
        ("check nowhere.bin", ["nowhere.bin"]),
        ("record camera --class a --out new", ["camera: "]),
        (
            "record udp://127.0.0.1:TAKEN --class a --out new --sensor 9x9",
            ["udp://127.0.0.1:TAKEN: Address already"],
        ),
    ],
)
def test_a_source_that_is_not_there_is_told_before_anything_is_compiled(
    words, messages, program, cold, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compile_ahead, "_start_child", cold.append)
    monkeypatch.setattr(jit, "compile_for_types", lambda kernel, types: cold.append(kernel))
    with socket.socket(type=socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = str(other.getsockname()[1])
        code, out, err = program(*words.replace("TAKEN", port).split())
    lines = err.splitlines()
    assert (code, out, len(lines), cold) == (2, "", len(messages), [])
    assert all(
        message.replace("TAKEN", port) in line
        for message, line in zip(messages, lines, strict=True)
    )


def test_a_source_that_does_not_suit_is_told_before_the_network_is_compiled(
    program, cold, monkeypatch
):
    monkeypatch.setattr(compile_ahead, "_start_child", cold.append)
    code, _, err = program("run", "udp://127.0.0.1:0", "--roi", "0,0,34,34", "--crop")
    assert (code, err.count("\n"), cold) == (2, 1, [])
    assert "does not say the camera's pixels" in err


def test_one_source_that_is_there_is_enough(program, cold, monkeypatch):
    monkeypatch.setattr(compile_ahead, "_start_child", lambda names: None)
    code, out, err = program("run", "nowhere.bin", sample_recordings()[3])
    first, second = err.splitlines()
    assert code == 2 and "3.bin: 3 " in out
    assert "compiling kernels" in first and "nowhere.bin" in second
