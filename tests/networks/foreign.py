"""ONNX networks as other programs write them: of any inputs, outputs, types and shapes."""

import numpy as np
import pytest

from async_tnt import load_model
from async_tnt.networks import OnnxClassifier

onnx = pytest.importorskip("onnx", reason="onnx is not installed (extra `onnx`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `onnx`)")

node = onnx.helper.make_node
TensorProto = onnx.TensorProto
WEIGHTS = {
    "w": np.random.default_rng(0).normal(size=(60, 3)),
    "b": np.random.default_rng(1).normal(size=3),
}


def load_for_numbers(path, config):
    """The model of a file, for the classes "0", "1", ..."""
    try:
        (shape,) = load_model(path, config=config).output_shapes.values()
        n_classes = shape[0]
    except NotImplementedError:  # a softmax is left out of a network of classes only
        n_classes = OnnxClassifier(path, shape=config.shape).n_classes
    return load_model(path, config=config, classes=[str(k) for k in range(n_classes)])


def network(
    nodes=None,
    *,
    inputs=(("image", (1, 2, 6, 5)),),
    outputs=(("scores", (1, 3)),),
    dtype=TensorProto.FLOAT,
    output_dtype=None,
    weights=None,
    metadata=None,
    opset=13,
):
    """Flatten and Gemm, unless `nodes` are given."""
    if nodes is None:
        nodes = [
            node("Flatten", [inputs[0][0]], ["flat"]),
            node("Gemm", ["flat", "w", "b"], [outputs[0][0]]),
        ]
        weights = {
            name: w.astype(onnx.helper.tensor_dtype_to_np_dtype(dtype))
            for name, w in WEIGHTS.items()
        }
    info = onnx.helper.make_tensor_value_info
    graph = onnx.helper.make_graph(
        nodes,
        "foreign",
        [info(name, dtype, shape) for name, shape in inputs],
        [
            info(name, dtype if output_dtype is None else output_dtype, shape)
            for name, shape in outputs
        ],
        [onnx.numpy_helper.from_array(np.asarray(w), name) for name, w in (weights or {}).items()],
    )
    opsets = [onnx.helper.make_opsetid("", opset), onnx.helper.make_opsetid("my", 1)]
    made = onnx.helper.make_model(graph, opset_imports=opsets, ir_version=7)
    onnx.helper.set_model_props(made, metadata or {})
    return made.SerializeToString()


def linear(volume):
    """What `network()` computes, in NumPy."""
    return (volume.reshape(-1) @ WEIGHTS["w"] + WEIGHTS["b"]).astype(np.float32)
