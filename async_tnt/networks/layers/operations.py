"""The table of all operations that a layer may be.

Each operation is defined at the end of its module, below the functions of its shape and its steps.
`networks/torch/operations.py` and `networks/onnx/operations.py` say how it is read and written.
`tnt_reference.layers` computes it in torch.

`python -m pydoc async_tnt.networks.layers.operations` lists the operations with their parameters,
the roles of their weights (a role in brackets may be missing), and what they compute:
"""

from __future__ import annotations

from async_tnt.networks.layers.activations import ACTIVATIONS
from async_tnt.networks.layers.joining import JOINING
from async_tnt.networks.layers.linear import LINEAR
from async_tnt.networks.layers.norms import NORMS
from async_tnt.networks.layers.operation import Operation
from async_tnt.networks.layers.padding import PADDINGS
from async_tnt.networks.layers.pooling import POOLING
from async_tnt.networks.layers.upsampling import UPSAMPLING

OPERATIONS: dict[str, Operation] = {
    operation.name: operation
    for operation in (*LINEAR, *ACTIVATIONS, *POOLING, *PADDINGS, *NORMS, *UPSAMPLING, *JOINING)
}
"""Name -> operation, in the order in which messages and pages list them."""


def described(operation: Operation) -> str:
    """A text of two lines: an operation's name, parameters and roles, then its description.

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
