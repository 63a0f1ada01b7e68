"""When a stream opens, all kernels that it calls have been compiled."""

import socket
import subprocess
import sys

import pytest

from async_tnt.kernels.entry_points import EntryPoint
from async_tnt.sources import sample_recordings

STREAMS = """
import numpy as np
from async_tnt import CompiledClassifier, EVENT_DTYPE, Processor, TNTConfig, load_model, warmup
from async_tnt.kernels.entry_points import ENTRY_POINTS
from made import random_model

def ready():
    # also what was loaded: on another machine it would be compiled
    return {entry.name for entry in ENTRY_POINTS if entry.is_ready}

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
before = ready()
for processor in processors:
    for packet in (records, columns, (300_000, 1, 1, 1)):
        processor.push(packet)
    processor.fire(), processor.finish()
"""
CASES = {
    "warmup_for_anything": """
warmup()
before = ready()
for model in MODELS.values():
    stream_all(model)
    CompiledClassifier(model)(np.zeros(model.config.shape))
stream_all(MODELS["running"].config, classifier=lambda volume: [0.0])
finder = Processor(load_model("digits-everywhere"), every_events=1)
finder.push(columns), finder.fire()
""",
    "warmup_for_a_model_and_for_a_configuration": """
of_function = {"classifier": lambda volume: [0.0]}
warmup(TNTConfig(landmark="window"))
before = ready()
stream_all(TNTConfig(landmark="window"), **of_function)
missed = ready() - before
warmup(TNTConfig(landmark="regressor"))
before = ready()
stream_all(TNTConfig(landmark="regressor"), regressor=lambda raw: (1.0, 2.0), **of_function)
missed |= ready() - before
warmup(MODELS["regressor"])
before = ready() - missed
stream_all(MODELS["regressor"])
CompiledClassifier(MODELS["regressor"])(np.zeros(MODELS["regressor"].config.shape))
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


@pytest.mark.parametrize("case", CASES)
def test_nothing_is_compiled_after(case, pytestconfig):
    path = f"import sys; sys.path.insert(0, {str(pytestconfig.rootpath / 'tests')!r})"
    code = path + STREAMS + CASES[case] + "print(*ready() - before)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "\n"), done.stderr


@pytest.fixture
def cold(monkeypatch):
    """A machine where nothing has been compiled yet. Gives the entry points that are asked for."""
    asked: list[str] = []
    monkeypatch.setattr(EntryPoint, "is_quick", False)
    monkeypatch.setattr(EntryPoint, "prepare", lambda entry: asked.append(entry.name))
    return asked


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


def test_a_source_that_does_not_suit_is_told_before_the_network_is_compiled(program, cold):
    code, _, err = program("run", "udp://127.0.0.1:0", "--roi", "0,0,34,34", "--crop")
    assert (code, err.count("\n")) == (2, 1)
    assert all(name.startswith("sources.") for name in cold)
    assert "does not say the camera's pixels" in err


def test_one_source_that_is_there_is_enough(program, monkeypatch):
    monkeypatch.setattr(EntryPoint, "is_quick", False)
    code, out, err = program("run", "nowhere.bin", sample_recordings()[3])
    assert (code, err.count("\n")) == (2, 1)
    assert "3.bin: 3 " in out and "nowhere.bin" in err
