"""Torch modules as layers: `nn.Sequential`, and any module that `torch.fx` can trace."""

from __future__ import annotations

import copy
import operator
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from tnt_reference import LayerNetwork
from torch import fx, nn

from async_tnt.checks import one_line
from async_tnt.networks.conversion_check import Function, compare
from async_tnt.networks.graph import VOLUME
from async_tnt.networks.torch_layers import IN_PLACE, Call, LayerList, float_array
from async_tnt.networks.torch_operations import ELEMENTWISE, FUNCTIONS, METHODS, MODULES, Operation

Layers = list[dict[str, Any]]
WAY_OUT = (
    "; TorchClassifier(module) runs any module, and OnnxClassifier what torch exports to ONNX, whole at every decision"
)


def layers_from_torch(
    module: nn.Module, shape: tuple[int, ...], prefix: str = ""
) -> tuple[Layers, dict[str, np.ndarray]]:
    """The layers of a module and their weights, as in eval mode. The module itself stays as it is.

    Parameters
    ----------
    module : volumes (1, C, H, W) -> (1, n). Convolutions, linear layers, batch norm; ReLU, LeakyReLU, PReLU, ReLU6,
        Hardtanh, clamp, Sigmoid, Hardsigmoid, Tanh, SiLU, GELU, Hardswish, log1p; max, average and adaptive average
        pooling, mean over all places; sums and concatenations; sums and products with constants; flatten, dropout and
        identity: as modules, functions or methods, in place or not.
    shape : of a volume, (C, H, W).
    prefix : of the weights' names, which are otherwise those in `state_dict`.

    Raises
    ------
    TypeError : `module` is not a torch module.
    NotImplementedError : names the operations that are not among these, or the first module with hooks.
    ValueError : a layer does not fit `shape`.
    """
    if not isinstance(module, nn.Module):
        advice = ": load it into its module (load_state_dict)" if isinstance(module, Mapping) else ""
        raise TypeError(f"`module` must be a torch.nn.Module, got {type(module).__name__}{advice}")
    if type(module) is LayerNetwork:
        return [dict(layer) for layer in module.layers], {name: float_array(w) for name, w in module.tensors.items()}
    module = own_copy(module)
    if type(module) in MODULES:  # which a trace would look into
        module = nn.Sequential(module)
    try:
        graph = _Tracer().trace(module)
    except Exception as error:  # whatever the module's own code raises
        raise NotImplementedError(f"torch.fx cannot trace this module: {one_line(error)}") from None
    return _Conversion(module, LayerList(shape, prefix)).run(graph)


def check_torch_layers(
    module: nn.Module, layers: Sequence[Mapping[str, Any]], weights: Mapping[str, np.ndarray], shape: tuple[int, ...]
) -> None:
    """Compare a module with its layers, both in float64: a trace does not show everything that a module does.

    Parameters
    ----------
    layers, weights : as `layers_from_torch` made them.
    shape : of a volume, (C, H, W).

    Raises
    ------
    NotImplementedError : see `compare`.
    """

    def function_of(network: nn.Module) -> Function:
        network = network.cpu().double()

        def logits(volume: np.ndarray) -> np.ndarray:
            with torch.no_grad():
                return np.asarray(network(torch.tensor(volume, dtype=torch.float64)[None]))

        return logits

    try:
        compare(function_of(own_copy(module)), function_of(LayerNetwork(layers, weights).eval()), shape)
    except ValueError as error:
        raise NotImplementedError(f"the module cannot be read as layers: {error}") from None


def own_copy(module: nn.Module) -> nn.Module:
    """The module in eval mode, for tracing and running without effects on the caller's.

    Raises
    ------
    NotImplementedError : it does something that neither a copy nor a trace shows, or cannot be copied.
    """
    for name, part in module.named_modules():
        where = f"layer {name!r} ({type(part).__name__})" if name else "the module"
        if isinstance(part, torch.jit.ScriptModule):
            raise NotImplementedError(f"{where} is compiled by torch.jit: take what it was made from")
        if isinstance(part, nn.modules.lazy.LazyModuleMixin):
            raise NotImplementedError(f"{where} has no weights yet: call the module once")
        if part._forward_hooks or part._forward_pre_hooks:  # torch has no public way to ask
            raise NotImplementedError(f"{where} has hooks, which a trace does not show: remove them")
        if "forward" in vars(part) and not isinstance(part, fx.GraphModule):
            raise NotImplementedError(f"{where} has a `forward` that is not of its class")
    try:
        return copy.deepcopy(module).eval()
    except Exception as error:  # of many types
        raise NotImplementedError(f"the module cannot be copied: {one_line(error)}") from None


class _Proxy(fx.Proxy):
    """A value of the trace that also records `x += y`, where fx would record `x + y`."""


for _function in IN_PLACE - {operator.setitem, operator.delitem}:

    def _record(self: fx.Proxy, other: Any, function: Any = _function) -> fx.Proxy:
        return self.tracer.create_proxy("call_function", function, (self, other), {})

    setattr(_Proxy, f"__{_function.__name__}__", _record)


class _Tracer(fx.Tracer):
    proxy_buffer_attributes = True  # a change of a buffer is recorded, too

    def is_leaf_module(self, m: nn.Module, module_qualified_name: str) -> bool:
        return super().is_leaf_module(m, module_qualified_name) or type(m) in MODULES

    def proxy(self, node: fx.Node) -> fx.Proxy:
        return _Proxy(node, self)


class _Conversion:
    """Reads the nodes of a trace in their order.

    In-place operations are read as copies, so it also keeps which nodes share memory: after one of them has been
    written to, the others stand for the new value, or for none that a layer has.
    """

    def __init__(self, module: nn.Module, made: LayerList) -> None:
        self._module, self._made = module, made
        self._memory: dict[fx.Node, fx.Node] = {}  # node -> the first one in the same memory

    def run(self, graph: fx.Graph) -> tuple[Layers, dict[str, np.ndarray]]:
        inputs = [node for node in graph.nodes if node.op == "placeholder"]
        if len(inputs) != 1:
            raise NotImplementedError(f"the module must take one volume, got {len(inputs)} arguments")
        self._made.names[inputs[0]] = VOLUME
        refused = []
        for node in graph.nodes:
            if node.op not in ("placeholder", "get_attr", "output") and not self._is_size(node):
                try:
                    self._read(node)
                except NotImplementedError as error:
                    refused.append(str(error))
                    self._made.names[node] = VOLUME  # any: others may be refused for reasons of their own
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
        """x.size(...), x.shape, and numbers taken from them: known to `_view`, unknown to all other rules."""
        if node.op == "call_method" and node.target == "size":
            return True
        if node.op == "call_function" and node.target is getattr and node.args[1] == "shape":
            return True
        of = node.args[0] if node.target is operator.getitem else None
        return isinstance(of, fx.Node) and self._is_size(of)

    def _read(self, node: fx.Node) -> None:
        """Add a node's layer, if it is one, and keep the name of the layer whose value it has."""
        kind, module, operation = self._operation(node)
        where = f"layer {node.target!r} ({kind})" if module is not None else f"operation {node.name!r} ({kind})"
        if operation is None and node.users:
            instead = ": a decision has the softmax of its logits, leave it out" if "softmax" in kind.lower() else ""
            raise NotImplementedError(f"{where} has no compiled form{instead}")
        nothing_to_read = not node.users and not self._made.overwritten.keys().isdisjoint(node.all_input_nodes)
        try:
            if operation is None or nothing_to_read:
                for source in [] if _is_pure(node, module, kind) else node.all_input_nodes:
                    self._write(source, {}, where)
                return
            call = Call(node, self._with_tensors(operation.arguments(node, module)), module)
            if node.users or call.written is not None:
                self._add(call, operation, where)
        except NotImplementedError as error:
            raise NotImplementedError(f"{where}: {error}") from None

    def _with_tensors(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """The module's own parameters and buffers in place of the nodes that read them."""

        def value(argument: Any) -> Any:
            if isinstance(argument, fx.Node) and argument.op == "get_attr":
                return operator.attrgetter(str(argument.target))(self._module)
            return argument

        return {name: value(argument) for name, argument in arguments.items()}

    def _add(self, call: Call, operation: Operation, where: str) -> None:
        made, written = self._made, call.written
        name = operation.rule(made, call)
        if written is not None:
            values = {made.source(written): name}
            if operation.rule in ELEMENTWISE and written is call["input"]:  # the same for what has another shape
                for other in {made.names[node] for node in self._sharing(written)} - values.keys():
                    values[other] = operation.rule(made, replace(call, arguments={**call.arguments, "input": other}))
            self._write(written, values, where)
        shared = call.arguments["input"] if operation.is_view else written
        if shared is not None:
            self._memory[call.node] = self._memory.get(shared, shared)
        self._made.names[call.node] = name

    def _sharing(self, source: fx.Node) -> list[fx.Node]:
        """The nodes in the memory of `source` whose value a layer has."""
        memory = self._memory.get(source, source)
        return [node for node in self._made.names if self._memory.get(node, node) is memory]

    def _write(self, source: Any, values: Mapping[str, str], where: str) -> None:
        """The memory of `source` has changed. `values` : the layer of a value before -> the layer of it now."""
        if source not in self._made.overwritten:
            self._made.source(source)  # refuses weights and buffers
        for node in self._sharing(source):
            before = self._made.names.pop(node)
            if before in values:
                self._made.names[node] = values[before]
            else:
                self._made.overwritten[node] = where

    def _operation(self, node: fx.Node) -> tuple[str, nn.Module | None, Operation | None]:
        """The name of what a node calls, the module if it is one, and what is known of it."""
        if node.op == "call_module":
            module = self._module.get_submodule(str(node.target))
            return type(module).__name__, module, MODULES.get(type(module))
        name = node.target if isinstance(node.target, str) else getattr(node.target, "__name__", str(node.target))
        known = {"call_method": METHODS, "call_function": FUNCTIONS}.get(node.op, {})
        return name, None, known.get(node.target)


def _is_pure(node: fx.Node, module: nn.Module | None, name: str) -> bool:
    """Whether an operation without a compiled form is torch's or Python's own, and changes nothing in place."""
    if node.op == "call_function":
        theirs = str(getattr(node.target, "__module__", "")).partition(".")[0] in ("torch", "_operator", "builtins")
        if not theirs or node.target in IN_PLACE or "out" in node.kwargs:
            return False
    return not (name.endswith("_") or node.kwargs.get("inplace") or getattr(module, "inplace", False))
