"""The trace of a torch module for volumes of one shape.

`torch.fx` runs the module's code with proxies in place of tensors. Here a proxy knows the shape of
its tensor, so code that computes with shapes, or asserts something about them, leaves no trace. The
shapes come from a copy of the module that computes with tensors without data.
"""

from __future__ import annotations

import contextlib
import copy
import operator
from collections.abc import Iterator, Mapping
from typing import Any

import torch
from torch import fx, nn
from torch.fx.node import map_arg

VALUE = "value"
"""The key of a value without data in its node's `meta`. It is missing if the value is not known."""

WITHOUT_DATA = "meta"
"""Torch's device of tensors without data."""


class ShapedProxy(fx.Proxy):
    """A proxy that knows the shape of its tensor, if the shape is known."""

    @property
    def value(self) -> Any:
        """The node's value, a tensor without data or something else; None if it is not known."""
        return self.node.meta.get(VALUE)

    def __getattr__(self, name: str) -> Any:
        value = self.value
        if isinstance(value, torch.Tensor) and name in ("shape", "ndim", "dtype"):
            return getattr(value, name)
        return super().__getattr__(name)

    def size(self, *axes: Any) -> Any:
        """The sides of the tensor, or one of them."""
        if isinstance(self.value, torch.Tensor):
            return self.value.size(*axes)
        return self.tracer.create_proxy("call_method", "size", (self, *axes), {})

    def dim(self) -> Any:
        """The number of axes."""
        if isinstance(self.value, torch.Tensor):
            return self.value.dim()
        return self.tracer.create_proxy("call_method", "dim", (self,), {})

    # torch.fx has no forms of these, so `y = x; y += 1` would leave x as it was

    def __iadd__(self, other: Any) -> Any:
        return self._in_place("add_", other)

    def __isub__(self, other: Any) -> Any:
        return self._in_place("sub_", other)

    def __imul__(self, other: Any) -> Any:
        return self._in_place("mul_", other)

    def __itruediv__(self, other: Any) -> Any:
        return self._in_place("div_", other)

    def _in_place(self, method: str, other: Any) -> Any:
        return self.tracer.create_proxy("call_method", method, (self, other), {})

    def __len__(self) -> int:
        """The number of parts, or the first side of a tensor."""
        if self.value is None:
            return super().__len__()
        return len(self.value)

    def __getitem__(self, index: Any) -> Any:
        """A part of a tensor or tuple, or several parts of a tuple."""
        if isinstance(self.value, (tuple, list)) and isinstance(index, slice):
            return tuple(self)[index]
        return self.tracer.create_proxy("call_function", operator.getitem, (self, index), {})

    def __iter__(self) -> Iterator[Any]:
        """The parts of a tuple, as `chunk` returns one."""
        if isinstance(self.value, (tuple, list)):
            return iter([self[k] for k in range(len(self.value))])
        return super().__iter__()


class Tracer(fx.Tracer):
    """Traces one module for volumes of one shape.

    Parameters
    ----------
    module : the module.
    shape : (C, H, W) of the volumes.
    leaves : the types of modules that are taken as one call.
    """

    proxy_buffer_attributes = True  # a change of a buffer is recorded, too

    def __init__(
        self, module: nn.Module, shape: tuple[int, ...], leaves: Mapping[type, Any]
    ) -> None:
        super().__init__()
        self._leaves = leaves
        self._example = torch.empty(1, *shape, device=WITHOUT_DATA)
        self._twin: nn.Module = copy.deepcopy(module).to(WITHOUT_DATA)
        self._computes_value = False

    def is_leaf_module(self, m: nn.Module, module_qualified_name: str) -> bool:
        return super().is_leaf_module(m, module_qualified_name) or type(m) in self._leaves

    def call_module(self, m: nn.Module, forward: Any, args: Any, kwargs: Any) -> Any:
        # while a module is traced, torch.fx catches the calls of all modules, also of the copy
        if self._computes_value:
            return forward(*args, **kwargs)
        return super().call_module(m, forward, args, kwargs)

    def proxy(self, node: fx.Node) -> fx.Proxy:
        return ShapedProxy(node, self)

    def create_proxy(self, *arguments: Any, **named: Any) -> Any:
        proxy = super().create_proxy(*arguments, **named)
        self._computes_value = True
        # code of any kind raises errors of any type: then the value is not known
        with contextlib.suppress(Exception):
            proxy.node.meta[VALUE] = self._value_of(proxy.node)
        self._computes_value = False
        return proxy

    def _value_of(self, node: fx.Node) -> Any:
        """The node's value, without data.

        Raises
        ------
        KeyError : the value of an argument is not known.
        Exception : what the called code raises passes through.
        """
        if node.op == "placeholder":
            return self._example
        if node.op == "get_attr":
            return _attribute(self._twin, self.root, str(node.target))
        arguments = map_arg(node.args, lambda one: one.meta[VALUE])
        named = map_arg(node.kwargs, lambda one: one.meta[VALUE])
        with torch.no_grad():
            if node.op == "call_module":
                return self._twin.get_submodule(str(node.target))(*arguments, **named)
            if node.op == "call_method":
                return getattr(arguments[0], str(node.target))(*arguments[1:], **named)
            target: Any = node.target
            return target(*arguments, **named)


def _attribute(twin: nn.Module, module: nn.Module, name: str) -> Any:
    """A parameter, buffer or constant of a module, without data."""
    find = operator.attrgetter(name)
    try:
        return find(twin)
    except AttributeError:  # a constant that the trace has put into the module
        return find(module).to(WITHOUT_DATA)
