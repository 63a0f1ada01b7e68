"""The operations that a layer may be: the one list of them.

An operation stands in the table at the end of its module, with its shape and its steps before it.
Its ways in and out stand in `networks/torch/operations.py` and `networks/onnx/operations.py`, and
what it means in `tnt_reference.layers`. `python -m pydoc async_tnt.networks.layers.operations`
lists them with their parameters, the roles of their weights (those in brackets may be missing), and
what they compute:
"""

from __future__ import annotations

from async_tnt.networks.layers.activations import ACTIVATIONS
from async_tnt.networks.layers.joining import JOINING
from async_tnt.networks.layers.linear import LINEAR
from async_tnt.networks.layers.operation import Operation
from async_tnt.networks.layers.pooling import POOLING

OPERATIONS: dict[str, Operation] = {
    operation.name: operation for operation in (*LINEAR, *ACTIVATIONS, *POOLING, *JOINING)
}
"""Name -> operation, in the order in which messages and pages list them."""


def described(operation: Operation) -> str:
    """An operation in two lines.

    Examples
    --------
    >>> print(described(OPERATIONS["conv"]))
    conv: kernel, stride, padding, dilation, groups; weights weight, [bias]
        A convolution; weight (F, C / groups, *kernel), bias (F,).
    """
    parts = []
    if operation.parameters:
        parts.append(", ".join(operation.parameters))
    if operation.roles:
        roles = [role if needed else f"[{role}]" for role, needed in operation.roles.items()]
        parts.append(f"weights {', '.join(roles)}")
    given = "; ".join(parts) or "no parameters"
    return f"{operation.name}: {given}\n    {operation.description}"


if __doc__ is not None:  # python -OO drops it
    __doc__ += "\n" + "\n".join(described(operation) for operation in OPERATIONS.values())
