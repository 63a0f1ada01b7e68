"""Torch modules as layers: `nn.Sequential`, and any module that `torch.fx` can trace."""

from __future__ import annotations

import copy
import inspect
import operator
from collections.abc import Mapping, Sequence
from types import FunctionType
from typing import Any

import numpy as np
import torch
from tnt_reference import LayerNetwork
from torch import fx, nn

from async_tnt.base.checks import one_line
from async_tnt.networks.layers.conversion_check import Function, compare
from async_tnt.networks.layers.graph import VOLUME, layer_shapes
from async_tnt.networks.torch.layers import Call, LayerList, float_array
from async_tnt.networks.torch.operations import FUNCTIONS, METHODS, MODULES, Operation

Layers = list[dict[str, Any]]
WAY_OUT = "; TorchClassifier(module) runs any module, and OnnxClassifier what torch exports to ONNX, whole at every decision"


def layers_from_torch(
    module: nn.Module, shape: tuple[int, ...], prefix: str = ""
) -> tuple[Layers, dict[str, np.ndarray]]:
    """The layers of a module and their weights, as in eval mode. The module itself stays as it is.

    Parameters
    ----------
    module : volumes (1, C, H, W) -> (1, n). Convolutions, linear layers, batch norm; ReLU,
        LeakyReLU, PReLU, ReLU6, Hardtanh, clamp, Sigmoid, Hardsigmoid, Tanh, SiLU, GELU, Hardswish,
        log1p; max, average and adaptive average pooling, mean over all places, pixel shuffle; sums
        and concatenations; sums and products with constants; flatten, dropout and identity: as
        modules, functions or methods, in place or not.
    shape : of a volume, (C, H, W).
    prefix : of the weights' names, which are otherwise those in `state_dict`.

    Raises
    ------
    TypeError : `module` is not a torch module.
    NotImplementedError : names the operations that are not among these, those that change in place
        what a view that is read later shows, or the first module with hooks.
    ValueError : a layer does not fit `shape`.
    """
    if not isinstance(module, nn.Module):
        advice = (
            ": load it into its module (load_state_dict)" if isinstance(module, Mapping) else ""
        )
        raise TypeError(f"`module` must be a torch.nn.Module, got {type(module).__name__}{advice}")
    if type(module) is LayerNetwork:
        layers = [_with_prefix(layer, prefix) for layer in module.layers]
        return layers, {f"{prefix}{name}": float_array(w) for name, w in module.tensors.items()}
    module = own_copy(module)
    if type(module) in MODULES:  # which a trace would look into
        module = nn.Sequential(module)
    try:
        graph = _Tracer().trace(module)
    except Exception as error:  # whatever the module's own code raises
        raise NotImplementedError(f"torch.fx cannot trace this module: {one_line(error)}") from None
    try:
        layers, weights = _Conversion(module, LayerList(shape, prefix)).run(graph)
        layer_shapes(layers, shape, {name: w.shape for name, w in weights.items()})
    except ValueError as error:
        try:
            _function_of(module)(np.zeros(shape, np.float32))
        except Exception:  # of any type: the module does not take such volumes either
            raise error from None
        raise NotImplementedError(f"the module cannot be read as layers: {error}") from None
    return layers, weights


def _with_prefix(layer: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    """The layer, with the prefix before its weights' names."""
    if "weights" not in layer:
        return dict(layer)
    return {
        **layer,
        "weights": {role: f"{prefix}{name}" for role, name in layer["weights"].items()},
    }


def check_torch_layers(
    module: nn.Module,
    layers: Sequence[Mapping[str, Any]],
    weights: Mapping[str, np.ndarray],
    shape: tuple[int, ...],
) -> None:
    """Compare a module with its layers, both in float64: a trace does not show everything that a
    module does.

    Parameters
    ----------
    layers, weights : as `layers_from_torch` made them.
    shape : of a volume, (C, H, W).

    Raises
    ------
    NotImplementedError : see `compare`.
    """
    try:
        compare(
            _function_of(own_copy(module)),
            _function_of(LayerNetwork(layers, weights).eval()),
            shape,
        )
    except ValueError as error:
        raise NotImplementedError(f"the module cannot be read as layers: {error}") from None


def _function_of(network: nn.Module) -> Function:
    """Of a network that nothing else uses, in float64."""
    network = network.cpu().double()

    def logits(volume: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return np.asarray(network(torch.tensor(volume, dtype=torch.float64)[None]))

    return logits


def own_copy(module: nn.Module) -> nn.Module:
    """The module in eval mode, for tracing and running without effects on the caller's.

    Raises
    ------
    NotImplementedError : it does something that neither a copy nor a trace shows, or cannot be
        copied.
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
    except Exception as error:  # of many types
        raise NotImplementedError(f"the module cannot be copied: {one_line(error)}") from None


class _Tracer(fx.Tracer):
    proxy_buffer_attributes = True  # a change of a buffer is recorded, too

    def is_leaf_module(self, m: nn.Module, module_qualified_name: str) -> bool:
        return super().is_leaf_module(m, module_qualified_name) or type(m) in MODULES


class _Conversion:
    """Reads the nodes of a trace in their order.

    An operation in place is read as one whose result takes its input's place, under all names of
    that tensor. A view of the tensor would have to change, too: where one is read later, the
    operation is refused.
    """

    def __init__(self, module: nn.Module, made: LayerList) -> None:
        self._module, self._made = module, made
        self._position: dict[fx.Node, int] = {}
        self._tensor: dict[fx.Node, fx.Node] = {}
        """A result in place -> the first node that is the same tensor; others are their own."""
        self._memory: dict[fx.Node, fx.Node] = {}
        """What may lie in another node's memory -> that node; others have their own."""

    def run(self, graph: fx.Graph) -> tuple[Layers, dict[str, np.ndarray]]:
        self._position = {node: k for k, node in enumerate(graph.nodes)}
        inputs = [node for node in graph.nodes if node.op == "placeholder"]
        if len(inputs) != 1:
            raise NotImplementedError(
                f"the module must take one volume, got {len(inputs)} arguments"
            )
        self._made.names[inputs[0]] = VOLUME
        refused = []
        for node in graph.nodes:
            if node.op not in ("placeholder", "get_attr", "output") and not self._is_size(node):
                try:
                    self._read(node)
                except NotImplementedError as error:
                    refused.append(str(error))
                    # any: others may be refused for reasons of their own
                    self._made.names[node] = VOLUME
                except ValueError:
                    if not refused:  # if there are some, shapes are wrong
                        raise
        if refused:
            raise NotImplementedError("; ".join(refused))
        (output,) = (node.args[0] for node in graph.nodes if node.op == "output")
        if not isinstance(output, fx.Node):
            raise NotImplementedError("the module must return one tensor of logits")
        try:
            return self._made.needed_for(output)
        except NotImplementedError as error:
            raise NotImplementedError(f"the module's output: {error}") from None

    def _is_size(self, node: fx.Node) -> bool:
        """x.size(...), x.shape, and numbers taken from them: known to `_view`, unknown to all other
        rules."""
        if node.op == "call_method" and node.target == "size":
            return True
        if node.op == "call_function" and node.target is getattr and node.args[1] == "shape":
            return True
        of = node.args[0] if node.target is operator.getitem else None
        return isinstance(of, fx.Node) and self._is_size(of)

    def _read(self, node: fx.Node) -> None:
        """Add a node's layer, if it is one, and keep the name of the layer whose value it has."""
        kind, module, operation = self._operation(node)
        where = (
            f"layer {node.target!r} ({kind})"
            if module is not None
            else f"operation {node.name!r} ({kind})"
        )
        if operation is None:
            if not node.users and not _may_change_its_input(node, module):
                return
            instead = (
                ": a decision has the softmax of its logits, leave it out"
                if "softmax" in kind.lower()
                else ""
            )
            raise NotImplementedError(f"{where} has no compiled form{instead}")
        try:
            call = Call(node, self._with_tensors(operation.arguments(node, module)), module)
            if node.users or call.written is not None:
                name = operation.rule(self._made, call)
                if call.written is not None:
                    self._write(node, call.written, name)
                elif operation.may_share:
                    self._memory[node] = self._memory.get(call["input"], call["input"])
                self._made.names[node] = name
        except NotImplementedError as error:
            raise NotImplementedError(f"{where}: {error}") from None

    def _write(self, node: fx.Node, written: fx.Node, name: str) -> None:
        """Give all names of the written tensor, also the node's own, the value of this layer.

        Raises
        ------
        NotImplementedError : another value that lies in its memory is read later.
        """
        tensor = self._tensor.get(written, written)
        memory = self._memory.get(written, written)
        is_change = name != self._made.source(written)
        for other in list(self._made.names):
            if self._tensor.get(other, other) is tensor:
                self._made.names[other] = name
            elif (
                is_change
                and self._memory.get(other, other) is memory
                and self._is_read(other, node)
            ):
                raise NotImplementedError(
                    f"a change in place of memory that {other.name!r} shares, which is read later, "
                    "has no compiled form"
                )
        self._tensor[node] = tensor
        self._memory[node] = memory

    def _is_read(self, node: fx.Node, after: fx.Node) -> bool:
        """Whether its value, and not its size alone, is read by a later operation whose result
        counts."""
        later = [user for user in node.users if self._position[user] > self._position[after]]
        return any(
            (user.users or user.op == "output") and not self._is_size(user) for user in later
        )

    def _with_tensors(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """The module's own parameters and buffers in place of the nodes that read them."""

        def value(argument: Any) -> Any:
            if isinstance(argument, fx.Node) and argument.op == "get_attr":
                return operator.attrgetter(str(argument.target))(self._module)
            return argument

        return {name: value(argument) for name, argument in arguments.items()}

    def _operation(self, node: fx.Node) -> tuple[str, nn.Module | None, Operation | None]:
        """The name of what a node calls, the module if it is one, and what is known of it."""
        if node.op == "call_module":
            module = self._module.get_submodule(str(node.target))
            return type(module).__name__, module, MODULES.get(type(module))
        name = (
            node.target
            if isinstance(node.target, str)
            else getattr(node.target, "__name__", str(node.target))
        )
        known = {"call_method": METHODS, "call_function": FUNCTIONS}.get(node.op, {})
        return name, None, known.get(node.target)


def _may_change_its_input(node: fx.Node, module: nn.Module | None) -> bool:
    """Whether an operation without a compiled form may work in place: torch's say so, others
    may."""
    if module is not None:
        return bool(getattr(module, "inplace", False))
    if node.op == "call_method":
        return str(node.target).endswith("_") or "out" in node.kwargs
    function: Any = node.target
    if function.__name__.endswith("_") or "out" in node.kwargs:
        return True
    if not isinstance(function, FunctionType):
        return False
    given = inspect.signature(function).bind(*node.args, **node.kwargs).arguments
    return not function.__module__.startswith("torch.") or bool(given.get("inplace"))
