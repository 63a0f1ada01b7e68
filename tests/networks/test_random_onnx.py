"""Random ONNX files: what is accepted computes what onnxruntime computes, whatever the volume.

ASYNC_TNT_FUZZ_CASES makes it a long run: it was 5,000 once.
"""

import os

import numpy as np
import pytest
from networks.test_random_modules import volumes_of

from async_tnt import CompiledClassifier, TNTConfig, load_model
from async_tnt.networks.onnx_operations import RULES

pytest.importorskip("onnx", reason="needs onnx: pip install 'async_tnt[onnx]'")
onnxruntime = pytest.importorskip("onnxruntime", reason="needs onnxruntime: pip install 'async_tnt[onnx]'")
from networks.random_onnx import SHAPE, random_onnx  # noqa: E402

CASES = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", "300"))
CONFIG = TNTConfig(sensor=(8, 9), grid=(8, 9), bins=2)


def is_right(model, proto, seed: int) -> bool:
    """Within 1e-4 of the largest number, after the softmax if the network has one."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level, options.intra_op_num_threads = 4, 1
    session = onnxruntime.InferenceSession(proto.SerializeToString(), options)
    volumes = [volume.astype(np.float32) for volume in volumes_of(CONFIG, seed)]
    expected = np.stack([session.run(None, {"x": volume[None]})[0].reshape(-1) for volume in volumes])
    found = np.stack([CompiledClassifier(model)(volume) for volume in volumes]).astype(np.float64)
    if any(node.op_type == "Softmax" for node in proto.graph.node):
        odds = np.exp(found - found.max(axis=1, keepdims=True))
        found = odds / odds.sum(axis=1, keepdims=True)
    return expected.shape == found.shape and bool(np.abs(found - expected).max() <= 1e-4 * np.abs(expected).max())


def test_what_is_accepted_is_right(tmp_path):
    assert CONFIG.shape == SHAPE
    accepted, path, operations = 0, tmp_path / "net.onnx", set()
    for seed in range(CASES):
        proto = random_onnx(seed)
        path.write_bytes(proto.SerializeToString())
        try:
            model = load_model(path, config=CONFIG)
        except (NotImplementedError, ValueError):
            continue
        accepted += 1
        assert is_right(model, proto, seed), seed
        operations |= {node.op_type for node in proto.graph.node}
    assert accepted > 0.4 * CASES and operations == set(RULES)
