"""Torch modules as layers: `nn.Sequential`, and any module that `torch.fx` can trace."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.checks import one_line
from async_tnt.networks.conversion_check import WAY_OUT, in_eval_mode
from async_tnt.networks.graph import VOLUME

if TYPE_CHECKING:
    from torch import fx, nn

Layers = list[dict[str, Any]]


def layers_from_torch(module: nn.Module, prefix: str = "") -> tuple[Layers, dict[str, np.ndarray]]:
    """The layers of a module and their weights, as in eval mode.

    Parameters
    ----------
    prefix : of the weights' names, which are otherwise those in `state_dict`.
    module : volumes (N, C, H, W) -> (N, n). Convolutions, linear layers, batch norm; ReLU, LeakyReLU, PReLU, ReLU6,
        Hardtanh and clamp; max and average pooling, adaptive average pooling to one place, mean over all places; sums
        and concatenations; flatten, dropout and identity: as modules, functions or methods.

    Raises
    ------
    NotImplementedError : names the first operation that is not among these.
    """
    from torch import fx

    own: Any = module
    if type(own).__name__ == "LayerNetwork":  # the reference's, which is made of layers
        return [dict(layer) for layer in own.layers], {name: _array(w) for name, w in own.tensors.items()}
    try:
        with in_eval_mode(module):
            graph = _Tracer().trace(module)
    except (fx.proxy.TraceError, TypeError, RuntimeError) as error:
        raise NotImplementedError(f"torch.fx cannot trace this module: {one_line(error)}{WAY_OUT}") from None
    return _Conversion(module, prefix).run(graph)


def _array(tensor: Any) -> np.ndarray:
    array: np.ndarray = tensor.detach().cpu().float().numpy()
    return array


def _Tracer() -> fx.Tracer:
    from torch import fx

    class Tracer(fx.Tracer):
        def is_leaf_module(self, m: nn.Module, module_qualified_name: str) -> bool:
            return super().is_leaf_module(m, module_qualified_name) or type(m).__name__ in MODULES

    return Tracer()


class _Conversion:
    def __init__(self, module: nn.Module, prefix: str) -> None:
        self._prefix, self._modules = prefix, dict(module.named_modules())
        self._layers: Layers = []
        self._tensors: dict[str, np.ndarray] = {}
        self._names: dict[Any, str] = {}  # of the layer whose value a node has

    def run(self, graph: fx.Graph) -> tuple[Layers, dict[str, np.ndarray]]:
        inputs = [node for node in graph.nodes if node.op == "placeholder"]
        if len(inputs) != 1:
            raise NotImplementedError(f"the module must take one volume, got {len(inputs)} arguments{WAY_OUT}")
        self._names[inputs[0]] = VOLUME
        for node in graph.nodes:
            if node.op == "output":
                if node.args[0] not in self._names:
                    raise NotImplementedError(f"the module must return one tensor of logits{WAY_OUT}")
                break
            if node.op != "placeholder" and node.users and not self._is_batch_size(node):
                self._names[node] = self._convert(node)
        output = self._names[node.args[0]]
        if not self._layers or self._layers[-1]["name"] != output:
            raise NotImplementedError(f"the module's last operation must give its logits{WAY_OUT}")
        return self._layers, self._tensors

    def _is_batch_size(self, node: fx.Node) -> bool:
        """x.size(0), x.shape, x.shape[0]: what a view gets."""
        if node.op == "call_method" and node.target == "size":
            return True
        if node.op == "call_function" and node.target is getattr and node.args[1] == "shape":
            return True
        return node.target is operator.getitem and getattr(node.args[0], "target", None) in (getattr, "size")

    def _convert(self, node: fx.Node) -> str:
        """Add a node's layer, if it is one; returns the name of the layer whose value it has."""
        where, rule, arguments = self._rule(node)
        try:
            return rule(self, node, *arguments)
        except NotImplementedError as error:
            raise NotImplementedError(f"{where}: {error}{WAY_OUT}") from None

    def _rule(self, node: fx.Node) -> tuple[str, Callable[..., str], tuple[Any, ...]]:
        if node.op == "call_module":
            module = self._modules[str(node.target)]
            kind = type(module).__name__
            if kind in MODULES:
                return f"layer {node.target!r} ({kind})", MODULES[kind], (module,)
            raise NotImplementedError(f"layer {node.target!r} is a {kind}, which has no compiled form{WAY_OUT}")
        name = node.target if isinstance(node.target, str) else getattr(node.target, "__name__", str(node.target))
        rules = METHODS if node.op == "call_method" else FUNCTIONS
        if node.op in ("call_method", "call_function") and name in rules:
            return f"operation {node.name!r} ({name})", rules[name], ()
        raise NotImplementedError(f"operation {node.name!r} ({name}) has no compiled form{WAY_OUT}")

    def add(self, op: str, node: fx.Node, sources: Sequence[Any], **parameters: Any) -> str:
        taken = {VOLUME, *(layer["name"] for layer in self._layers)}
        name = str(node.target) if node.op == "call_module" and str(node.target) not in taken else node.name
        while name in taken:
            name += "_"
        for source in sources:
            if source not in self._names:
                raise NotImplementedError(f"its input {source} is not computed from the volume")
        inputs = [self._names[source] for source in sources]
        self._layers.append({"op": op, "name": name, "inputs": inputs, **parameters})
        return name

    def source(self, node: Any) -> str:
        """The layer that a node stands for itself: of a dropout, the one before it."""
        return self._names[node]

    def rename(self, node: Any, layer: str) -> None:
        self._names[node] = layer

    def tensors(self, node: fx.Node, module: nn.Module, **roles: str) -> dict[str, str]:
        """Keep a module's tensors; role -> name, without those that are None."""
        weights = {}
        for role, attribute in roles.items():
            tensor = getattr(module, attribute)
            if tensor is not None:
                weights[role] = f"{self._prefix}{node.target}.{attribute}"
                self._tensors[weights[role]] = _array(tensor)
        return weights


def _pair(value: Any) -> list[int]:
    return [int(v) for v in value] if isinstance(value, (tuple, list)) else [int(value)] * 2


def _expect(condition: bool, what: str) -> None:
    if not condition:
        raise NotImplementedError(f"{what} has no compiled form")


def _argument(node: fx.Node, place: int, name: str, default: Any = None) -> Any:
    return node.args[place] if len(node.args) > place else node.kwargs.get(name, default)


def _conv(made: _Conversion, node: fx.Node, module: Any) -> str:
    _expect(module.padding_mode == "zeros", f"padding_mode {module.padding_mode!r}")
    kernel, dilation = _pair(module.kernel_size), _pair(module.dilation)
    if module.padding == "same":
        total = [(k - 1) * d for k, d in zip(kernel, dilation, strict=True)]
        padding = [n // 2 for n in total] + [n - n // 2 for n in total]
    else:
        padding = 2 * _pair(0 if module.padding == "valid" else module.padding)
    return made.add(
        "conv",
        node,
        node.args,
        weights=made.tensors(node, module, weight="weight", bias="bias"),
        kernel=kernel,
        stride=_pair(module.stride),
        padding=padding,
        dilation=dilation,
        groups=module.groups,
    )


def _linear(made: _Conversion, node: fx.Node, module: Any) -> str:
    return made.add("dense", node, node.args, weights=made.tensors(node, module, weight="weight", bias="bias"))


def _batch_norm(made: _Conversion, node: fx.Node, module: Any) -> str:
    _expect(module.running_mean is not None, "a batch norm without running statistics")
    roles = {"mean": "running_mean", "variance": "running_var", "weight": "weight", "bias": "bias"}
    return made.add("batch_norm", node, node.args, weights=made.tensors(node, module, **roles), epsilon=module.eps)


def _relu(made: _Conversion, node: fx.Node, module: Any = None) -> str:
    return made.add("relu", node, node.args[:1])


def _relu6(made: _Conversion, node: fx.Node, module: Any = None) -> str:
    return made.add("clip", node, node.args[:1], low=0.0, high=6.0)


def _hardtanh(made: _Conversion, node: fx.Node, module: Any = None) -> str:
    low = module.min_val if module is not None else _argument(node, 1, "min_val", -1.0)
    high = module.max_val if module is not None else _argument(node, 2, "max_val", 1.0)
    return made.add("clip", node, node.args[:1], low=float(low), high=float(high))


def _clamp(made: _Conversion, node: fx.Node) -> str:
    limits = {"low": _argument(node, 1, "min"), "high": _argument(node, 2, "max")}
    for value in limits.values():
        _expect(value is None or isinstance(value, (int, float)), "a limit that is no number")
    return made.add("clip", node, node.args[:1], **limits)


def _leaky_relu(made: _Conversion, node: fx.Node, module: Any = None) -> str:
    slope = module.negative_slope if module is not None else _argument(node, 1, "negative_slope", 0.01)
    return made.add("leaky_relu", node, node.args[:1], slope=float(slope))


def _prelu(made: _Conversion, node: fx.Node, module: Any) -> str:
    return made.add("prelu", node, node.args, weights=made.tensors(node, module, slope="weight"))


def _pool(made: _Conversion, node: fx.Node, op: str, arguments: Mapping[str, Any]) -> str:
    kernel, stride, padding = arguments["kernel_size"], arguments["stride"], arguments["padding"]
    _expect(not arguments["ceil_mode"], "ceil_mode")
    window = {"kernel": _pair(kernel), "stride": _pair(kernel if stride is None else stride)}
    return made.add(op, node, node.args[:1], **window, padding=2 * _pair(padding))


MAX_POOL = {"kernel_size": None, "stride": None, "padding": 0, "dilation": 1, "ceil_mode": False}
AVERAGE_POOL = {
    "kernel_size": None,
    "stride": None,
    "padding": 0,
    "ceil_mode": False,
    "count_include_pad": True,
    "divisor_override": None,
}


def _arguments(node: fx.Node, module: Any, defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Of a pooling, as a module or as a function."""
    if module is not None:
        return {name: getattr(module, name) for name in defaults}
    return {name: _argument(node, k + 1, name, default) for k, (name, default) in enumerate(defaults.items())}


def _max_pool(made: _Conversion, node: fx.Node, module: Any = None) -> str:
    arguments = _arguments(node, module, MAX_POOL)
    _expect(_pair(arguments["dilation"]) == [1, 1], "dilation")
    _expect(not (getattr(module, "return_indices", False) or node.kwargs.get("return_indices")), "return_indices")
    return _pool(made, node, "max_pool", arguments)


def _average_pool(made: _Conversion, node: fx.Node, module: Any = None) -> str:
    arguments = _arguments(node, module, AVERAGE_POOL)
    padded = any(_pair(arguments["padding"]))
    _expect(bool(arguments["count_include_pad"]) or not padded, "padding with count_include_pad=False")
    _expect(arguments["divisor_override"] in (None, 1), "divisor_override")
    return _pool(made, node, "average_pool" if arguments["divisor_override"] is None else "sum_pool", arguments)


def _adaptive_pool(made: _Conversion, node: fx.Node, module: Any = None) -> str:
    size = module.output_size if module is not None else _argument(node, 1, "output_size")
    _expect(size in (1, (1, 1), [1, 1]), f"an output size of {size}, not 1,")
    return made.add("global_average_pool", node, node.args[:1])


def _mean(made: _Conversion, node: fx.Node) -> str:
    axes = _argument(node, 1, "dim")
    axes = sorted(axis % 4 for axis in axes) if isinstance(axes, (tuple, list)) else axes
    _expect(axes == [2, 3], f"a mean over {axes}, not over all places (2, 3),")
    pooled = made.add("global_average_pool", node, node.args[:1])
    if _argument(node, 2, "keepdim", False):
        return pooled
    made.rename(node, pooled)
    return made.add("flatten", node, [node])


def _add(made: _Conversion, node: fx.Node) -> str:
    _expect(not set(node.kwargs) - {"input", "other"}, "a factor alpha")
    return made.add("add", node, [*node.args, *node.kwargs.values()])


def _cat(made: _Conversion, node: fx.Node) -> str:
    axis = _argument(node, 1, "dim", 0)
    _expect(axis in (1, -3), f"a concatenation along axis {axis}, not of channels (1),")
    return made.add("concat", node, _argument(node, 0, "tensors"))


def _flatten(made: _Conversion, node: fx.Node, module: Any = None) -> str:
    first = module.start_dim if module is not None else _argument(node, 1, "start_dim", 0)
    last = module.end_dim if module is not None else _argument(node, 2, "end_dim", -1)
    _expect((first, last) == (1, -1), f"a flatten from axis {first} to {last}, not from 1 to -1,")
    return made.add("flatten", node, [_argument(node, 0, "input")])


def _view(made: _Conversion, node: fx.Node) -> str:
    """x.view(n, -1), with the batch's size or a number, or (-1, m), which the check of a conversion compares."""
    shape = node.args[1] if isinstance(node.args[1], (tuple, list)) else node.args[1:]
    _expect(len(shape) == 2 and isinstance(shape[1], int), "a view other than (n, -1)")
    return made.add("flatten", node, node.args[:1])


def _nothing(made: _Conversion, node: fx.Node, module: Any = None) -> str:
    return made.source(node.args[0])


def _centroid(made: _Conversion, node: fx.Node, module: Any) -> str:
    return made.add("heatmap_centroid", node, node.args)


MODULES: dict[str, Callable[..., str]] = {
    "Conv2d": _conv,
    "Linear": _linear,
    **dict.fromkeys(("BatchNorm1d", "BatchNorm2d"), _batch_norm),
    "ReLU": _relu,
    "ReLU6": _relu6,
    "Hardtanh": _hardtanh,
    "LeakyReLU": _leaky_relu,
    "PReLU": _prelu,
    "MaxPool2d": _max_pool,
    "AvgPool2d": _average_pool,
    "AdaptiveAvgPool2d": _adaptive_pool,
    "Flatten": _flatten,
    **dict.fromkeys(("Dropout", "Dropout1d", "Dropout2d", "Identity"), _nothing),
    "HeatmapCentroid": _centroid,
}
"""Type of a module -> its rule."""
FUNCTIONS: dict[str, Callable[..., str]] = {
    **dict.fromkeys(("relu", "relu_"), _relu),
    "relu6": _relu6,
    "hardtanh": _hardtanh,
    **dict.fromkeys(("clamp", "clip"), _clamp),
    "leaky_relu": _leaky_relu,
    "max_pool2d": _max_pool,
    "boolean_dispatch": _max_pool,
    "avg_pool2d": _average_pool,
    "adaptive_avg_pool2d": _adaptive_pool,
    "mean": _mean,
    **dict.fromkeys(("add", "iadd"), _add),
    **dict.fromkeys(("cat", "concat"), _cat),
    "flatten": _flatten,
    **dict.fromkeys(("dropout", "dropout2d"), _nothing),
}
METHODS: dict[str, Callable[..., str]] = {
    **{name: FUNCTIONS[name] for name in ("relu", "relu_", "clamp", "clip", "mean", "add", "flatten")},
    "add_": _add,
    "view": _view,
    "reshape": _view,
    "contiguous": _nothing,
}
