"""What a torch module returns: one tensor, or several in tuples, lists and dictionaries."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from torch import fx

OUTPUT = "output"
"""The name of a module's only tensor, and the beginning of the names of numbered ones."""


def named_outputs(value: Any) -> dict[str, Any]:
    """Name -> tensor, of all that a module returns.

    The names are the keys of dictionaries, the fields of named tuples, and numbers. A value that is
    None has no tensor, and is left out.

    Parameters
    ----------
    value : what the module returns, or what its trace returns, with nodes in place of tensors.

    Raises
    ------
    NotImplementedError : two tensors have the same name.

    Examples
    --------
    >>> named_outputs({"flow": 1, "scales": [2, 3], "aux": None})
    {'flow': 1, 'scales.0': 2, 'scales.1': 3}
    >>> named_outputs((1, 2))
    {'output.0': 1, 'output.1': 2}
    >>> named_outputs(1)
    {'output': 1}
    """
    named = {}
    for path, tensor in _leaves(value, ()):
        if not path or path[0].isdigit():
            path = (OUTPUT, *path)
        name = ".".join(path)
        if name in named:
            raise NotImplementedError(f"two outputs of one name, {name!r}, have no compiled form")
        named[name] = tensor
    return named


def _leaves(value: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """The tensors in a value, each with its path."""
    parts = _parts(value)
    if parts is not None:
        for name, part in parts.items():
            yield from _leaves(part, (*path, name))
    elif value is not None:
        yield path, value


def _parts(value: Any) -> dict[str, Any] | None:
    """Name -> part of a value; None if the value has no parts."""
    # a trace has a call of the class in place of a named tuple
    if isinstance(value, fx.Node) and value.op == "call_function":
        fields = getattr(value.target, "_fields", None)
        if fields is not None:
            return {**dict(zip(fields, value.args, strict=False)), **value.kwargs}
    if isinstance(value, Mapping):
        return {str(key): part for key, part in value.items()}
    if isinstance(value, (tuple, list)):
        names = getattr(value, "_fields", range(len(value)))
        return {str(name): part for name, part in zip(names, value, strict=True)}
    return None
