"""ONNX networks as Models: what torch, Keras and others export of convolutional networks, and our
own files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.base.checks import needs_extra, one_line
from async_tnt.networks.layers.conversion_check import TOLERANCE, compare
from async_tnt.networks.layers.graph import CLASSIFIER, layer_shapes, tensors_of
from async_tnt.networks.models.compiled import CompiledClassifier
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.objects import logits_shape
from async_tnt.networks.onnx.export import read_metadata
from async_tnt.networks.onnx.layers import Node, OnnxLayers
from async_tnt.networks.onnx.network import open_session
from async_tnt.networks.onnx.operations import RULES
from async_tnt.volume.config import TNTConfig

if TYPE_CHECKING:
    import onnx

Layers = list[dict[str, Any]]

STANDARD = ("", "ai.onnx")  # the domain of ONNX's own operations
# before it, sums took an axis, and batch norms and dropouts trained unless told otherwise
FIRST_OPSET = 7
WAY_OUT = "; OnnxClassifier(path) runs any float32 network of logits, whole at every decision"


def load_onnx(path: Path, config: TNTConfig | None, classes: Sequence[str] | None) -> Model:
    """The model in an .onnx file, see `load_model`."""
    with needs_extra("onnx", "ONNX networks are read by onnx"):
        import onnx
    try:
        proto = onnx.load(path)  # and weights in files beside it
        onnx.checker.check_model(proto)
        metadata = {entry.key: entry.value for entry in proto.metadata_props}
        exported = read_metadata(metadata, path.read_bytes())
    except Exception as error:  # of many types
        raise ValueError(f"{path} is not a readable ONNX network: {one_line(error)}") from None
    if exported is not None:
        if config is not None or classes is not None:
            raise TypeError(
                f"`config` and `classes` are for networks of other programs; {path} has its own"
            )
        if exported.config.needs_regressor:
            raise NotImplementedError(
                f"the landmark network of {path} has no ONNX form: load the model it was exported "
                "from"
            )
        weights = {
            tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in proto.graph.initializer
        }
        own = exported.layers
        try:
            # checks them
            layer_shapes(own, exported.config.shape, {name: w.shape for name, w in weights.items()})
            used = {name: weights[name] for name in sorted(tensors_of(own)) if name in weights}
            return Model(
                exported.config, used, exported.classes, exported.record, network={CLASSIFIER: own}
            )
        except NotImplementedError as error:
            raise ValueError(
                f"{path} holds a network that this release cannot run: {one_line(error)}"
            ) from None
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path} holds a damaged model: {one_line(error, 1000)}") from None
    if config is None:
        raise TypeError(
            f"{path} does not say how events become its volume: load_model(path, "
            "config=TNTConfig(...), classes=[...])"
        )
    try:
        layers, weights = layers_from_onnx(proto, config.shape)
        if classes is None:
            shapes = layer_shapes(
                layers, config.shape, {name: w.shape for name, w in weights.items()}
            )
            read = logits_shape(list(shapes.values())[-1]) or (0,)
            classes = [str(k) for k in range(max(1, read[0] - (len(read) == 3)))]
        model = Model(config, weights, classes, network={CLASSIFIER: layers})  # type: ignore[arg-type]
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    except NotImplementedError as error:
        raise NotImplementedError(f"{path}: {error}{WAY_OUT}") from None
    try:
        _compare_with_onnxruntime(path, proto, model)
    except ValueError as error:
        raise NotImplementedError(f"{path} cannot be read as layers: {error}{WAY_OUT}") from None
    return model


def _compare_with_onnxruntime(path: Path, proto: onnx.ModelProto, model: Model) -> None:
    """Compare an ONNX network, run by onnxruntime, with the compiled layers that were read from it.

    Raises
    ------
    ImportError : onnxruntime is not installed.
    ValueError : see `compare`; or onnxruntime cannot open the file.
    """
    session, (given,), *_ = open_session(str(path), str(path), 1)
    dtype = input_type(proto)
    # at the end, or it has no layers
    softmax = any(node.op_type == "Softmax" for node in proto.graph.node)
    # some files fix a batch
    n = given.shape[0] if given.shape and isinstance(given.shape[0], int) else 1
    compiled = CompiledClassifier(model)

    def theirs(volume: np.ndarray) -> np.ndarray:
        answer: np.ndarray = session.run(
            None, {given.name: np.repeat(volume[None], n, 0).astype(dtype)}
        )[0]
        return np.asarray(answer.reshape(n, -1)[0], np.float64)

    def ours(volume: np.ndarray) -> np.ndarray:
        logits = compiled(volume).astype(np.float64)
        odds = np.exp(logits - logits.max(0))
        return odds / odds.sum(0) if softmax else logits

    compare(theirs, ours, model.config.shape, max(TOLERANCE, 8 * float(np.finfo(dtype).eps)))


def layers_from_onnx(
    model: onnx.ModelProto, shape: tuple[int, int, int]
) -> tuple[Layers, dict[str, np.ndarray]]:
    """The layers of a network of one input (N, C, H, W), here of this shape (C, H, W), and their
    weights. A softmax at its end is left out.

    Conv, Gemm, MatMul with a constant, BatchNormalization, sums and products with constants of one
    number or one for each channel; Relu, LeakyRelu, PRelu, Clip, Sigmoid, HardSigmoid, Tanh,
    HardSwish, Gelu, x Sigmoid(x), Log of x + 1; MaxPool, AveragePool, GlobalAveragePool, ReduceMean
    over all places; Add, Sum, Concat; Flatten, Reshape to (n, -1), Dropout, Identity.

    Raises
    ------
    NotImplementedError : names the first node that is not among these.
    """
    from onnx import numpy_helper

    graph, opset = model.graph, _check_meanings(model)
    inputs = _inputs(model)
    if len(inputs) != 1 or len(graph.output) != 1:
        raise NotImplementedError(
            f"the network must have one input and one output, got {len(inputs)} and "
            f"{len(graph.output)}"
        )
    sides = [side.dim_value for side in inputs[0].type.tensor_type.shape.dim][1:]  # 0: not fixed
    if sides and (
        len(sides) != 3 or any(side not in (0, own) for side, own in zip(sides, shape, strict=True))
    ):
        raise ValueError(
            f"the network's input must be the volume, N x {shape}, got N x {tuple(sides)}"
        )
    constants = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    made = OnnxLayers(inputs[0].name, shape, input_type(model), constants, opset)
    output = graph.output[0].name
    for node in map(Node, graph.node):
        rule = RULES.get(node.op)
        if rule is None or (node.op == "Softmax" and node.outputs[0] != output):
            raise NotImplementedError(f"{node.where} has no compiled form")
        try:
            rule(made, node)
        # the second: of a shape that no layer takes
        except (NotImplementedError, ValueError) as error:
            raise NotImplementedError(f"{node.where}: {error}") from None
    if not made.layers or made.names.get(output) != made.layers[-1]["name"]:
        raise NotImplementedError("the network's last layer must compute its output")
    try:
        layer_shapes(made.layers, shape, {name: w.shape for name, w in made.tensors.items()})
    except ValueError as error:
        raise NotImplementedError(str(error)) from None
    return made.layers, made.tensors


def _inputs(model: onnx.ModelProto) -> list[onnx.ValueInfoProto]:
    """Without the weights, which old files list, too."""
    constants = {tensor.name for tensor in model.graph.initializer}
    return [value for value in model.graph.input if value.name not in constants]


def input_type(model: onnx.ModelProto) -> np.dtype:
    """The floating type of the network's input, and so of its weights."""
    from onnx import TensorProto

    types: dict[int, str] = {
        TensorProto.FLOAT: "float32",
        TensorProto.FLOAT16: "float16",
        TensorProto.DOUBLE: "float64",
    }
    given = _inputs(model)[0].type.tensor_type.elem_type
    if given not in types:
        raise NotImplementedError(
            f"the network's input must be floating point, got type {given} of ONNX"
        )
    return np.dtype(types[given])


def _check_meanings(model: onnx.ModelProto) -> int:
    """The opset; refuses operations that are not ONNX's own of that name, or whose meaning was
    another one."""
    if theirs := [node for node in model.graph.node if node.domain not in STANDARD]:
        where = Node(theirs[0]).where
        raise NotImplementedError(f"{where} is of the domain {theirs[0].domain!r}, not ONNX's own")
    if any(function.domain in STANDARD for function in model.functions):
        raise NotImplementedError("the network redefines operations of ONNX")
    versions = [entry.version for entry in model.opset_import if entry.domain in STANDARD]
    if not versions or min(versions) < FIRST_OPSET:
        raise NotImplementedError(
            f"the network must be of opset {FIRST_OPSET} or later, got {versions}"
        )
    newest: int = max(versions)
    return newest
