"""The engines that are compared. Each runs a model's classifier.

Each engine runs on one thread, and is called as users call it.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from async_tnt import CompiledClassifier, Model
from experiments.speed.timing import is_installed

Network = Callable[[np.ndarray], np.ndarray]
"""Volume (C, H, W) -> logits (n_classes,), float32, in memory that the next call may overwrite."""


class Engine(NamedTuple):
    """An engine that runs a model's classifier."""

    work: str
    """What a call does, in words."""
    make: Callable[[Model], Network]
    """Makes the engine's network of a model."""
    packages: tuple[str, ...] = ()
    """Packages that the engine needs."""


def _onnxruntime_run(model: Model) -> Network:
    session = _session(model)

    def run(volume: np.ndarray) -> np.ndarray:
        return session.run(["logits"], {"volume": volume[None]})[0][0]

    return run


def _onnxruntime_binding(model: Model) -> Network:
    session = _session(model)
    inputs = np.zeros((1, *model.config.shape), np.float32)
    outputs = np.zeros((1, len(model.classes)), np.float32)
    binding = session.io_binding()
    binding.bind_input("volume", "cpu", 0, np.float32, inputs.shape, inputs.ctypes.data)
    binding.bind_output("logits", "cpu", 0, np.float32, outputs.shape, outputs.ctypes.data)
    volume_in = inputs[0]
    logits = outputs[0]

    def run(volume: np.ndarray) -> np.ndarray:
        np.copyto(volume_in, volume)
        session.run_with_iobinding(binding)
        return logits

    return run


def _session(model: Model) -> Any:
    """A session of ONNX Runtime with the exported network, on one thread."""
    from async_tnt.networks.onnx.export import to_onnx
    from async_tnt.networks.onnx.network import open_session

    return open_session(
        to_onnx(model).SerializeToString(), "the exported network", threads=1
    ).session


def _openvino(model: Model) -> Network:
    import openvino

    from async_tnt.networks.onnx.export import to_onnx

    core = openvino.Core()
    settings = {
        "INFERENCE_NUM_THREADS": 1,
        "INFERENCE_PRECISION_HINT": "f32",
        "PERFORMANCE_HINT": "LATENCY",
    }
    network = core.read_model(io.BytesIO(to_onnx(model).SerializeToString()))
    request = core.compile_model(network, "CPU", settings).create_infer_request()
    inputs: np.ndarray = np.zeros((1, *model.config.shape), np.float32)
    tensor = openvino.Tensor(inputs, shared_memory=True)
    request.set_input_tensor(tensor)
    logits: Any = request.get_output_tensor().data[0]

    def infer(volume: np.ndarray) -> np.ndarray:
        np.copyto(inputs[0], volume)
        request.infer()
        return logits

    return infer


def _torch(model: Model) -> Network:
    import torch

    from async_tnt.networks.models.torch_modules import torch_classifier

    network = torch_classifier(model)
    tensor = torch.zeros(model.config.shape)
    memory = tensor.numpy()

    def run(volume: np.ndarray) -> np.ndarray:
        np.copyto(memory, volume)
        with torch.inference_mode():
            logits: np.ndarray = network(tensor[None])[0].numpy()
        return logits

    return run


ENGINES = {
    "incremental": Engine(
        "ours, CompiledClassifier.refresh: what has changed since its last call; gives "
        "probabilities, too",
        CompiledClassifier,
    ),
    "dense": Engine(
        "ours, CompiledClassifier called with an array: the whole network",
        CompiledClassifier,
    ),
    "onnxruntime_run": Engine(
        "onnxruntime, session.run: the array goes in as it is, a new one comes out",
        _onnxruntime_run,
        ("onnx", "onnxruntime"),
    ),
    "onnxruntime_binding": Engine(
        "onnxruntime, run_with_iobinding: memory bound once, the volume copied into it",
        _onnxruntime_binding,
        ("onnx", "onnxruntime"),
    ),
    "openvino": Engine(
        "OpenVINO, float32, hint LATENCY: an infer request's own memory, the volume copied into it",
        _openvino,
        ("onnx", "openvino"),
    ),
    "torch": Engine(
        "torch, eager, inference mode: a tensor, the volume copied into it",
        _torch,
        ("torch", "tnt_reference"),
    ),
}
"""Row of the tables -> its engine."""

NEEDS = {name: engine.packages for name, engine in ENGINES.items()}
"""Engine -> packages that it needs."""

ONNXRUNTIME = ("onnxruntime_run", "onnxruntime_binding")
"""Ways of calling onnxruntime. Which one is faster differs from machine to machine."""


def dense_networks(model: Model) -> dict[str, Network]:
    """Name of an engine -> its network, for installed engines that compute the whole network.

    Ours comes first. Each network has its own copy of the weights, so that no network finds them in
    a cache that another one has filled. The number of torch's threads is not changed; see
    `timing.one_thread`.
    """
    installed = {name: engine for name, engine in ENGINES.items() if is_installed(*engine.packages)}
    return {name: engine.make(model) for name, engine in installed.items() if name != "incremental"}


def left_out(needs: Mapping[str, tuple[str, ...]] = NEEDS) -> dict[str, str]:
    """Row -> a message that names its missing packages, for rows with missing packages."""
    missing = {row: _missing(*packages) for row, packages in needs.items()}
    return {row: why for row, why in missing.items() if why}


def _missing(*packages: str) -> str:
    """A message that names the packages that are not installed; empty if all are."""
    names = [package for package in packages if not is_installed(package)]
    if not names:
        return ""
    verb = "is" if len(names) == 1 else "are"
    return f"{' and '.join(names)} {verb} not installed"
