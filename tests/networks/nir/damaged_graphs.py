"""Fields of NIR graphs with random damage."""

import copy

import numpy as np


class Fields:
    """Fields in the place of a `nir.NIRGraph`, whose own classes refuse some of them."""

    def __init__(self, fields):
        self.fields = fields

    def to_dict(self):
        return self.fields


VALUES = (
    *(np.array(n) for n in (0, -1, 2, 1 << 40, np.nan, np.inf, -np.inf, 0.5, 1e300, 1e-300, 1j)),
    *(0, -3, True, 1.5, float("nan"), 10**400, None, "same", "x" * 5000, b"\xff\xfe", "a\nb"),
    *(np.zeros(0), np.zeros((0, 1 << 50)), np.zeros((2, 2)), np.array(["a", "b"])),
    *(np.array([1, 1 << 62]), np.array([-1, 1]), np.array([1e38, np.nan]), np.array([1, 2, 3])),
    *([], [1, [2, 3]], {}, {"type": "IF"}, np.array(b"IF"), np.array([True, False])),
    *(np.full(3, 1e308), np.full((4, 6, 6), 3e38), np.full((5, 16), -3e38), np.full(5, 1e-45)),
    *(np.float16(1), np.zeros(2, "datetime64[s]"), np.zeros(2, [("a", "f4")]), np.array([2, 1, 1])),
    *(np.array([2, 1 << 20, 1 << 20]), np.array([2, 20_000, 20_000]), np.array([1, 6, 6])),
)
"""Values of many kinds, which a field may have in the place of its own."""


def damaged_fields(fields, rng):
    """A copy of a graph's fields with one to three changes."""
    fields = copy.deepcopy(fields)
    for _ in range(rng.integers(1, 4)):
        nodes = fields.get("nodes")
        if not isinstance(nodes, dict) or not nodes:
            return fields
        how = rng.integers(8)
        names = list(nodes)
        node = nodes[names[rng.integers(len(names))]]
        value = copy.deepcopy(VALUES[rng.integers(len(VALUES))])
        if how <= 2 and isinstance(node, dict) and node:
            node[list(node)[rng.integers(len(node))]] = value
        elif how == 3 and isinstance(node, dict) and node:
            del node[list(node)[rng.integers(len(node))]]
        elif how == 4 and isinstance(node, dict):
            other = nodes[names[rng.integers(len(names))]]
            if isinstance(other, dict):
                node.update(
                    copy.deepcopy(other) if rng.integers(2) else {"type": other.get("type")}
                )
        elif how == 5 and isinstance(fields["edges"], list):
            pair = tuple(names[k] for k in rng.integers(0, len(names), 2))
            fields["edges"].insert(rng.integers(len(fields["edges"]) + 1), pair)
        elif how == 6 and isinstance(fields["edges"], list) and fields["edges"]:
            fields["edges"].pop(rng.integers(len(fields["edges"])))
        elif how == 7:
            place = rng.integers(4)
            if place == 0:
                fields[["nodes", "edges", "type", "metadata"][rng.integers(4)]] = value
            elif place == 1:
                nodes[names[rng.integers(len(names))]] = value
            elif place == 2:
                nodes["graph"] = copy.deepcopy(fields)
            elif isinstance(fields["edges"], list):
                fields["edges"].append([value, ("input", "nowhere"), "ab", (1, 2)][rng.integers(4)])
    return fields
