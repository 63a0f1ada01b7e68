"""Torch modules as layers: `nn.Sequential`, and any module that `torch.fx` can trace."""

from __future__ import annotations

import copy
import inspect
import operator
from collections.abc import Mapping
from types import FunctionType
from typing import Any

import numpy as np
import torch
from tnt_reference import LayerNetwork
from torch import fx, nn
from torch.fx.node import map_arg

from async_tnt.base.checks import ParameterTypeError
from async_tnt.base.messages import one_line
from async_tnt.networks.layers.conversion_check import (
    EXACT_TOLERANCE,
    Function,
    compare,
    expect_form,
    without_batch,
)
from async_tnt.networks.layers.graph import VOLUME, ReadNetwork, layer_shapes
from async_tnt.networks.layers.refusals import Refusals, RefusedError
from async_tnt.networks.torch.form import TorchForm
from async_tnt.networks.torch.layers import Call, LayerList, float_array
from async_tnt.networks.torch.operations import (
    CHANNELS_LAST,
    FUNCTIONS,
    FUNCTIONS_BY_NAME,
    METHODS,
    MODULES,
    PERMUTE,
)
from async_tnt.networks.torch.outputs import named_outputs
from async_tnt.networks.torch.tracing import Tracer

WAY_OUT_OF_LOGITS = (
    "; a network of logits runs whole at every decision: TorchClassifier(module), or exported to "
    "ONNX, OnnxClassifier(path)"
)
"""The end of a message about a refused module with classes: what the user can do instead."""

WAY_OUT = "; volumes(source, config) yields the volumes for a network of any kind"
"""The end of a message about another refused module."""


def layers_from_torch(module: nn.Module, shape: tuple[int, ...], prefix: str = "") -> ReadNetwork:
    """The layers that compute what a module computes in eval mode.

    The module itself is not changed.

    Parameters
    ----------
    module : volumes (1, C, H, W) -> tensors (1, ...), made of the modules, functions and methods
        that `networks/torch/operations.py` lists, in place or not.
    shape : shape of a volume, (C, H, W).
    prefix : text before the names of the weights. Without it they are the names of `state_dict`.

    Raises
    ------
    TypeError : `module` is not a torch module.
    NotImplementedError : operations are not in that list; or operations in place change a tensor,
        and a view of this tensor is read later; or a module has hooks. The message names these
        operations, or the first such module.
    ValueError : a layer does not fit `shape`.
    """
    if not isinstance(module, nn.Module):
        is_state = isinstance(module, Mapping)
        advice = ": load it into its module (load_state_dict)" if is_state else ""
        got = f"{type(module).__name__}{advice}"
        raise ParameterTypeError("module", "must be a torch.nn.Module", got)
    if type(module) is LayerNetwork:
        layers = [_with_prefix(layer, prefix) for layer in module.layers]
        tensors = {f"{prefix}{name}": float_array(w) for name, w in module.tensors.items()}
        names = module.outputs
        return ReadNetwork(
            layers, tensors, named_outputs(layers[-1]["name"] if names is None else tuple(names))
        )

    module = own_copy(module)
    # A trace looks into the module itself, but takes each known module in it as one call. So if the
    # module itself is a known one, it is put into another module.
    if type(module) in MODULES:
        module = nn.Sequential(module)
    try:
        graph = Tracer(module, shape, MODULES).trace(module)
    except Exception as error:  # whatever the module's own code raises
        raise NotImplementedError(f"torch.fx cannot trace this module: {one_line(error)}") from None
    _refuse_state(module)
    try:
        read = _Conversion(module, LayerList(shape, prefix)).run(graph)
        tensor_shapes = {name: w.shape for name, w in read.weights.items()}
        layer_shapes(read.layers, shape, tensor_shapes, list(read.outputs.values()))
    except ValueError as error:
        # If the module itself fails on a volume of this shape, with an error of any type, the shape
        # is wrong. Otherwise the layers are wrong.
        try:
            _function_of(module)(np.zeros(shape, np.float32))
        except Exception:
            raise error from None
        raise _cannot_be_read(error) from None
    return read


def _refuse_state(module: nn.Module) -> None:
    """Refuse a module that kept a tensor of its call, as it would compute on from it."""
    for name, part in module.named_modules():
        for attribute, value in vars(part).items():
            if isinstance(value, fx.Proxy):
                where = f"layer {name!r} ({type(part).__name__})" if name else "the module"
                raise NotImplementedError(
                    f"{where} keeps a tensor in `{attribute}` from call to call: it is recurrent, "
                    "and recurrent networks have no compiled form"
                )


def _cannot_be_read(error: Exception) -> NotImplementedError:
    return NotImplementedError(f"the module cannot be read as layers: {error}")


def _with_prefix(layer: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    """A copy of the layer, with the prefix before the names of its weights."""
    if "weights" not in layer:
        return dict(layer)
    weights = {role: f"{prefix}{name}" for role, name in layer["weights"].items()}
    return {**layer, "weights": weights}


def check_torch_layers(
    module: nn.Module, read: ReadNetwork, shape: tuple[int, ...], *, is_raw: bool = True
) -> None:
    """Check that a module and its layers compute the same, both in float64.

    The layers come from a trace, which does not show everything that a module does.

    Parameters
    ----------
    read : what `layers_from_torch` made of the module.
    shape : shape of a volume, (C, H, W).
    is_raw : see `compare`.

    Raises
    ------
    NotImplementedError : see `compare`.
    """
    original = _function_of(own_copy(module))
    layers, weights, outputs = read
    converted = _function_of(LayerNetwork(layers, weights, list(outputs.values())).eval())
    try:
        compare(original, converted, shape, EXACT_TOLERANCE, is_raw=is_raw)
    except ValueError as error:
        raise _cannot_be_read(error) from None


def _function_of(network: nn.Module) -> Function:
    """A function of volumes that computes in float64. It uses the network itself, not a copy."""
    network = network.cpu().double()

    def outputs(volume: np.ndarray) -> list[np.ndarray]:
        with torch.no_grad():
            value = network(torch.tensor(volume, dtype=torch.float64)[None])
        return [without_batch(np.asarray(tensor)) for tensor in named_outputs(value).values()]

    return outputs


def own_copy(module: nn.Module) -> nn.Module:
    """A copy of the module in eval mode, to trace and run without effects on the caller's module.

    Raises
    ------
    NotImplementedError : the module does something that neither a copy nor a trace shows, or it
        cannot be copied.
    """
    for name, part in module.named_modules():
        where = f"layer {name!r} ({type(part).__name__})" if name else "the module"
        if isinstance(part, torch.jit.ScriptModule):
            raise NotImplementedError(
                f"{where} is compiled by torch.jit: take what it was made from"
            )
        if isinstance(part, nn.modules.lazy.LazyModuleMixin):
            raise NotImplementedError(f"{where} has no weights yet: call the module once")
        if part._forward_hooks or part._forward_pre_hooks:  # torch has no public way to ask
            raise NotImplementedError(
                f"{where} has hooks, which a trace does not show: remove them"
            )
        if "forward" in vars(part) and not isinstance(part, fx.GraphModule):
            raise NotImplementedError(f"{where} has a `forward` that is not of its class")
    try:
        return copy.deepcopy(module).eval()
    except Exception as error:  # modules raise errors of many types
        raise NotImplementedError(f"the module cannot be copied: {one_line(error)}") from None


class _Conversion:
    """Reads the nodes of a trace in their order.

    Several nodes may stand for one tensor, because the result of an operation in place is the
    tensor that it changes. After such an operation, all of these nodes have the value that the
    operation's layer computes. A view of the tensor would have to change, too, but layers cannot
    change a view. So the operation is refused if a view is read later.
    """

    def __init__(self, module: nn.Module, layer_list: LayerList) -> None:
        self._module = module
        self._layer_list = layer_list
        self._position: dict[fx.Node, int] = {}
        self._constants: dict[fx.Node, Any] = {}
        """Node that depends on the module's own tensors alone -> its value."""
        self._tensor: dict[fx.Node, fx.Node] = {}
        """Node of an operation in place -> the first node that stands for the same tensor.

        A node that is no key here is the first node of its tensor."""
        self._memory: dict[fx.Node, fx.Node] = {}
        """Node whose value may lie in another node's memory -> that other node.

        The value of a node that is no key here has memory of its own."""

    def run(self, graph: fx.Graph) -> ReadNetwork:
        """The layers that the outputs are computed from."""
        self._position = {node: k for k, node in enumerate(graph.nodes)}
        inputs = [node for node in graph.nodes if node.op == "placeholder"]
        if len(inputs) != 1:
            raise NotImplementedError(
                f"the module must take one volume, got {len(inputs)} arguments (a state would make "
                "it recurrent, and recurrent networks have no compiled form)"
            )
        self._layer_list.names[inputs[0]] = VOLUME
        self._read_all(graph)

        (output_node,) = [node for node in graph.nodes if node.op == "output"]
        outputs = named_outputs(output_node.args[0])
        if not outputs:
            raise NotImplementedError("the module must return a tensor, got none")
        try:
            return self._layer_list.needed_for(outputs)
        except NotImplementedError as error:
            raise NotImplementedError(f"the module's output: {error}") from None

    def _read_all(self, graph: fx.Graph) -> None:
        """Read all calls; a NotImplementedError that names all kinds without compiled form."""
        refused = Refusals()
        for node in graph.nodes:
            is_call = node.op not in ("placeholder", "get_attr", "output")
            if not is_call or _is_named_tuple(node) or self._is_constant(node):
                continue
            try:
                self._read(node)
            except RefusedError as error:
                refused.add(error)
            except ValueError:
                if not refused:  # after a refused call, shapes are wrong anyway
                    raise
            else:
                continue
            # The message has to name all kinds of refused calls. So later calls are read, too, as
            # if the volume were the value of this call.
            self._layer_list.names[node] = VOLUME
        refused.raise_if_any()

    def _read(self, node: fx.Node) -> None:
        """Add the layers of one call, and note which layer computes the node's value."""
        kind, module, form = self._form(node)
        if module is not None:
            where = f"layer {node.target!r} ({kind})"
        else:
            where = f"operation {node.name!r} ({kind})"
        if form is None:
            if not node.users and not _may_change_its_input(node, module):
                return
            advice = ""
            if isinstance(module, nn.RNNBase):
                advice = ": it is recurrent"
            elif "softmax" in kind.lower():
                advice = ": a decision has the softmax of its logits, leave it out"
            raise RefusedError(kind, f"{where} has no compiled form{advice}")
        try:
            call = Call(node, self._with_tensors(form.arguments(node, module)), module)
            self._note_axes(node, form)
            if node.users or call.written is not None:
                name = form.rule(self._layer_list, call)
                if call.written is not None:
                    self._write(node, call.written, name)
                elif form.may_share:
                    self._memory[node] = self._memory.get(call["input"], call["input"])
                self._layer_list.names[node] = name
        except NotImplementedError as error:
            raise RefusedError(f"{kind}: {error}", f"{where}: {error}") from None
        except (ArithmeticError, LookupError, TypeError, RuntimeError) as error:
            # arguments of values that torch may refuse, too
            reason = f"its arguments have no compiled form ({one_line(error)})"
            raise RefusedError(f"{kind}: {reason}", f"{where}: {reason}") from None

    def _note_axes(self, node: fx.Node, form: TorchForm) -> None:
        """Note that a call keeps its channels last, or refuse it if it cannot."""
        channels_last = self._layer_list.channels_last
        computed = [one for one in node.all_input_nodes if one in self._layer_list.names]
        if form is PERMUTE or not channels_last.intersection(computed):
            return
        can_be_last = any(form is one for one in CHANNELS_LAST)
        can_be_last &= channels_last.issuperset(computed)
        expect_form(can_be_last, "a tensor with its channels last")
        channels_last.add(node)

    def _write(self, node: fx.Node, written: fx.Node, name: str) -> None:
        """Record that a call changes a tensor in place.

        A layer computes the tensor's new value. From now on, every node that stands for this tensor
        has the name of that layer.

        Parameters
        ----------
        node : the call. Its result is the changed tensor, so it stands for this tensor, too.
        written : a node that stands for the tensor before the call.
        name : the layer that computes the new value.

        Raises
        ------
        NotImplementedError : a view of the tensor would change, too, and is read later.
        """
        tensor = self._tensor.get(written, written)
        memory = self._memory.get(written, written)
        # a call that only passes its input on, such as a dropout in place, changes nothing
        is_change = name != self._layer_list.source(written)
        for other in list(self._layer_list.names):
            if self._tensor.get(other, other) is tensor:
                self._layer_list.names[other] = name
                continue
            shares_memory = self._memory.get(other, other) is memory
            if is_change and shares_memory and self._is_read(other, node):
                raise NotImplementedError(
                    f"a change in place of memory that {other.name!r} shares, which is read later, "
                    "has no compiled form"
                )
        self._tensor[node] = tensor
        self._memory[node] = memory

    def _is_read(self, node: fx.Node, after: fx.Node) -> bool:
        """Whether an operation that follows `after` reads the node's value.

        An operation counts only if its own result is used.
        """
        for user in node.users:
            is_later = self._position[user] > self._position[after]
            if is_later and (user.users or user.op == "output"):
                return True
        return False

    def _is_constant(self, node: fx.Node) -> bool:
        """Compute a call that depends on the module's own tensors alone.

        Returns False, and does nothing, for another call.
        """
        if node.op == "call_module" or not node.all_input_nodes:
            return False
        if not all(self._has_tensor(one) for one in node.all_input_nodes):
            return False
        if _may_change_its_input(node, None):
            return False
        arguments = map_arg(node.args, self._tensor_of)
        named = map_arg(node.kwargs, self._tensor_of)
        with torch.no_grad():
            if node.op == "call_method":
                value = getattr(arguments[0], str(node.target))(*arguments[1:], **named)
            else:
                target: Any = node.target
                value = target(*arguments, **named)
        self._constants[node] = value
        return True

    def _has_tensor(self, node: fx.Node) -> bool:
        return node.op == "get_attr" or node in self._constants

    def _tensor_of(self, node: fx.Node) -> Any:
        """The value of a node that does not depend on the volume."""
        if node in self._constants:
            return self._constants[node]
        return operator.attrgetter(str(node.target))(self._module)

    def _with_tensors(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """The arguments, with tensors in place of the nodes that do not depend on the volume."""

        def value(argument: Any) -> Any:
            if isinstance(argument, fx.Node) and self._has_tensor(argument):
                return self._tensor_of(argument)
            return argument

        return {name: value(argument) for name, argument in arguments.items()}

    def _form(self, node: fx.Node) -> tuple[str, nn.Module | None, TorchForm | None]:
        """What a node calls: its name; the module if it is one; its torch form if it has one."""
        target: Any = node.target
        if node.op == "call_module":
            module = self._module.get_submodule(str(target))
            return type(module).__name__, module, MODULES.get(type(module))
        if node.op == "call_method":
            return str(target), None, METHODS.get(target)
        name = getattr(target, "__name__", str(target))
        full_name = f"{getattr(target, '__module__', '')}.{name}"
        return name, None, FUNCTIONS.get(target, FUNCTIONS_BY_NAME.get(full_name))


def _is_named_tuple(node: fx.Node) -> bool:
    """Whether a node makes a named tuple, which only the output may be."""
    return node.op == "call_function" and hasattr(node.target, "_fields")


def _may_change_its_input(node: fx.Node, module: nn.Module | None) -> bool:
    """Whether an operation without a compiled form may work in place.

    Torch's own operations say so by their name or their arguments. A function of the user may do so
    silently.
    """
    if module is not None:
        return bool(getattr(module, "inplace", False))
    if node.op == "call_method":
        return str(node.target).endswith("_") or "out" in node.kwargs
    function: Any = node.target
    if function.__name__.endswith("_") or "out" in node.kwargs:
        return True
    if not isinstance(function, FunctionType):
        return False
    arguments = inspect.signature(function).bind(*node.args, **node.kwargs).arguments
    return not function.__module__.startswith("torch.") or bool(arguments.get("inplace"))
