"""A NIR graph as plain data: nodes with their arrays, and edges.

The graph comes from a file (HDF5) or from the library `nir`. Nothing of a file is trusted: every
size is checked before its numbers are read, and links to other files are refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from async_tnt.base.extras import needs_extra
from async_tnt.base.messages import one_line, short

MOST_NODES = 10_000
"""The most nodes of a graph, with those of graphs inside it."""

MOST_EDGES = 100_000
"""The most edges of a graph."""

MAX_NUMBERS = 1 << 26
"""The most numbers in a file: as float64 they take half a gigabyte."""

DEEPEST = 8
"""How deep graphs may lie in graphs."""

LONGEST_NAME = 1_000
"""The most characters of a name."""

Fields = Mapping[str, Any]
"""Name -> an array, a number, a text, or again fields."""


class Node(NamedTuple):
    """A node of a graph."""

    name: str
    kind: str
    """The node's type in NIR, such as `Conv2d`."""
    fields: Fields
    """Its parameters."""


class Graph(NamedTuple):
    """The nodes of a graph, without graphs inside it, and its edges."""

    nodes: dict[str, Node]
    edges: list[tuple[str, str]]
    metadata: Fields


def read_graph(path: Path) -> Graph:
    """The graph in a .nir file.

    Raises
    ------
    ImportError : h5py is not installed.
    ValueError : the file is damaged, or no NIR graph, or too large.
    """
    with needs_extra("nir", "NIR graphs are read by h5py"):
        import h5py
    try:
        with h5py.File(path, "r") as file:
            if not isinstance(_entry(file, "node"), h5py.Group):
                raise ValueError("it has no graph")
            content = _Content()
            fields = content.read(file["node"], 0)
        return graph_of(fields)
    except (OSError, RuntimeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{path} is not a readable NIR graph: {one_line(error)}") from None


def _entry(group: Any, name: str) -> Any:
    """An entry of an HDF5 group, which must not be a link to somewhere else."""
    import h5py

    link = group.get(name, getlink=True)
    if link is not None and not isinstance(link, h5py.HardLink):
        raise ValueError(f"{short(name)} is a link to somewhere else")
    return group.get(name)


class _Content:
    """The fields of a file, read with limits."""

    def __init__(self) -> None:
        self._n_numbers = 0
        self._n_entries = 0

    def read(self, group: Any, depth: int) -> dict[str, Any]:
        """The fields of an HDF5 group."""
        import h5py

        # a graph has two groups, nodes in it, and one of each node
        if depth > 3 * DEEPEST:
            raise ValueError(f"graphs lie in graphs more than {DEEPEST} deep")
        fields: dict[str, Any] = {}
        for name in group:
            self._n_entries += 1
            if self._n_entries > 20 * MOST_NODES:
                raise ValueError(f"it has more than {MOST_NODES:_} nodes")
            entry = _entry(group, name)
            if isinstance(entry, h5py.Group):
                fields[name] = self.read(entry, depth + 1)
            elif isinstance(entry, h5py.Dataset):
                fields[name] = self._values(name, entry)
            else:
                raise ValueError(f"{short(name)} is neither a group nor a data set")
        return fields

    def _values(self, name: str, dataset: Any) -> Any:
        """The values of a data set."""
        if dataset.is_virtual or dataset.external:
            raise ValueError(f"{short(name)} lies in another file")
        if dataset.shape is None:
            raise ValueError(f"{short(name)} is empty")
        size = math.prod(dataset.shape)
        self._n_numbers += size * max(1, dataset.dtype.itemsize // 8)
        if self._n_numbers > MAX_NUMBERS:
            raise ValueError(f"it has more than {MAX_NUMBERS:_} numbers")
        values = dataset[()]
        if isinstance(values, bytes):
            return _text(values)
        return values


def _text(value: Any) -> str:
    """A text, which files hold as bytes."""
    text = value.decode("utf-8") if isinstance(value, bytes) else value
    if not isinstance(text, str):
        raise ValueError(f"a name must be a text, got {short(text)}")
    if len(text) > LONGEST_NAME:
        raise ValueError(f"a name has more than {LONGEST_NAME:_} characters")
    return text


def graph_of(fields: Fields) -> Graph:
    """The graph of the fields of a file, or of what `nir.NIRGraph.to_dict` returns.

    Graphs inside the graph are opened: their nodes stand with their graph's name before their own.

    Raises
    ------
    ValueError : they are not those of a graph.
    """
    nodes: dict[str, Node] = {}
    edges: list[tuple[str, str]] = []
    _open(fields, "", nodes, edges, 0)
    metadata = fields.get("metadata", {})
    return Graph(nodes, edges, metadata if isinstance(metadata, Mapping) else {})


def _open(
    fields: Fields,
    prefix: str,
    nodes: dict[str, Node],
    edges: list[tuple[str, str]],
    depth: int,
) -> None:
    """Add the nodes and edges of a graph."""
    inner = fields.get("nodes")
    if _text(fields.get("type", "NIRGraph")) != "NIRGraph" or not isinstance(inner, Mapping):
        raise ValueError("it is no graph, which has `nodes` and `edges`")
    if depth > DEEPEST:
        raise ValueError(f"graphs lie in graphs more than {DEEPEST} deep")
    ends: dict[str, tuple[str, str]] = {}
    for short_name, node_fields in inner.items():
        name = prefix + _text(short_name)
        if not isinstance(node_fields, Mapping):
            raise ValueError(f"node {short(name)} has no fields")
        kind = _text(node_fields.get("type"))
        ends[_text(short_name)] = name, name
        if kind == "NIRGraph":
            _open(node_fields, f"{name}.", nodes, edges, depth + 1)
            ends[_text(short_name)] = _ends_of(node_fields, name)
            continue
        if name in nodes:
            raise ValueError(f"two nodes have the name {short(name)}")
        nodes[name] = Node(name, kind, node_fields)
        if len(nodes) > MOST_NODES:
            raise ValueError(f"it has more than {MOST_NODES:_} nodes")
    for edge in _pairs(fields.get("edges", ())):
        if edge[0] not in ends or edge[1] not in ends:
            raise ValueError(f"an edge joins {short(edge)}, and one of them is no node")
        pair = ends[edge[0]][1], ends[edge[1]][0]
        # some programs write an edge twice; it is one edge
        if pair not in edges:
            edges.append(pair)


def _ends_of(fields: Fields, name: str) -> tuple[str, str]:
    """The nodes by which a graph inside a graph is entered and left."""
    found = []
    for kind in ("Input", "Output"):
        names = [key for key, node in fields["nodes"].items() if _text(node["type"]) == kind]
        if len(names) != 1:
            raise ValueError(f"the graph {short(name)} must have one {kind}, got {len(names)}")
        found.append(f"{name}.{_text(names[0])}")
    return found[0], found[1]


def _pairs(edges: Any) -> list[tuple[str, str]]:
    """The edges as pairs of names."""
    rows = edges.tolist() if isinstance(edges, np.ndarray) else list(edges)
    if len(rows) > MOST_EDGES:
        raise ValueError(f"it has more than {MOST_EDGES:_} edges")
    pairs = []
    for row in rows:
        if not isinstance(row, (list, tuple)) or len(row) != 2:
            raise ValueError(f"an edge must be a pair of names, got {short(row)}")
        pairs.append((_text(row[0]), _text(row[1])))
    return pairs


def in_order(graph: Graph) -> list[Node]:
    """The nodes of a graph, each after those that it reads.

    Raises
    ------
    NotImplementedError : nodes read each other in a circle.
    """
    waits: dict[str, int] = dict.fromkeys(graph.nodes, 0)
    readers: dict[str, list[str]] = {name: [] for name in graph.nodes}
    for source, target in graph.edges:
        waits[target] += 1
        readers[source].append(target)
    ready = [name for name, n in waits.items() if n == 0]
    ordered = []
    while ready:
        name = ready.pop(0)
        ordered.append(graph.nodes[name])
        for reader in readers[name]:
            waits[reader] -= 1
            if waits[reader] == 0:
                ready.append(reader)
    if len(ordered) < len(graph.nodes):
        circle = next(name for name, n in waits.items() if n > 0)
        raise NotImplementedError(
            f"node {circle!r} is part of a recurrent connection: it reads its own output, and in "
            "one event there is no time for that; simulators in time steps define it"
        )
    return ordered
