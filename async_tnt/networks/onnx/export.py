"""A Model's classifier as an ONNX graph, node by node, and the metadata of such files.

Opset 13 and IR version 7, those of ONNX 1.8 (2020): nothing here needs more, and what reads ONNX
reads these.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.base.checks import needs_extra
from async_tnt.base.package import __version__
from async_tnt.networks.layers.graph import CLASSIFIER, VOLUME, layer_shapes, tensors_of
from async_tnt.networks.layers.layer import Layer
from async_tnt.networks.layers.uneven_windows import adaptive_matrix
from async_tnt.networks.models.model import FORMAT, Model
from async_tnt.networks.models.model_file import parse_metadata, read_description
from async_tnt.volume.config import TNTConfig

if TYPE_CHECKING:
    import onnx

OPSET, IR_VERSION = 13, 7
MAX_BYTES = 1 << 31  # of a protobuf message
PLAIN: dict[str, tuple[str, dict[str, Any]]] = {
    "relu": ("Relu", {}),
    "sigmoid": ("Sigmoid", {}),
    "tanh": ("Tanh", {}),
    "hardsigmoid": ("HardSigmoid", {"alpha": 1 / 6, "beta": 0.5}),
    "max_pool": ("MaxPool", {}),
    "average_pool": ("AveragePool", {"count_include_pad": 1}),
    "inside_average_pool": ("AveragePool", {"count_include_pad": 0}),
    "global_average_pool": ("GlobalAveragePool", {}),
    "add": ("Sum", {}),
    "concat": ("Concat", {"axis": 1}),
    "flatten": ("Flatten", {}),
}
"""Layers that are one node without weights: what ONNX calls them, and its attributes other than the
window's."""
BLANK = 64 * "0"  # in place of the checksum while it is computed


def to_onnx(model: Model) -> onnx.ModelProto:
    """The classifier of a Model, `model`: input `volume` (1, C, H, W), output `logits` (1,
    n_classes), of a map model (1, n_classes + 1, R, C), float32.

    Weights are initializers under their names in `Model.weights`. `metadata_props` hold what a
    model file's metadata holds (`format`, `config`, `classes`, `record`, `network`), and `sha256`,
    a hash of the whole file. A landmark network has no such form.

    Raises
    ------
    ImportError : onnx is not installed.
    ValueError : the weights are too large for one ONNX file (2 GiB).
    """
    with needs_extra("onnx", "ONNX networks are written by onnx and run by onnxruntime"):
        import onnx
    nodes = _Nodes(model, onnx.helper.make_node)
    if nodes.output != "logits":
        nodes.add("Flatten" if model.places is None else "Identity", [nodes.output], "logits")
    n_bytes = sum(w.nbytes for w in nodes.weights.values())
    if n_bytes >= MAX_BYTES:
        raise ValueError(
            f"an ONNX file holds less than 2 GiB, the classifier's weights are {n_bytes:_} bytes"
        )
    make, float32 = onnx.helper, onnx.TensorProto.FLOAT
    shape = [len(model.classes)] if model.places is None else model.logits_shape
    graph = make.make_graph(
        nodes.nodes,
        CLASSIFIER,
        [make.make_tensor_value_info("volume", float32, [1, *model.config.shape])],
        [make.make_tensor_value_info("logits", float32, [1, *shape])],
        [onnx.numpy_helper.from_array(w, name) for name, w in nodes.weights.items()],
    )
    made: onnx.ModelProto = make.make_model(
        graph,
        opset_imports=[make.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="async_tnt",
        producer_version=__version__,
    )
    # nodes show what they compute, but not of which layer they are
    network = json.dumps(model.network[CLASSIFIER])
    make.set_model_props(made, model.description() | {"network": network, "sha256": BLANK})
    seal(made)
    onnx.checker.check_model(made, full_check=True)
    return made


class _Nodes:
    """The nodes of a classifier, layer by layer, and the constants that they read besides the
    model's weights.

    Each layer's value has the layer's name; where that is a weight's name, too, or one of the
    file's own, `_` follows.
    """

    def __init__(self, model: Model, make_node: Callable[..., onnx.NodeProto]) -> None:
        self._make = make_node
        self.nodes: list[Any] = []
        layers = model.network[CLASSIFIER]
        self.weights = {name: model.weights[name] for name in sorted(tensors_of(layers))}
        self._shapes = layer_shapes(
            layers, model.config.shape, {name: w.shape for name, w in model.weights.items()}
        )
        self._names = {VOLUME: VOLUME}
        if taken := {VOLUME, "logits"}.intersection(self.weights):
            raise ValueError(
                f"a weight is named {min(taken)!r}, as ONNX's input or output: it needs another "
                "name"
            )
        taken = {VOLUME, "logits", *self.weights}
        for layer in layers:
            name = layer["name"]
            # as helping values' are
            while name in taken or any(one["name"].startswith(f"{name}.") for one in layers):
                name += "_"
            if layer is layers[-1] and len(self._shapes[layer["name"]]) == 1:
                name = "logits"
            taken.add(name)
            self._names[layer["name"]] = name
            inputs = [self._names[value] for value in layer["inputs"]]
            if layer["op"] in PLAIN:
                op, attributes = PLAIN[layer["op"]]
                self.add(
                    op, inputs, name, **attributes, **(_window(layer) if "kernel" in layer else {})
                )
            else:
                getattr(self, f"_{layer['op']}")(layer, inputs, name)
        self.output = self._names[layers[-1]["name"]]

    def add(self, op: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        self.nodes.append(self._make(op, list(inputs), [output], **attributes))
        return output

    def _constant(self, name: str, value: Any) -> str:
        while name in self.weights:  # a model's own may have this name
            name += "_"
        self.weights[name] = np.asarray(value, np.float32)
        return name

    def _conv(self, layer: Layer, inputs: list[str], name: str) -> None:
        more = {"dilations": layer["dilation"], "group": layer["groups"]}
        self.add(
            "Conv", [*inputs, *_roles(layer, "weight", "bias")], name, **_window(layer), **more
        )

    def _dense(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("Gemm", [*inputs, *_roles(layer, "weight", "bias")], name, transB=1)

    def _batch_norm(self, layer: Layer, inputs: list[str], name: str) -> None:
        n = self._shapes[layer["name"]][0]
        given = layer["weights"]
        weight = given.get("weight") or self._constant(f"{name}.ones", np.ones(n))
        bias = given.get("bias") or self._constant(f"{name}.zeros", np.zeros(n))
        more = [weight, bias, given["mean"], given["variance"]]
        self.add("BatchNormalization", [*inputs, *more], name, epsilon=layer["epsilon"])

    def _leaky_relu(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("LeakyRelu", inputs, name, alpha=layer["slope"])

    def _prelu(self, layer: Layer, inputs: list[str], name: str) -> None:
        slope = self.weights[layer["weights"]["slope"]]
        sides = [1] * (len(self._shapes[layer["name"]]) - 1)
        self.add(
            "PRelu", [*inputs, self._constant(f"{name}.slope", slope.reshape(-1, *sides))], name
        )

    def _clip(self, layer: Layer, inputs: list[str], name: str) -> None:
        limits = [
            "" if layer[side] is None else self._constant(f"{name}.{side}", layer[side])
            for side in ("low", "high")
        ]
        self.add("Clip", [*inputs, *limits], name)

    def _log1p(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("Log", [self._add_number(inputs[0], 1.0, f"{name}.sum")], name)

    def _silu(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("Mul", [*inputs, self.add("Sigmoid", inputs, f"{name}.sigmoid")], name)

    def _gelu(self, layer: Layer, inputs: list[str], name: str) -> None:
        """x (1 + erf(x / sqrt 2)) / 2"""
        scaled = self._scale(inputs[0], 0.5**0.5, f"{name}.scaled")
        erf = self._add_number(self.add("Erf", [scaled], f"{name}.erf"), 1.0, f"{name}.sum")
        self._scale(self.add("Mul", [*inputs, erf], f"{name}.product"), 0.5, name)

    def _gelu_tanh(self, layer: Layer, inputs: list[str], name: str) -> None:
        """x (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3))) / 2"""
        (x,) = inputs
        cube = self.add("Mul", [x, self.add("Mul", [x, x], f"{name}.square")], f"{name}.cube")
        inner = self.add("Add", [x, self._scale(cube, 0.044715, f"{name}.part")], f"{name}.inner")
        tanh = self.add(
            "Tanh", [self._scale(inner, (2 / np.pi) ** 0.5, f"{name}.scaled")], f"{name}.tanh"
        )
        factor = self._add_number(tanh, 1.0, f"{name}.sum")
        self._scale(self.add("Mul", [x, factor], f"{name}.product"), 0.5, name)

    def _hardswish(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add(
            "Mul",
            [*inputs, self.add("HardSigmoid", inputs, f"{name}.factor", alpha=1 / 6, beta=0.5)],
            name,
        )

    def _scale(self, value: str, factor: float, name: str) -> str:
        return self.add("Mul", [value, self._constant(f"{name}.factor", factor)], name)

    def _add_number(self, value: str, number: float, name: str) -> str:
        return self.add("Add", [value, self._constant(f"{name}.number", number)], name)

    def _sum_pool(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("AveragePool", inputs, f"{name}.mean", count_include_pad=1, **_window(layer))
        size = self._constant(f"{name}.size", layer["kernel"][0] * layer["kernel"][1])
        self.add("Mul", [f"{name}.mean", size], name)

    def _depth_to_space(self, layer: Layer, inputs: list[str], name: str) -> None:
        self.add("DepthToSpace", inputs, name, blocksize=layer["block"], mode="CRD")

    def _adaptive_average_pool(self, layer: Layer, inputs: list[str], name: str) -> None:
        """A X B', where A and B hold what each place takes of the mean along its axis."""
        rows, columns = map(adaptive_matrix, layer["size"], self._shapes[layer["inputs"][0]][1:])
        of_rows = self.add("MatMul", [self._constant(f"{name}.a", rows), *inputs], f"{name}.rows")
        self.add("MatMul", [of_rows, self._constant(f"{name}.b", columns.T)], name)


def _roles(layer: Layer, *roles: str) -> list[str]:
    return [layer["weights"][role] for role in roles if role in layer["weights"]]


def _window(layer: Layer) -> dict[str, list[int]]:
    return {"kernel_shape": layer["kernel"], "strides": layer["stride"], "pads": layer["padding"]}


# -- metadata --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Exported:
    """The Model that a classifier was exported from, without its weights."""

    config: TNTConfig
    classes: tuple[str, ...]
    record: Mapping[str, Any]
    layers: list[Layer]


def seal(made: onnx.ModelProto) -> None:
    """Write the checksum of all of a file's bytes into its metadata."""
    (entry,) = (entry for entry in made.metadata_props if entry.key == "sha256")
    entry.value = BLANK
    entry.value = _checksum(made.SerializeToString(), BLANK)


def _checksum(content: bytes, sha256: str) -> str:
    return hashlib.sha256(content.replace(sha256.encode(), BLANK.encode())).hexdigest()


def read_metadata(metadata: Mapping[str, str], content: bytes) -> Exported | None:
    """The metadata of a file of this content; None where another program wrote it.

    Raises
    ------
    ValueError : our file, but of another version, or damaged: it is not what `seal` wrote.
    """
    written = metadata.get("format", "")
    if not written.startswith(FORMAT.split()[0] + " "):
        return None
    if written != FORMAT:
        raise ValueError(f"metadata `format` must be {FORMAT!r}, got {written!r}")
    try:
        config, classes, record = read_description(metadata)
        layers = parse_metadata({"network": metadata.get("network", "")}, "network")
    except TypeError as error:
        raise ValueError(str(error)) from None
    if not (
        isinstance(classes, list) and classes and all(isinstance(name, str) for name in classes)
    ):
        raise ValueError(f"metadata `classes` must be a list of names, got {metadata['classes']!r}")
    if not isinstance(record, dict):
        raise ValueError(f"metadata `record` must be a mapping, got {metadata['record']!r}")
    if not isinstance(layers, list):
        raise ValueError(
            f"metadata `network` must be a list of layers, got {metadata['network']!r}"
        )
    if metadata["sha256"] != _checksum(content, metadata["sha256"]):
        raise ValueError(
            "its checksum differs; copy or export it again (where another program has changed it, "
            "remove `format` "
            "from its metadata)"
        )
    return Exported(config, tuple(classes), record, layers)
