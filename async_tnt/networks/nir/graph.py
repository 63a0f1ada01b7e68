"""A NIR graph as plain data: nodes with their arrays, and edges.

The graph comes from a file (HDF5) or from the library `nir`. Nothing of a file is trusted.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from async_tnt.base.extras import needs_extra
from async_tnt.base.hdf5_content import read_hdf5
from async_tnt.base.messages import one_line, short

MOST_NODES = 10_000
"""The most nodes of a graph, with those of graphs inside it."""

MOST_EDGES = 100_000
"""The most edges of a graph."""

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
    OSError : there is no such file, or it cannot be opened.
    ValueError : the file is damaged, or no NIR graph, or too large.
    """
    with needs_extra("nir", "NIR graphs are read by h5py"):
        import h5py  # noqa: F401  # a worker process imports it, where nobody would see the error
    try:
        return graph_of(read_hdf5(path, "node"))
    except ValueError as error:
        raise ValueError(f"{path} is not a readable NIR graph: {one_line(error)}") from None


def _text(value: Any) -> str:
    """A text, which files hold as bytes."""
    try:
        text = value.decode("utf-8") if isinstance(value, bytes) else value
    except UnicodeDecodeError:
        raise ValueError(f"a text must be UTF-8, got {short(value)}") from None
    if not isinstance(text, str):
        raise ValueError(f"a name must be a text, got {short(text)}")
    if len(text) > LONGEST_NAME:
        raise ValueError(f"a name has more than {LONGEST_NAME:_} characters")
    return text


def graph_of(fields: Fields) -> Graph:
    """The graph of the fields of a file, or of what `nir.NIRGraph.to_dict` returns.

    Graphs inside the graph are opened. The names of their nodes begin with the graph's name and a
    dot.

    Raises
    ------
    ValueError : they are not those of a graph.
    """
    nodes: dict[str, Node] = {}
    # the keys are the edges: some programs write an edge twice, and it is one edge
    edges: dict[tuple[str, str], None] = {}
    _open(fields, "", nodes, edges, 0)
    metadata = fields.get("metadata", {})
    return Graph(nodes, list(edges), metadata if isinstance(metadata, Mapping) else {})


def _open(
    fields: Fields,
    prefix: str,
    nodes: dict[str, Node],
    edges: dict[tuple[str, str], None],
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
        if "type" not in node_fields:
            raise ValueError(f"node {short(name)} has no type")
        kind = _text(node_fields["type"])
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
        edges[ends[edge[0]][1], ends[edge[1]][0]] = None


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
    rows = edges.tolist() if isinstance(edges, np.ndarray) else edges
    if not isinstance(rows, (list, tuple)):
        raise ValueError(f"its edges must be pairs of names, got {short(edges)}")
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
        raise NotImplementedError(
            f"node {short(_in_circle(graph, waits))} is part of a recurrent connection: it reads "
            "its own output, and in one event there is no time for that; simulators in time steps "
            "define it"
        )
    return ordered


def _in_circle(graph: Graph, waits: Mapping[str, int]) -> str:
    """The name of a node that reads its own output, directly or through other nodes.

    Parameters
    ----------
    waits : node -> how many nodes that it reads have not been put in order.
    """
    source_of = {}
    for source, target in graph.edges:
        if waits[source] and waits[target]:
            source_of[target] = source

    # Each node that waits reads another one that waits. So the way back from any of them never
    # ends, and the first node that it meets again is part of a circle.
    name = next(name for name, n in waits.items() if n > 0)
    seen = set()
    while name not in seen:
        seen.add(name)
        name = source_of[name]
    return name
