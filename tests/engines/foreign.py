"""ONNX networks that other people might bring: of any inputs, outputs, types and shapes."""

import numpy as np
import pytest

onnx = pytest.importorskip("onnx", reason="onnx is not installed (extra `onnx`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `onnx`)")

helper, TensorProto = onnx.helper, onnx.TensorProto


def network(
    *,
    inputs=(("image", (1, 2, 6, 5)),),
    outputs=(("scores", (1, 3)),),
    dtype=TensorProto.FLOAT,
    output_dtype=None,
    nodes=None,
    weights=None,
    metadata=None,
    opset=13,
):
    """Flatten and Gemm, unless `nodes` are given."""
    size = 2 * 6 * 5
    if nodes is None:
        nodes = [
            helper.make_node("Flatten", [inputs[0][0]], ["flat"]),
            helper.make_node("Gemm", ["flat", "w", "b"], [outputs[0][0]]),
        ]
        rng = np.random.default_rng(0)
        kind = helper.tensor_dtype_to_np_dtype(dtype)
        weights = {"w": rng.normal(size=(size, 3)).astype(kind), "b": rng.normal(size=3).astype(kind)}
    output_dtype = dtype if output_dtype is None else output_dtype
    graph = helper.make_graph(
        nodes,
        "foreign",
        [helper.make_tensor_value_info(name, dtype, shape) for name, shape in inputs],
        [helper.make_tensor_value_info(name, output_dtype, shape) for name, shape in outputs],
        [onnx.numpy_helper.from_array(w, name) for name, w in (weights or {}).items()],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=7)
    helper.set_model_props(made, metadata or {})
    return made.SerializeToString()


def linear(volume):
    """What `network()` computes, in NumPy."""
    rng = np.random.default_rng(0)
    w, b = rng.normal(size=(60, 3)).astype(np.float32), rng.normal(size=3).astype(np.float32)
    return volume.reshape(1, -1) @ w + b


def node(kind, inputs, outputs, **attributes):
    return helper.make_node(kind, inputs, outputs, **attributes)
