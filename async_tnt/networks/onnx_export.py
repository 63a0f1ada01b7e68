"""A Model's networks as ONNX graphs, node by node.

Opset 13 and IR version 7, those of ONNX 1.8 (2020): nothing here needs more, and what reads ONNX reads these.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.checks import needs_extra
from async_tnt.networks.graph import CLASSIFIER, REGRESSOR, VOLUME, Layer, layer_shapes, tensors_of
from async_tnt.networks.model import Model
from async_tnt.networks.onnx_metadata import metadata_of, seal

if TYPE_CHECKING:
    import onnx

OPSET, IR_VERSION = 13, 7
MAX_BYTES = 1 << 31  # of a protobuf message


def to_onnx(model: Model) -> onnx.ModelProto:
    """The classifier of a Model, `model`: input `volume` (1, C, H, W), output `logits` (1, n_classes), float32.

    Weights are initializers under their names in `Model.weights`. `metadata_props` hold what a model file's metadata
    holds (`format`, `config`, `classes`, `record`), `network`, `weights`, a hash of all weights, and `sha256`, one of
    the whole file.

    Raises
    ------
    ImportError : onnx is not installed.
    ValueError : the weights are too large for one ONNX file (2 GiB).
    """
    nodes = _Nodes(model, CLASSIFIER)
    if nodes.output != "logits":
        nodes.add("Flatten", [nodes.output], "logits")
    return _model(model, CLASSIFIER, nodes, ("logits", np.float32, len(model.classes)))


def regressor_to_onnx(model: Model) -> onnx.ModelProto:
    """The landmark network of a Model, `model`: input `volume` (1, C, H, W), float32, without the transform; output
    `landmark` (1, 2), float64: (x, y) in grid pixels.

    The centroid is computed in float64, by Softmax and Gemm: l = c + sum_i softmax(e)_i ((x_i, y_i) - c), with
    distances from the middle c, so that an even heatmap gives it to 1e-13 pixels.

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
    nodes = _Nodes(model, REGRESSOR)
    return _model(model, REGRESSOR, nodes, (nodes.output, np.float64, 2))


class _Nodes:
    """The nodes of a network, layer by layer, and the constants that they read besides the model's weights.

    Each layer's value has the layer's name; where that is a weight's name, too, or one of the file's own, `_` follows.
    """

    def __init__(self, model: Model, network: str) -> None:
        self._make, _ = _makers()
        self.nodes: list[Any] = []
        self.weights = {name: model.weights[name] for name in sorted(tensors_of(model.layers[network]))}
        layers = model.layers[network]
        self._shapes = layer_shapes(layers, model.config.shape, {name: w.shape for name, w in model.weights.items()})
        self._names = {VOLUME: VOLUME}
        taken = {VOLUME, "logits", *self.weights}
        for layer in layers:
            name = layer["name"]
            while name in taken:
                name += "_"
            if layer is layers[-1] and network == CLASSIFIER and len(self._shapes[layer["name"]]) == 1:
                name = "logits"
            taken.add(name)
            self._names[layer["name"]] = name
            getattr(self, f"_{layer['op']}")(layer, [self._names[value] for value in layer["inputs"]], name)
        self.output = self._names[layers[-1]["name"]]

    def add(self, op: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        self.nodes.append(self._make(op, list(inputs), [output], **attributes))
        return output

    def _constant(self, name: str, value: Any, dtype: type = np.float32) -> str:
        self.weights[name] = np.asarray(value, dtype)
        return name

    def _conv(self, layer: Layer, inputs: list[str], name: str) -> None:
        more = {"dilations": layer["dilation"], "group": layer["groups"]}
        self.add("Conv", [*inputs, *_roles(layer, "weight", "bias")], name, **_window(layer), **more)

    def _dense(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("Gemm", [*inputs, *_roles(layer, "weight", "bias")], name, transB=1)

    def _batch_norm(self, layer: Layer, inputs: list[str], name: str) -> None:
        n = self._shapes[layer["name"]][0]
        given = layer["weights"]
        weight = given.get("weight") or self._constant(f"{name}.ones", np.ones(n))
        bias = given.get("bias") or self._constant(f"{name}.zeros", np.zeros(n))
        more = [weight, bias, given["mean"], given["variance"]]
        self.add("BatchNormalization", [*inputs, *more], name, epsilon=layer["epsilon"])

    def _relu(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("Relu", inputs, name)

    def _leaky_relu(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("LeakyRelu", inputs, name, alpha=layer["slope"])

    def _prelu(self, layer: Layer, inputs: list[str], name: str) -> None:
        slope = self.weights[layer["weights"]["slope"]]
        sides = [1] * (len(self._shapes[layer["name"]]) - 1)
        self.add("PRelu", [*inputs, self._constant(f"{name}.slope", slope.reshape(-1, *sides))], name)

    def _clip(self, layer: Layer, inputs: list[str], name: str) -> None:
        limits = [
            "" if layer[side] is None else self._constant(f"{name}.{side}", layer[side]) for side in ("low", "high")
        ]
        self.add("Clip", [*inputs, *limits], name)

    def _max_pool(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("MaxPool", inputs, name, **_window(layer))

    def _average_pool(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("AveragePool", inputs, name, count_include_pad=1, **_window(layer))

    def _sum_pool(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("AveragePool", inputs, f"{name}.mean", count_include_pad=1, **_window(layer))
        size = self._constant(f"{name}.size", layer["kernel"][0] * layer["kernel"][1])
        self.add("Mul", [f"{name}.mean", size], name)

    def _global_average_pool(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("GlobalAveragePool", inputs, name)

    def _add(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("Sum", inputs, name)

    def _concat(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("Concat", inputs, name, axis=1)

    def _flatten(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("Flatten", inputs, name)

    def _heatmap_centroid(self, layer: Layer, inputs: list[str], name: str) -> None:
        _, onnx = _makers()
        _, height, width = self._shapes[layer["inputs"][0]]
        middle = np.array([(width - 1) / 2, (height - 1) / 2])
        places = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)  # rows of x
        self.add("Cast", inputs, f"{name}.float64", to=onnx.TensorProto.DOUBLE)
        self.add("Flatten", [f"{name}.float64"], f"{name}.places")
        self.add("Softmax", [f"{name}.places"], f"{name}.heatmap", axis=1)
        from_middle = self._constant(f"{name}.from_middle", places - middle, np.float64)
        self.add("Gemm", [f"{name}.heatmap", from_middle, self._constant(f"{name}.middle", middle, np.float64)], name)


def _roles(layer: Layer, *roles: str) -> list[str]:
    return [layer["weights"][role] for role in roles if role in layer["weights"]]


def _window(layer: Layer) -> dict[str, list[int]]:
    return {"kernel_shape": layer["kernel"], "strides": layer["stride"], "pads": layer["padding"]}


def _makers() -> tuple[Any, Any]:
    """`onnx.helper.make_node`, and onnx."""
    with needs_extra("onnx", "ONNX networks are written by onnx and run by onnxruntime"):
        import onnx
    return onnx.helper.make_node, onnx


def _model(model: Model, network: str, nodes: _Nodes, output: tuple[str, Any, int]) -> onnx.ModelProto:
    from async_tnt.version import __version__

    _, onnx = _makers()
    n_bytes = sum(w.nbytes for w in nodes.weights.values())
    if n_bytes >= MAX_BYTES:
        raise ValueError(f"an ONNX file holds less than 2 GiB, the {network}'s weights are {n_bytes:_} bytes")
    make, types = onnx.helper, onnx.helper.np_dtype_to_tensor_dtype
    name, dtype, size = output
    graph = make.make_graph(
        nodes.nodes,
        network,
        [make.make_tensor_value_info("volume", types(np.dtype(np.float32)), [1, *model.config.shape])],
        [make.make_tensor_value_info(name, types(np.dtype(dtype)), [1, size])],
        [onnx.numpy_helper.from_array(w, key) for key, w in nodes.weights.items()],
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
    return made  # type: ignore[no-any-return]
