"""Valid files, damaged in hundreds of ways.

Bytes change, are lost or inserted; values of JSON become values of other types.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from typing import Any

import numpy as np

VALUES = (
    None,
    True,
    False,
    0,
    -1,
    2**31,
    2**64,
    0.5,
    1e308,
    -1e-9,
    "",
    "a\nb",
    "0",
    [],
    [0],
    [[]],
    {},
    {"": None},
)
"""Values of every type of JSON."""

RAW = {
    "whole number of 5,000 digits": "9" * 5_000,
    "nested too deep": "[" * 100_000,
    "nested deep": "[" * 500 + "]" * 500,
    "not a number": "NaN",
    "infinite": "-Infinity",
    "beyond float64": "1e999",
    "half a pair": '"\\ud800"',
    "cut": "",
}
"""What it is -> text that `json.dumps` does not write."""


def damaged_bytes(content: bytes, n: int, seed: int) -> Iterator[bytes]:
    """A file's content n times, each time damaged in a random way."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        at, end = sorted(rng.integers(0, len(content) + 1, 2).tolist())
        how = rng.integers(6)
        if how == 0:
            yield content[:at]
        elif how == 1:
            yield content[:at] + content[end:]
        elif how == 2:
            yield content[:at] + rng.bytes(int(rng.integers(1, 9))) + content[at:]
        elif how == 3:
            yield content[:at] + content[at : at + 9] * 2 + content[at + 9 :]
        else:
            changed = np.frombuffer(content, np.uint8).copy()
            places = rng.integers(0, len(changed), 1 if how == 4 else 5)
            changed[places] = rng.integers(0, 256, len(places))
            yield changed.tobytes()


def damaged_json(value: Any, n: int, seed: int) -> Iterator[str]:
    """A value as JSON n times, each time with one part replaced, removed or doubled."""
    rng = np.random.default_rng(seed)
    paths = list(_paths(value))
    for _ in range(n):
        path = paths[int(rng.integers(len(paths)))]
        changed = copy.deepcopy(value)
        how = rng.choice(["value", "raw", "remove", "double"], p=[0.6, 0.2, 0.1, 0.1])
        if how == "value":
            yield json.dumps(_replaced(changed, path, VALUES[int(rng.integers(len(VALUES)))]))
        elif how == "raw":
            raw = list(RAW.values())[int(rng.integers(len(RAW)))]
            yield json.dumps(_replaced(changed, path, "@raw@")).replace('"@raw@"', raw)
        elif not path:
            yield ""
        else:
            inside = changed
            for key in path[:-1]:
                inside = inside[key]
            if how == "remove":
                del inside[path[-1]]
            elif isinstance(inside, list):
                inside.insert(path[-1], copy.deepcopy(inside[path[-1]]))
            else:
                inside[f"{path[-1]} "] = inside[path[-1]]
            yield json.dumps(changed)


def _paths(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The way to the value itself, and to everything in it: the keys, one after the other."""
    yield path
    items: list[tuple[Any, Any]] = []
    if isinstance(value, dict):
        items = list(value.items())
    elif isinstance(value, list):
        items = list(enumerate(value))
    for key, inner in items:
        yield from _paths(inner, (*path, key))


def _replaced(value: Any, path: tuple[Any, ...], new: Any) -> Any:
    """The value, in which the part at the end of a path has become `new`."""
    if not path:
        return new
    inside = value
    for key in path[:-1]:
        inside = inside[key]
    inside[path[-1]] = new
    return value
