"""Compiled code of the entry points, which an installed package brings with it.

The folder `compiled` holds one file for each kind of processor; `ship` writes them:

    a line of JSON    the key, the code's SHA-256, and where the code of each entry point lies
    the code          as Numba writes it into its cache, one entry point after the other

The key says what the code was made from and for. A file is used only if its whole key is this
process's own, and if the code has its SHA-256. Otherwise kernels are compiled on this machine, as
if there were no file.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import pickle
import platform
import sys
import sysconfig
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba.core.runtime.nrt import rtsys

from async_tnt.kernels.jit import SOURCES
from async_tnt.kernels.target import LANES, chosen_kind, other_settings

FOLDER = Path(__file__).parent / "compiled"
"""Where the files lie."""


def own_key() -> dict[str, str]:
    """What compiled code must be made from and for, to fit this process.

    The names of the entries are the words in which `Shipped.why_not` speaks of them.
    """
    return {
        "kernels": SOURCES,
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "python": str(sysconfig.get_config_var("SOABI")),
        "system": f"{sys.platform} {platform.machine().lower()}",
        "processor": str(chosen_kind()),
        "numbers in a register": str(LANES),
    }


@dataclass(frozen=True)
class Shipped:
    """The compiled code that fits this process.

    Parameters
    ----------
    code : name of an entry point -> its code; empty if there is none that fits.
    why_not : why there is none; "" if there is.
    """

    code: dict[str, memoryview] = field(default_factory=dict)
    why_not: str = ""


@functools.cache
def shipped() -> Shipped:
    """Read the file for this process's kind of processor, once."""
    settings = other_settings()
    if settings:
        return Shipped(why_not=f"{settings[0]} is set")
    kind = chosen_kind()
    if kind is None:
        return Shipped(why_not="no package brings code for this processor")
    return read_file(FOLDER / f"{kind}.code")


def read_file(path: Path) -> Shipped:
    """The code in a file, if it fits this process."""
    try:
        head, _, body = path.read_bytes().partition(b"\n")
    except OSError:
        return Shipped(why_not="the package brings no code for this processor")
    try:
        description = json.loads(head)
        key = dict(description["key"])
        places = {
            name: (int(first), int(last)) for name, (first, last) in description["code"].items()
        }
        checksum = description["sha256"]
    except (ValueError, KeyError, TypeError, AttributeError):
        return Shipped(why_not=f"{path.name} is damaged")
    for name, value in own_key().items():
        if key.get(name) != value:
            return Shipped(why_not=_difference(name, key.get(name), value))
    if hashlib.sha256(body).hexdigest() != checksum:
        return Shipped(why_not=f"{path.name} is damaged")
    all_code = memoryview(body)
    return Shipped({name: all_code[first:last] for name, (first, last) in places.items()})


def _difference(name: str, theirs: Any, ours: str) -> str:
    """How a file's key differs from this process's."""
    if name == "kernels":
        return "the kernels have been changed"
    return f"it was made for {name} {theirs}, and this is {ours}"


def write_file(path: Path, code: dict[str, bytes]) -> None:
    """Write a file of code for this process's key."""
    places = {}
    first = 0
    for name, part in code.items():
        places[name] = (first, first + len(part))
        first += len(part)
    body = b"".join(code.values())
    description = {"key": own_key(), "sha256": hashlib.sha256(body).hexdigest(), "code": places}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(json.dumps(description).encode() + b"\n" + body)


def state_of_kernels() -> str:
    """Whether this process uses compiled code of the package, and if not, why, in words."""
    why_not = shipped().why_not
    if why_not:
        return f"compiled on this machine: {why_not}"
    return f"compiled code of the package, for {chosen_kind()} processors"


def load_shipped(name: str, context: Any) -> Any:
    """The compiled code of an entry point, as Numba's caches return it; None if there is none.

    context : Numba's target context.
    """
    code = shipped().code.get(name)
    if code is None:
        return None
    # Whatever Numba may raise at code that it cannot read, it can compile the kernel.
    with contextlib.suppress(Exception):
        context.refresh()
        rtsys.initialize(context)
        return numba.core.compiler.CompileResult._rebuild(context, *pickle.loads(code))
    return None
