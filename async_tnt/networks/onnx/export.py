"""A Model's network as an ONNX graph."""

from __future__ import annotations

from typing import TYPE_CHECKING

from async_tnt.base.extras import needs_extra
from async_tnt.base.package import __version__
from async_tnt.networks.layers.graph import CLASSIFIER, VOLUME, layer_shapes, tensors_of
from async_tnt.networks.layers.layer import Shape
from async_tnt.networks.models.model import Model, layers_of
from async_tnt.networks.onnx.metadata import metadata_of, seal
from async_tnt.networks.onnx.nodes import LOGITS, OnnxNodes
from async_tnt.networks.onnx.operations import FORMS

if TYPE_CHECKING:
    import onnx

OPSET = 13
"""The version of ONNX's operations in exported files: that of ONNX 1.8 (2020).

No exported operation needs a later version, and programs that read ONNX read this version."""

IR_VERSION = 7
"""The version of the ONNX file format in exported files. It, too, is that of ONNX 1.8."""

MAX_BYTES = 1 << 31
"""A protobuf message, and so an ONNX file, must have fewer bytes than this."""


def to_onnx(model: Model) -> onnx.ModelProto:
    """The network of a Model, without its landmark network, as an ONNX network.

    The input is `volume`, float32 of shape (1, C, H, W). The output is `logits`, float32 of shape
    (1, n_classes), or (1, n_classes + 1, R, C) for a map model. A model of raw outputs has these
    outputs, of shape (1, ...), instead. The weights are initializers with their names in
    `Model.weights`.

    `metadata_props` hold the metadata of a model file (`format`, `config`, `classes`, `record`,
    `network`, and `outputs` if there are some), and `sha256`, a hash of the whole file. The model's
    landmark network is not exported: it has no ONNX form.

    Raises
    ------
    ImportError : onnx is not installed.
    ValueError : the weights are too large for one ONNX file (2 GiB).
    """
    with needs_extra("onnx", "ONNX networks are written by onnx and run by onnxruntime"):
        import onnx
    nodes = _nodes_of(model)
    n_bytes = sum(w.nbytes for w in nodes.weights.values())
    if n_bytes >= MAX_BYTES:
        raise ValueError(
            f"an ONNX file holds less than 2 GiB, the classifier's weights are {n_bytes:_} bytes"
        )
    helper = onnx.helper
    float32 = onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        nodes.nodes,
        CLASSIFIER,
        [helper.make_tensor_value_info(VOLUME, float32, [1, *model.config.shape])],
        [
            helper.make_tensor_value_info(name, float32, [1, *shape])
            for name, shape in exported_shapes(model).items()
        ],
        [onnx.numpy_helper.from_array(w, name) for name, w in nodes.weights.items()],
    )
    proto: onnx.ModelProto = helper.make_model(
        graph,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="async_tnt",
        producer_version=__version__,
    )
    helper.set_model_props(proto, metadata_of(model))
    seal(proto)
    onnx.checker.check_model(proto, full_check=True)
    return proto


def exported_shapes(model: Model) -> dict[str, Shape]:
    """Name of an output of the ONNX network -> its shape, without the batch."""
    if model.outputs:
        return model.output_shapes
    return {LOGITS: (len(model.classes),) if model.places is None else model.logits_shape}


def _nodes_of(model: Model) -> OnnxNodes:
    """The nodes of the network, layer by layer."""
    from onnx.helper import make_node

    layers = layers_of(model, CLASSIFIER)
    weights = {name: model.weights[name] for name in sorted(tensors_of(layers))}
    tensor_shapes = {name: w.shape for name, w in model.weights.items()}
    shapes = layer_shapes(layers, model.config.shape, tensor_shapes, ())
    nodes = OnnxNodes(layers, weights, shapes, make_node, list(model.outputs) or [LOGITS])
    for layer in layers:
        is_last = layer is layers[-1]
        name = nodes.name_value(layer, is_logits=is_last and not model.outputs)
        inputs = [nodes.value_of(source) for source in layer["inputs"]]
        write = FORMS[layer["op"]].write
        assert write is not None  # a Model's classifier holds no other layers
        write(nodes, layer, inputs, name)

    if model.outputs:
        for name, layer_name in model.outputs.items():
            nodes.add("Identity", [nodes.value_of(layer_name)], name)
        return nodes
    output = nodes.value_of(layers[-1]["name"])
    # `name_value` has named a vector `logits`. Otherwise the output is a map. The logits of a map
    # model are this map. The logits of another model are the flattened map.
    if output != LOGITS:
        nodes.add("Flatten" if model.places is None else "Identity", [output], LOGITS)
    return nodes
