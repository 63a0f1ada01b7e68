"""The state of a stream without the networks that decide about it.

The saved state is small. To continue the stream, the caller passes the model again.
"""

from __future__ import annotations

import io
import pickle
from typing import Any

from async_tnt.base.messages import one_line


def named_networks(classifier: Any, regressor: Any) -> dict[str, Any]:
    """Name -> part of a stream; None if the stream has no such part.

    A saved state contains the name in place of the part.
    """
    return {
        "classifier": classifier,
        "reader": getattr(classifier, "reader", None),
        "regressor": regressor,
    }


def dump_state(values: Any, networks: dict[str, Any]) -> bytes:
    """A pickle of values, in which each of the `named_networks` is only its name."""
    buffer = io.BytesIO()
    pickler = _Pickler(buffer, pickle.HIGHEST_PROTOCOL)
    pickler.names = {id(network): name for name, network in networks.items() if network is not None}
    pickler.dump(values)
    return buffer.getvalue()


def load_state(state: bytes, networks: dict[str, Any]) -> Any:
    """The values that `dump_state` has pickled, with these `named_networks`.

    Raises
    ------
    ValueError : `state` does not come from `dump_state`.
    """
    unpickler = _Unpickler(io.BytesIO(state))
    unpickler.networks = networks
    try:
        return unpickler.load()
    except Exception as error:  # a damaged pickle raises errors of any type
        raise ValueError(
            f"`state` must be what `save_state` of this release returned: {one_line(error)}"
        ) from None


class _Pickler(pickle.Pickler):
    names: dict[int, str]

    def persistent_id(self, value: Any) -> str | None:
        return self.names.get(id(value))


class _Unpickler(pickle.Unpickler):
    networks: dict[str, Any]

    def persistent_load(self, name: Any) -> Any:
        return self.networks[name]
