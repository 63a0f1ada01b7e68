"""A Model's networks as ONNX graphs, node by node.

Opset 13 and IR version 7, those of ONNX 1.8 (2020): nothing here needs more, and what reads ONNX reads these.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.networks.model import HEATMAP, REGRESSOR_LAYERS, Model
from async_tnt.networks.onnx_metadata import CLASSIFIER, REGRESSOR, metadata_of, seal

if TYPE_CHECKING:
    import onnx

OPSET, IR_VERSION = 13, 7
MAX_BYTES = 1 << 31  # of a protobuf message


def to_onnx(model: Model) -> onnx.ModelProto:
    """The classifier of a model: input `volume` (1, C, H, W), output `logits` (1, n_classes), float32.

        Conv, Relu, AveragePool, Conv, Relu, AveragePool, Flatten, Gemm, Relu, Gemm

    Weights are initializers under their names in `Model.weights`. `metadata_props` hold what a model file's metadata
    holds (`format`, `config`, `classes`, `record`), `network`, `weights`, a hash of all weights, and `sha256`, one of
    the whole file.

    Raises
    ------
    ImportError : onnx is not installed.
    ValueError : the weights are too large for one ONNX file (2 GiB).
    """
    node, _ = _makers()
    nodes = [
        *_convolution("conv1", "volume", "conv1.rectified"),
        node("AveragePool", ["conv1.rectified"], ["conv1.pooled"], kernel_shape=[2, 2], strides=[2, 2]),
        *_convolution("conv2", "conv1.pooled", "conv2.rectified"),
        node("AveragePool", ["conv2.rectified"], ["conv2.pooled"], kernel_shape=[2, 2], strides=[2, 2]),
        node("Flatten", ["conv2.pooled"], ["features"]),
        node("Gemm", ["features", "fc1.weight", "fc1.bias"], ["fc1.sum"], transB=1),
        node("Relu", ["fc1.sum"], ["fc1.rectified"]),
        node("Gemm", ["fc1.rectified", "fc2.weight", "fc2.bias"], ["logits"], transB=1),
    ]
    weights = {name: w for name, w in model.weights.items() if not name.startswith("regressor.")}
    return _model(model, CLASSIFIER, nodes, weights, ("logits", np.float32, len(model.classes)))


def regressor_to_onnx(model: Model) -> onnx.ModelProto:
    """The landmark network of a model: input `volume` (1, C, H, W), float32, without the transform; output
    `landmark` (1, 2), float64: (x, y) in grid pixels.

        Conv, Relu, Conv, Relu, Conv, Relu, Conv 1x1, Cast, Flatten, Softmax, Gemm

    The last three in float64: l = c + sum_i softmax(e)_i ((x_i, y_i) - c), the expectation of a place under a softmax
    over all places, with distances from the middle c, so that an even heatmap gives it to 1e-13 pixels.

    Raises
    ------
    ImportError : onnx is not installed.
    ValueError : the model has no regressor.
    """
    if not model.config.needs_regressor:
        raise ValueError(
            'the model has no regressor: that needs landmark="regressor" and transform="tnt", '
            f"got landmark={model.config.landmark!r}, transform={model.config.transform!r}"
        )
    node, onnx = _makers()
    nodes: list[Any] = []
    values = "volume"
    for layer in REGRESSOR_LAYERS:
        nodes += _convolution(layer, values, f"{layer}.rectified")
        values = f"{layer}.rectified"
    nodes += [
        node("Conv", [values, HEATMAP], ["exponent"], kernel_shape=[1, 1]),
        node("Cast", ["exponent"], ["exponent.float64"], to=onnx.TensorProto.DOUBLE),
        node("Flatten", ["exponent.float64"], ["places"]),
        node("Softmax", ["places"], ["heatmap"], axis=1),
        node("Gemm", ["heatmap", "from_middle", "middle"], ["landmark"]),
    ]
    _, height, width = model.config.shape
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    places = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)  # (H W, 2), rows of x
    weights = {name: w for name, w in model.weights.items() if name.startswith("regressor.")}
    weights |= {"from_middle": places - middle, "middle": middle}
    return _model(model, REGRESSOR, nodes, weights, ("landmark", np.float64, 2))


def _convolution(layer: str, values: str, rectified: str) -> list[Any]:
    """A 3x3 convolution that keeps the size, and its ReLU."""
    node, _ = _makers()
    total = f"{layer}.sum"
    inputs = [values, f"{layer}.weight", f"{layer}.bias"]
    return [node("Conv", inputs, [total], kernel_shape=[3, 3], pads=[1] * 4), node("Relu", [total], [rectified])]


def _makers() -> tuple[Any, Any]:
    """`onnx.helper.make_node`, and onnx."""
    try:
        import onnx
    except ImportError as error:
        raise ImportError(
            f"ONNX networks are written by onnx and run by onnxruntime: pip install '.[onnx]' ({error})"
        ) from None
    return onnx.helper.make_node, onnx


def _model(
    model: Model, network: str, nodes: Sequence[Any], weights: dict[str, np.ndarray], output: tuple[str, Any, int]
) -> onnx.ModelProto:
    from async_tnt.version import __version__

    _, onnx = _makers()
    n_bytes = sum(w.nbytes for w in weights.values())
    if n_bytes >= MAX_BYTES:
        raise ValueError(f"an ONNX file holds less than 2 GiB, the {network}'s weights are {n_bytes:_} bytes")
    make, types = onnx.helper, onnx.helper.np_dtype_to_tensor_dtype
    name, dtype, size = output
    graph = make.make_graph(
        nodes,
        network,
        [make.make_tensor_value_info("volume", types(np.dtype(np.float32)), [1, *model.config.shape])],
        [make.make_tensor_value_info(name, types(np.dtype(dtype)), [1, size])],
        [onnx.numpy_helper.from_array(w, key) for key, w in weights.items()],
    )
    made = make.make_model(
        graph,
        opset_imports=[make.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="async_tnt",
        producer_version=__version__,
    )
    make.set_model_props(made, metadata_of(model, network))
    seal(made)
    onnx.checker.check_model(made, full_check=True)
    return made
