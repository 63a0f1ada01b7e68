"""Time cold and warm starts in new processes, from `import` to the first decision.

    python -m experiments.starts [--quick] [--json FILE]

Our program starts with an empty and with a full cache of compiled code. With an empty cache it
takes the code in `async_tnt/kernels/compiled`, which `python -m async_tnt.kernels.ship` writes;
without it, everything is compiled. The program is compared with programs of onnxruntime and torch,
if these are installed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt import Model, load_model, warmup
from async_tnt.base.progress import progress
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed import backends
from experiments.speed.timing import machine, spread

MODEL = "digits"
"""The model that decides."""

ROUNDS = 5
"""Number of processes of each way."""

PACKAGES = ("torch", "onnx", "onnxruntime")
"""Packages whose versions the report names."""

WORK = {
    "ours_cold": "ours, with an empty NUMBA_CACHE_DIR",
    "ours_warm": "ours, with a full one",
    "onnxruntime": "onnxruntime: import, a session of the exported network, its first answer",
    "torch": "torch: import, the same network from the model's file, its first answer",
}
"""Way -> what it does."""

NEEDS = {"onnxruntime": ("onnx", "onnxruntime"), "torch": ("torch", "tnt_reference")}
"""Way -> packages that it needs."""

_OURS = """
from async_tnt import Processor, load_model
step("import")
model = load_model(arguments["model"])
step("load")
processor = Processor(model, start_us=0)
step("processor")
processor.push_one(1000, 1, 1, 1)
processor.fire()
step("decision")
"""
"""Program of `ours_cold` and `ours_warm`, which `_TIMED_PROGRAM` holds."""

_ONNXRUNTIME = """
import numpy as np
import os
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
import onnxruntime
step("import")
options = onnxruntime.SessionOptions()
options.intra_op_num_threads = 1
options.inter_op_num_threads = 1
providers = ["CPUExecutionProvider"]
session = onnxruntime.InferenceSession(arguments["onnx"], options, providers=providers)
step("load")
session.run(["logits"], {"volume": np.zeros(arguments["shape"], np.float32)})
step("decision")
"""
"""Program of onnxruntime, which `_TIMED_PROGRAM` holds."""

_TORCH = """
import torch
from safetensors.torch import load_file
from tnt_reference import Classifier
step("import")
torch.set_num_threads(1)
tensors = load_file(arguments["model"])
layers = ("conv1", "conv2", "fc1", "fc2")
# the file also has statistics of the classes
weights = {name: w for name, w in tensors.items() if name.partition(".")[0] in layers}
widths = tuple(len(weights[layer + ".bias"]) for layer in layers[:3])
channels, height, width = arguments["shape"][1:]
network = Classifier(channels, (width, height), len(weights["fc2.bias"]), widths).eval()
network.load_state_dict(weights)
step("load")
with torch.inference_mode():
    network(torch.zeros(arguments["shape"])).argmax()
step("decision")
"""
"""Program of torch, which `_TIMED_PROGRAM` holds."""

_TIMED_PROGRAM = """
import json, sys, time
arguments = json.loads(sys.argv[1])
seconds = {{}}
last = time.perf_counter()
def step(name):
    global last
    now = time.perf_counter()
    seconds[name] = now - last
    last = now
{body}
print(json.dumps(seconds))
"""
"""Program that holds one of the programs above and prints the seconds of its steps as JSON."""


def bench_starts(model: Model, rounds: int, cold: bool) -> dict[str, Any]:
    """Times that programs take to start.

    Each round has one process of each row. A first round, which fills the system's file cache, is
    not counted.

    Parameters
    ----------
    cold : whether the row `ours_cold` is measured, with a new cache folder in each round. If not,
        nothing is compiled, and `ours_warm` uses the cache of this process.

    Returns
    -------
    dict : row of `WORK` -> step -> `spread` of its seconds. The step `process` is the whole process
        with Python's own start and end. Rows whose packages are missing are left out.
    """
    rows = [name for name in WORK if name not in left_out(cold)]
    seconds: dict[str, dict[str, list[float]]] = {name: {} for name in rows}
    with tempfile.TemporaryDirectory() as temporary, progress(rounds + 1, "fresh processes") as bar:
        folder = Path(temporary)
        model.save(folder / "model.safetensors")
        arguments = {"model": str(folder / "model.safetensors"), "shape": [1, *model.config.shape]}
        if "onnxruntime" in rows:
            from async_tnt.networks.onnx.export import to_onnx

            arguments["onnx"] = str(folder / "model.onnx")
            (folder / "model.onnx").write_bytes(to_onnx(model).SerializeToString())
        for k in range(rounds + 1):
            bar.update()
            # the order alternates, so that no row always starts after the same other row
            for name in rows if k % 2 else reversed(rows):
                if k == 0 and name == "ours_cold":
                    continue
                cache = None
                if cold:
                    cache = folder / (f"cold {k}" if name == "ours_cold" else "warm")
                for step, step_seconds in _start(name, arguments, cache).items():
                    if k:
                        seconds[name].setdefault(step, []).append(step_seconds)
    return {
        name: {step: spread(np.array(step_seconds)) for step, step_seconds in steps.items()}
        for name, steps in seconds.items()
    }


def left_out(cold: bool) -> dict[str, str]:
    """Row of `WORK` that is not measured -> the reason."""
    quick = {} if cold else {"ours_cold": "compiling takes too long for a quick look"}
    return quick | backends.left_out(NEEDS)


def _start(name: str, arguments: dict[str, Any], cache: Path | None) -> dict[str, float]:
    """Seconds of each step of one process, of all steps, and of the whole process."""
    body = {"onnxruntime": _ONNXRUNTIME, "torch": _TORCH}.get(name, _OURS)
    settings = {
        "OMP_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
    }
    if cache is not None:
        cache.mkdir(exist_ok=True)
        settings["NUMBA_CACHE_DIR"] = str(cache)
    environment = os.environ | settings
    # Python may write bytecode, because an installed package has bytecode, too
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    command = [sys.executable, "-c", _TIMED_PROGRAM.format(body=body), json.dumps(arguments)]
    started = time.perf_counter()
    process = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    process_seconds = time.perf_counter() - started
    if process.returncode:
        raise RuntimeError(f"the start of {name} failed:\n{process.stderr}")
    steps: dict[str, float] = json.loads(process.stdout)
    return {**steps, "first_decision": sum(steps.values()), "process": process_seconds}


def measure(quick: bool) -> dict[str, Any]:
    """The report of all starts, as one JSON object."""
    model = load_model(MODEL)
    rounds = 1 if quick else ROUNDS
    warmup(model)
    starts = bench_starts(model, rounds, cold=not quick)
    settings: dict[str, Any] = {
        "machine": machine(*PACKAGES),
        "quick": quick,
        "rounds": rounds,
        "work": WORK,
    }
    return settings | {"starts": starts, "left_out": left_out(cold=not quick)}


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write the files that are asked for."""
    parser = script_parser("starts", __doc__, "one round, nothing compiled")
    return run_script(parser, argv, measure, "starts")


if __name__ == "__main__":
    exit_with(main)
