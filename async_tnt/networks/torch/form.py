"""The torch form of an operation: which calls in torch compute it, and how they become layers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from torch import fx, nn

from async_tnt.networks.torch.layers import Call, LayerList

Rule = Callable[[LayerList, Call], str]
"""Adds the layers of a call, and returns the name of the last one."""

ArgumentsRule = Callable[[fx.Node], dict[str, Any]]
"""Finds the arguments of a call by name, for an operation whose arguments have no fixed order."""

INPLACE = {"inplace": False}
"""The parameter `inplace` of modules and functions that may work in place, with its default."""


@dataclass(frozen=True)
class TorchForm:
    """The modules, functions and methods of torch that become an operation, and their rule.

    Parameters
    ----------
    rule : how a call becomes layers.
    modules : the exact types of the modules. A subclass does not count, as it may compute anything.
    functions : the functions themselves, not their names: a user's function may have the same name.
    methods : names of a tensor's methods.
    parameters : name -> default of the parameters that follow the inputs, in torch's order. A
        module has them as attributes.
    inputs : names of the inputs.
    may_share : whether the result may lie in the memory of the input, as a view does.
    arguments_of : finds the arguments of a call if they have no fixed order.
    """

    rule: Rule
    modules: tuple[type[nn.Module], ...] = ()
    functions: tuple[Callable[..., Any], ...] = ()
    methods: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    inputs: tuple[str, ...] = ("input",)
    may_share: bool = False
    arguments_of: ArgumentsRule | None = None

    def arguments(self, node: fx.Node, module: nn.Module | None) -> dict[str, Any]:
        """All arguments of a call, by name.

        Raises
        ------
        NotImplementedError : an argument is not known. The message names the first such argument.
        """
        if self.arguments_of is not None:
            return self.arguments_of(node)
        # a module has its parameters as attributes; a function takes them behind the inputs
        known_names = [*self.inputs]
        if module is None:
            known_names += [*self.parameters, "out"]
        given_arguments = {**dict(zip(known_names, node.args, strict=False)), **node.kwargs}
        unknown_arguments = [*node.args[len(known_names) :]]
        unknown_arguments += [name for name in given_arguments if name not in known_names]
        if unknown_arguments:
            raise NotImplementedError(f"the argument {unknown_arguments[0]!r} has no compiled form")
        # `getattr` gives the default if `module` is None
        defaults = {name: getattr(module, name, value) for name, value in self.parameters.items()}
        return {**defaults, **given_arguments}


def plain_layer(op: str) -> Rule:
    """A rule that adds a layer with one input and no parameters."""

    def rule(layer_list: LayerList, call: Call) -> str:
        return layer_list.add(op, call)

    return rule


def same_layer(layer_list: LayerList, call: Call) -> str:
    """The rule of a call that passes its input on: it adds no layer."""
    node = call["input"]
    if node in layer_list.grouped:
        layer_list.grouped[call.node] = layer_list.grouped[node]
    return layer_list.source_of_view(node)
