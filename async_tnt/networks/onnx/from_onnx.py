"""Models from ONNX networks.

The networks are our own files, and convolutional networks that torch, Keras and others export.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from async_tnt.base.extras import needs_extra
from async_tnt.base.messages import one_line
from async_tnt.networks.layers.conversion_check import (
    TOLERANCE,
    Function,
    compare,
    expect_form,
    without_batch,
)
from async_tnt.networks.layers.graph import (
    CLASSIFIER,
    VOLUME,
    ReadNetwork,
    layer_shapes,
    needed_layers,
    tensors_of,
)
from async_tnt.networks.layers.refusals import Refusals, RefusedError
from async_tnt.networks.models.compiled_network import CompiledNetwork, compiled_network_of
from async_tnt.networks.models.model import Model, refuse_several_outputs
from async_tnt.networks.models.torch_modules import exact_outputs
from async_tnt.networks.onnx.constant_folding import is_folded
from async_tnt.networks.onnx.layers import Node, OnnxLayers
from async_tnt.networks.onnx.metadata import Exported, read_metadata
from async_tnt.networks.onnx.network import open_session
from async_tnt.networks.onnx.norms import note_axes
from async_tnt.networks.onnx.operations import RULES
from async_tnt.volume.config import TNTConfig

if TYPE_CHECKING:
    import onnx

STANDARD = ("", "ai.onnx")
"""The names of the domain of ONNX's own operations."""

FIRST_OPSET = 7
"""The first version of ONNX's operations that is read.

In earlier versions, sums have an axis, and batch norms and dropouts are in training mode by
default."""

WAY_OUT_OF_LOGITS = (
    "; OnnxClassifier(path) runs any float32 network of logits, whole at every decision"
)
"""The end of a message about a refused network with classes: what the user can do instead."""

WAY_OUT = "; volumes(source, config) yields the volumes for a network of any kind"
"""The end of a message about another refused network."""


def load_onnx(path: Path, config: TNTConfig | None, classes: Sequence[str] | None) -> Model:
    """The model in an .onnx file, see `load_model`."""
    with needs_extra("onnx", "ONNX networks are read by onnx"):
        import onnx
    try:
        # this also reads weights that stand in files beside the .onnx file
        proto = onnx.load(path)
        onnx.checker.check_model(proto)
        metadata = {entry.key: entry.value for entry in proto.metadata_props}
        exported = read_metadata(metadata, path.read_bytes())
    except Exception as error:  # onnx and protobuf raise errors of many types
        raise ValueError(f"{path} is not a readable ONNX network: {one_line(error)}") from None
    if exported is not None:
        if config is not None or classes is not None:
            raise TypeError(
                f"`config` and `classes` are for networks of other programs; {path} has its own"
            )
        weights = {
            tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in proto.graph.initializer
        }
        return _exported_model(path, exported, weights)
    if config is None:
        raise TypeError(
            f"{path} does not say how events become its volume: load_model(path, "
            "config=TNTConfig(...), classes=[...])"
        )
    return _foreign_model(path, proto, config, classes)


def _exported_model(path: Path, exported: Exported, weights: Mapping[str, np.ndarray]) -> Model:
    """The model in a file that this package wrote.

    Parameters
    ----------
    weights : name -> values of all constants in the file. Some of them are no weights of the model,
        because the export adds constants.
    """
    if exported.config.needs_regressor:
        raise NotImplementedError(
            f"the landmark network of {path} has no ONNX form: load the model it was exported from"
        )
    layers = exported.layers
    try:
        # `tensors_of` can read the names of weights only from layers that have been checked
        layer_shapes(layers, exported.config.shape, _shapes(weights), ())
        used_weights = {name: weights[name] for name in sorted(tensors_of(layers))}
        network = {CLASSIFIER: layers}
        return Model(
            exported.config,
            used_weights,
            exported.classes,
            exported.record,
            network=network,
            outputs=exported.outputs,
            by_share=exported.by_share,
        )
    except NotImplementedError as error:
        raise ValueError(
            f"{path} holds a network that this release cannot run: {one_line(error)}"
        ) from None
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path} holds a damaged model: {one_line(error, 1000)}") from None


def _foreign_model(
    path: Path, proto: onnx.ModelProto, config: TNTConfig, classes: Sequence[str] | None
) -> Model:
    """The model of another program's network, whose output has been compared with onnxruntime's."""
    way_out = WAY_OUT if classes is None else WAY_OUT_OF_LOGITS
    try:
        read = layers_from_onnx(proto, config.shape, has_classes=classes is not None)
        if classes is not None:
            refuse_several_outputs(read.outputs)
        model = Model(
            config,
            read.weights,
            () if classes is None else classes,  # type: ignore[arg-type]  # `Model` checks it
            network={CLASSIFIER: read.layers},
            outputs=read.outputs if classes is None else {},
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    except NotImplementedError as error:
        raise NotImplementedError(f"{path}: {error}{way_out}") from None
    try:
        _compare_with_onnxruntime(path, proto, model)
    except ValueError as error:
        raise NotImplementedError(f"{path} cannot be read as layers: {error}{way_out}") from None
    return model


def _shapes(weights: Mapping[str, np.ndarray]) -> dict[str, tuple[int, ...]]:
    return {name: w.shape for name, w in weights.items()}


def _compare_with_onnxruntime(path: Path, proto: onnx.ModelProto, model: Model) -> None:
    """Compare an ONNX network, run by onnxruntime, with the compiled layers that were read from it.

    Raises
    ------
    ImportError : onnxruntime is not installed.
    ValueError : see `compare`; or onnxruntime cannot open the file.
    """
    opened = open_session(str(path), str(path), 1)
    (network_input,) = opened.inputs
    dtype = input_type(proto)
    # `layers_from_onnx` accepts a softmax only at the end of a network of classes
    has_softmax = any(node.op_type == "Softmax" for node in proto.graph.node)
    n_batch = 1
    if network_input.shape and isinstance(network_input.shape[0], int):
        n_batch = network_input.shape[0]  # the file fixes the batch size

    def original(volume: np.ndarray) -> list[np.ndarray]:
        batch = np.repeat(volume[None], n_batch, 0).astype(dtype)
        answers = opened.session.run(None, {network_input.name: batch})
        return [without_batch(answer, n_batch).astype(np.float64) for answer in answers]

    compiled = compiled_network_of(model)
    if isinstance(compiled, CompiledNetwork):
        converted: Function = compiled
    else:

        def converted(volume: np.ndarray) -> list[np.ndarray]:
            return [compiled(volume).astype(np.float64)]

    if has_softmax:
        converted = _with_softmax(converted)
    is_raw = bool(model.outputs)
    tolerance = max(TOLERANCE, 8 * float(np.finfo(dtype).eps))
    try:
        compare(original, converted, model.config.shape, tolerance, is_raw=is_raw)
    except ValueError:
        if importlib.util.find_spec("torch") is None:
            raise
        exact: Function = exact_outputs(model)
        if has_softmax:
            exact = _with_softmax(exact)
        compare(original, converted, model.config.shape, tolerance, exact, is_raw=is_raw)


def _with_softmax(logits_of: Function) -> Function:
    """A function to the softmax of each output of another function."""

    def softmax(logits: np.ndarray) -> np.ndarray:
        odds = np.exp(logits - logits.max(0))
        probabilities: np.ndarray = odds / odds.sum(0)
        return probabilities

    return lambda volume: [softmax(logits) for logits in logits_of(volume)]


def layers_from_onnx(
    model: onnx.ModelProto, shape: tuple[int, int, int], *, has_classes: bool
) -> ReadNetwork:
    """The layers of a network with one input.

    `networks/onnx/operations.py` lists the operators that become layers.

    Parameters
    ----------
    shape : (C, H, W) of a volume. The file may leave these sides of the input (N, C, H, W) open.
    has_classes : whether the network is read for classes. Then a softmax at its end is left out.

    Raises
    ------
    NotImplementedError : nodes have no compiled form. The message names the kinds of these nodes.
    ValueError : the network's input has another shape.
    """
    from onnx import numpy_helper

    graph = model.graph
    opset = _check_meanings(model)
    inputs = _inputs(model)
    if len(inputs) != 1:
        raise NotImplementedError(f"the network must have one input, got {len(inputs)}")
    _check_input_shape(inputs[0], shape)
    constants = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    onnx_layers = OnnxLayers(inputs[0].name, shape, input_type(model), constants, opset)
    output_names = [output.name for output in graph.output]
    left_out = output_names if has_classes else []
    refused = Refusals()
    for node in map(Node, graph.node):
        is_ending_softmax = node.op == "Softmax" and node.outputs[0] in left_out
        try:
            _read(onnx_layers, node, is_ending_softmax)
        except RefusedError as error:
            refused.add(error)
            # so that later nodes are read, too, as if the volume were the value of this one
            onnx_layers.names |= dict.fromkeys(node.outputs, VOLUME)
        except ValueError as error:  # shapes do not fit; after a refused node they are wrong anyway
            if not refused:
                raise NotImplementedError(f"{node.where}: {error}") from None
    refused.raise_if_any()
    try:
        are_maps = onnx_layers.channels_last.isdisjoint(output_names)
        expect_form(are_maps, "a value with its channels last")
        outputs = {name: onnx_layers.layer_name(name) for name in output_names}
        read = needed_layers(onnx_layers.layers, onnx_layers.tensors, outputs)
        layer_shapes(read.layers, shape, _shapes(read.weights), list(outputs.values()))
    except NotImplementedError as error:
        raise NotImplementedError(f"the network's output: {error}") from None
    except ValueError as error:
        raise NotImplementedError(str(error)) from None
    return read


def _read(onnx_layers: OnnxLayers, node: Node, is_ending_softmax: bool) -> None:
    """Add the layers of one node.

    Raises
    ------
    RefusedError : the node has no compiled form.
    ValueError : its inputs do not fit.
    """
    rule = RULES.get(node.op)
    try:
        if is_folded(onnx_layers, node):
            return
        if rule is None or (node.op == "Softmax" and not is_ending_softmax):
            advice = ""
            if node.op == "Softmax":
                advice = "; at the end of a network of `classes` it is left out"
            raise RefusedError(node.op, f"{node.where} has no compiled form{advice}")
        note_axes(onnx_layers, node)
        rule(onnx_layers, node)
    except RefusedError:
        raise
    except NotImplementedError as error:
        raise RefusedError(f"{node.op}: {error}", f"{node.where}: {error}") from None
    except (ArithmeticError, LookupError, TypeError, RuntimeError) as error:
        # inputs or attributes of values that onnxruntime may refuse, too
        reason = f"its inputs have no compiled form ({one_line(error)})"
        raise RefusedError(f"{node.op}: {reason}", f"{node.where}: {reason}") from None


def _check_input_shape(value: onnx.ValueInfoProto, shape: tuple[int, int, int]) -> None:
    """Refuse an input (N, C, H, W) that is no volume of this shape (C, H, W)."""
    sides = [side.dim_value for side in value.type.tensor_type.shape.dim][1:]
    if not sides:  # the file does not say the input's shape
        return
    is_volume = len(sides) == 3 and all(
        side in (0, expected)  # 0: the file leaves this side open
        for side, expected in zip(sides, shape, strict=True)
    )
    if not is_volume:
        raise ValueError(
            f"the network's input must be the volume, N x {shape}, got N x {tuple(sides)}"
        )


def _inputs(model: onnx.ModelProto) -> list[onnx.ValueInfoProto]:
    """The network's inputs. Old files list the weights among them: these are left out."""
    constants = {tensor.name for tensor in model.graph.initializer}
    return [value for value in model.graph.input if value.name not in constants]


def input_type(model: onnx.ModelProto) -> np.dtype:
    """The floating type of the network's input. Its weights must have the same type."""
    from onnx import TensorProto

    type_names: dict[int, str] = {
        TensorProto.FLOAT: "float32",
        TensorProto.FLOAT16: "float16",
        TensorProto.DOUBLE: "float64",
    }
    element_type = _inputs(model)[0].type.tensor_type.elem_type
    if element_type not in type_names:
        raise NotImplementedError(
            f"the network's input must be floating point, got type {element_type} of ONNX"
        )
    return np.dtype(type_names[element_type])


def _check_meanings(model: onnx.ModelProto) -> int:
    """Check that operators have ONNX's own meanings, and return the version of ONNX's operations.

    Raises
    ------
    NotImplementedError : an operation is not one of ONNX's own; or the network's version of ONNX's
        operations is before `FIRST_OPSET`.
    """
    for node in model.graph.node:
        if node.domain not in STANDARD:
            where = Node(node).where
            raise NotImplementedError(f"{where} is of the domain {node.domain!r}, not ONNX's own")
    if any(function.domain in STANDARD for function in model.functions):
        raise NotImplementedError("the network redefines operations of ONNX")
    versions = [entry.version for entry in model.opset_import if entry.domain in STANDARD]
    if not versions or min(versions) < FIRST_OPSET:
        raise NotImplementedError(
            f"the network must be of opset {FIRST_OPSET} or later, got {versions}"
        )
    newest: int = max(versions)
    return newest
