"""A damaged or foreign .nir file gives a model that runs, or an error of one line that says why.

ASYNC_TNT_FUZZ_CASES makes the random damage a long run: it was 2,000 files and 20,000 graphs once.
"""

import os
import re
import sys
import warnings
from itertools import pairwise

import h5py
import nir
import numpy as np
import pytest
from damage import damaged_bytes
from networks.nir import bad_readers
from networks.nir.damaged_graphs import Fields, damaged_fields
from networks.nir.random_graphs import RandomGraph
from processes import started

from async_tnt import Model, SpikingVolume
from async_tnt.base import hdf5_content
from async_tnt.networks.nir import graph as graph_module

CASES = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", "30"))
SEED = int(os.environ.get("ASYNC_TNT_FUZZ_SEED", "0"))
MEANING = {"reset": "subtract", "dt": 1e-3}


def small_graph() -> nir.NIRGraph:
    """A graph with nodes of many kinds."""
    rng = np.random.default_rng(0)

    def ones(*shape):
        return np.ones(shape, np.float32)

    def weights(*shape):
        return rng.normal(size=shape).astype(np.float32)

    nodes = {
        "input": nir.Input(np.array([2, 6, 6])),
        "conv": nir.Conv2d((6, 6), weights(4, 2, 3, 3), 1, 1, 1, 1, np.zeros(4, np.float32)),
        "if": nir.IF(ones(4, 6, 6), ones(4, 6, 6)),
        "sum": nir.SumPool2d(np.array([2, 2]), np.array([2, 2]), np.array([0, 0])),
        "mean": nir.AvgPool2d(np.array([2, 2]), np.array([1, 1]), np.array([0, 0])),
        "scale": nir.Scale(weights(4, 2, 2)),
        "flatten": nir.Flatten({"input": np.array([4, 2, 2])}, 0, -1),
        "linear": nir.Linear(weights(5, 16)),
        "lif": nir.LIF(ones(5), ones(5), 0 * ones(5), ones(5)),
        "affine": nir.Affine(weights(3, 5), np.zeros(3, np.float32)),
        "li": nir.LI(ones(3), ones(3), 0 * ones(3)),
        "output": nir.Output(np.array([3])),
    }
    names = list(nodes)
    return nir.NIRGraph(nodes, list(pairwise(names)), type_check=False)


def refusal(graph, **meaning):
    """The message of the error that refuses a graph, or None for a model that runs."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            model = Model.from_nir(graph, **{**MEANING, **meaning})
        except (ValueError, NotImplementedError, TypeError) as error:
            message = str(error)
            is_parameter = hasattr(error, "name") and hasattr(error, "rule")
            assert isinstance(error, (ValueError, NotImplementedError)) or is_parameter
            assert not is_parameter or error.name in ("reset", "dt")
            assert message.isprintable() and len(message) < 1200
            return message
        volume = SpikingVolume(model)
        width, height = model.config.sensor
        volume.update(([10, 20, 20], [0, width - 1, 0], [height - 1, 0, 0], [1, 0, 1]))
    assert volume.membranes().shape == model.output_shapes["membranes"]
    return None


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A strange name of a file."""
    return tmp_path_factory.mktemp("damaged") / "a {graph} 100%.nir"


@pytest.fixture
def sound(path):
    """A sound file, opened to be changed."""
    nir.write(path, small_graph())
    with h5py.File(path, "r+") as file:
        yield file


def refusal_of_file(path, **meaning):
    """The same as `refusal`; the message must begin with the path, or name a node or weights."""
    message = refusal(path, **meaning)
    if message is not None and not message.startswith(str(path)):
        assert any(word in message for word in ("node '", "layer '", "`"))
    return message


def test_a_sound_file(path, sound):
    sound.close()
    assert refusal_of_file(path) is None


def test_random_bytes(path, monkeypatch):
    """HDF5 crashes on some of these files, and reads others forever."""
    monkeypatch.setattr(hdf5_content, "LIMIT_S", 4.0)
    nir.write(path, small_graph())
    content = path.read_bytes()
    refused = 0
    for damaged in damaged_bytes(content, CASES, SEED):
        path.write_bytes(damaged)
        refused += refusal_of_file(path) is not None
    assert refused > CASES // 4


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_a_file_cut_short(path, share):
    nir.write(path, small_graph())
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    assert refusal_of_file(path).startswith(f"{path} is not a readable NIR graph: ")


@pytest.mark.parametrize("read", [bad_readers.crash, bad_readers.hang, bad_readers.fill_memory])
def test_a_file_that_crashes_or_hangs_hdf5(path, sound, monkeypatch, read):
    """The worker process ends, and this process says so."""
    sound.close()
    monkeypatch.setattr(hdf5_content, "_content_of", read)
    monkeypatch.setattr(hdf5_content, "LIMIT_S", 5.0)
    message = refusal_of_file(path)
    is_memory = read is bad_readers.fill_memory
    assert ("MemoryError" if is_memory else "process crashed, hung, was killed") in message


def test_no_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        Model.from_nir(tmp_path / "none.nir")


# -- damaged fields --------------------------------------------------------------------------------


def test_random_fields():
    graphs = [small_graph().to_dict()] + [RandomGraph(seed).graph.to_dict() for seed in range(20)]
    rng = np.random.default_rng(SEED)
    refused = 0
    for _ in range(10 * CASES):
        fields = damaged_fields(graphs[rng.integers(len(graphs))], rng)
        refused += refusal(Fields(fields)) is not None
    assert 5 * CASES < refused < 10 * CASES


def changed(node, **fields):
    """The small graph's fields, with other ones of a node. None leaves a field out."""
    graph = small_graph().to_dict()
    changes = graph["nodes"][node]
    for name, value in fields.items():
        if value is None:
            del changes[name]
        else:
            changes[name] = value
    return graph


@pytest.mark.parametrize(
    "node, fields, message",
    [
        ("conv", {"weight": None}, r"node 'conv' \(Conv2d\): it has no field 'weight'"),
        ("conv", {"weight": "x"}, r"'conv' \(Conv2d\): weight must be numbers, got 'x'"),
        ("conv", {"weight": np.ones(3)}, r"weight must be \(F, C, ky, kx\), got \(3,\)"),
        ("conv", {"weight": np.ones((1, 1, 0, 3))}, r"`kernel` must be a list of 2 whole"),
        ("conv", {"weight": np.full((4, 2, 3, 3), np.nan)}, "`conv.weight` must be finite"),
        ("conv", {"stride": np.array([-1, 1])}, r"`stride` must be .* from 1 on, got \[-1, 1\]"),
        ("conv", {"stride": np.array([np.inf, 1])}, r"stride must be 2 whole numbers, got \[inf"),
        ("conv", {"stride": np.array([1, 2, 3])}, r"stride must be 2 whole numbers, got \[1, 2"),
        ("conv", {"stride": 1.5}, "stride must be 2 whole numbers, got 1.5"),
        ("conv", {"groups": np.array(True)}, "groups must be numbers, got "),
        ("conv", {"dilation": 1 << 40}, "`dilation` must be a list of 2 whole numbers"),
        ("conv", {"padding": -1}, r"`padding` must be a list of 4 whole numbers from 0 on, got"),
        ("conv", {"padding": "all"}, "padding must be numbers, 'same' or 'valid', got 'all'"),
        ("conv", {"groups": 3}, "3 groups must divide its 2 channels and 4 filters"),
        ("conv", {"groups": 0}, "`groups` must be a positive whole number, got 0"),
        ("conv", {"groups": 1e300}, "`groups` must be a positive whole number, got 1000"),
        ("conv", {"bias": np.ones(4)}, "its bias must be 0, got up to 1: a constant current"),
        ("sum", {"kernel_size": np.array([9, 9])}, r"layer 'sum' \(sum_pool\): "),
        ("input", {"shape": np.array([2, np.nan, 6])}, r"'input' \(Input\) must be the only one"),
        ("input", {"shape": np.array([2, 6.5, 6])}, r"must be whole numbers, got \(2.0, 6.5, 6.0"),
        ("input", {"shape": np.array([2, 0, 6])}, r"sides of 1 to 32768 pixels, got \(6, 0\)"),
        ("input", {"shape": np.array([2, 1 << 20, 6])}, r"1 to 32768 pixels, got \(6, 1048576\)"),
        ("input", {"shape": np.array([2, 30_000, 30_000])}, "must give at most 268_435_456 cells"),
        ("input", {"shape": np.array([3, 6, 6])}, r"must be the only one.* got \(3, 6, 6\)"),
        (
            "if",
            {"v_threshold": np.ones(3)},
            r"v_threshold must have shape \(4, 6, 6\) here, got \(3,\)",
        ),
        ("if", {"v_threshold": -np.ones(4)}, "v_threshold must be positive"),
        ("lif", {"tau": np.zeros(5)}, "tau must be positive, got 0"),
        ("lif", {"v_reset": np.ones(5)}, "v_reset must be 0 with the reset 'subtract'"),
        ("linear", {"weight": np.ones((5, 17))}, r"must have shape \(5, 16\) here, got \(5, 17\)"),
        ("linear", {"type": "Conv9d"}, r"node 'linear' \(Conv9d\) has no meaning here"),
        ("linear", {"type": None}, "node 'linear' has no type"),
        ("linear", {"type": 3}, "a name must be a text, got 3"),
        ("linear", {"type": b"\xff"}, r"a text must be UTF-8, got b'\\xff'"),
        ("linear", {"type": "x" * 1000}, r"\(xxx.* has no meaning here"),
        ("linear", {"type": "x" * 1001}, "a name has more than 1_000 characters"),
        ("flatten", {"start_dim": 1}, "a Flatten from 1 to -1, not of all axes"),
    ],
)
def test_the_message_names_node_and_value(node, fields, message):
    with pytest.raises((ValueError, NotImplementedError), match=message):
        Model.from_nir(Fields(changed(node, **fields)), **MEANING)


def with_edges(*edges, left_out=()):
    graph = small_graph().to_dict()
    graph["edges"] = [edge for edge in graph["edges"] if edge not in left_out] + list(edges)
    return graph


@pytest.mark.parametrize(
    "edges, left_out, message",
    [
        ([("if", "conv")], (), "node '(if|conv)' is part of a recurrent connection"),
        ([("lif", "lif")], (), "node 'lif' is part of a recurrent connection"),
        ([("conv", "nowhere")], (), "an edge joins .'conv', 'nowhere'., and one of them is no"),
        ([("conv",)], (), r"an edge must be a pair of names, got \('conv',\)"),
        ([("conv", 3)], (), "a name must be a text, got 3"),
        ([], [("conv", "if")], r"node 'if' \(IF\): it reads no other node"),
        ([], [("li", "output")], r"node 'output' \(Output\): it reads no other node"),
        ([("conv", "linear")], (), r"layer 'linear\+' \(add\)"),
    ],
)
def test_edges(edges, left_out, message):
    graph = with_edges(*edges, left_out=left_out)
    with pytest.raises((ValueError, NotImplementedError), match=message):
        Model.from_nir(Fields(graph), **MEANING)


def test_the_node_that_is_named_lies_in_the_circle():
    """`lif` and `back` read each other; the nodes before and behind them are in no circle."""
    graph = with_edges(("lif", "back"), ("back", "lif"))
    nodes = {**graph["nodes"], "back": graph["nodes"]["scale"]}
    for names in (list(nodes), list(reversed(nodes))):
        graph["nodes"] = {name: nodes[name] for name in names}
        with pytest.raises(NotImplementedError, match=r"node '(lif|back)' is part of a recurrent"):
            Model.from_nir(Fields(graph), **MEANING)


def test_the_circle_of_a_published_network(data):
    path = data / "nir" / "braille_noDelay_noBias_subtract.nir"
    with pytest.raises(NotImplementedError, match=r"node 'lif1\.(lif|w_rec)' is part of a rec"):
        Model.from_nir(path, **MEANING)


def test_an_edge_written_twice_is_one():
    assert refusal(Fields(with_edges(("conv", "if"), ("conv", "if")))) is None


@pytest.mark.parametrize("deep, is_read", [(3, True), (8, True), (9, False)])
def test_graphs_in_graphs(deep, is_read):
    graph = small_graph().to_dict()
    for _ in range(deep):
        ends = {
            "in": {"type": "Input", "shape": np.array([2, 6, 6])},
            "out": {"type": "Output", "shape": np.array([3])},
        }
        edges = [("in", "graph"), ("graph", "out")]
        graph = {"type": "NIRGraph", "nodes": {**ends, "graph": graph}, "edges": edges}
    message = refusal(Fields(graph))
    assert message is None if is_read else "graphs lie in graphs more than 8 deep" in message


@pytest.mark.parametrize("kind, n", [("Input", 2), ("Output", 0)])
def test_a_graph_in_a_graph_has_one_way_in_and_one_out(kind, n):
    """The outer graph's edges name the inner graph, and not its nodes."""
    inner = small_graph().to_dict()
    if n:
        inner["nodes"]["second"] = inner["nodes"]["input"]
    else:
        del inner["nodes"]["output"]
        inner["edges"] = [edge for edge in inner["edges"] if "output" not in edge]
    outer = {"type": "NIRGraph", "nodes": {"graph": inner}, "edges": []}
    assert f"the graph 'graph' must have one {kind}, got {n}" in refusal(Fields(outer))


def test_the_most_nodes_of_a_graph(monkeypatch):
    n_nodes = len(small_graph().nodes)
    monkeypatch.setattr(graph_module, "MOST_NODES", n_nodes)
    assert refusal(small_graph()) is None
    monkeypatch.setattr(graph_module, "MOST_NODES", n_nodes - 1)
    assert f"it has more than {n_nodes - 1} nodes" in refusal(small_graph())


def test_two_nodes_of_one_name():
    graph = small_graph().to_dict()
    graph["nodes"]["a"] = small_graph().to_dict()
    graph["nodes"]["a.conv"] = graph["nodes"]["conv"]
    assert "two nodes have the name 'a.conv'" in refusal(Fields(graph))


def test_a_million_edges_and_the_most_of_them():
    graph = small_graph().to_dict()
    edges = graph["edges"]
    graph["edges"] = edges + [("conv", "if")] * 10**6
    assert "it has more than 100_000 edges" in refusal(Fields(graph))
    graph["edges"] = edges + [("conv", "if")] * (100_000 - len(edges))
    assert refusal(Fields(graph)) is None


def test_names_of_any_kind():
    for name in ("a\nb", "\udc80", "volume", "if+", "", "x" * 5000, "é" * 900):
        graph = small_graph().to_dict()
        graph["nodes"][name] = graph["nodes"].pop("linear")
        graph["edges"] = [
            tuple(name if end == "linear" else end for end in edge) for edge in graph["edges"]
        ]
        refusal(Fields(graph))


# -- HDF5 files with other things than data --------------------------------------------------------


def soft_link(file):
    file["node/nodes/x"] = h5py.SoftLink("/node/nodes/conv")


def external_link(file):
    del file["node/nodes/conv"]
    file["node/nodes/conv"] = h5py.ExternalLink("/etc/passwd", "/")


def the_graph_is_a_link(file):
    file.move("node", "other")
    file["node"] = h5py.SoftLink("/other")


def virtual_set(file):
    layout = h5py.VirtualLayout((5, 16), "f4")
    layout[:] = h5py.VirtualSource("other.h5", "node/nodes/scale/scale", (5, 16))
    del file["node/nodes/linear/weight"]
    file["node/nodes/linear"].create_virtual_dataset("weight", layout)


def external_storage(file):
    replaced(file, shape=(5, 16), dtype="f4", external=[(__file__, 0, h5py.h5f.UNLIMITED)])


def replaced(file, **how):
    """Another data set of the dense layer's weights."""
    del file["node/nodes/linear/weight"]
    return file["node/nodes/linear"].create_dataset("weight", **how)


def declared(file):
    replaced(file, shape=(10**6, 10**6), dtype="f4", fillvalue=1.0)


def declared_in_chunks(file):
    replaced(file, shape=(10**6, 10**6), dtype="f4", fillvalue=1.0, chunks=(100, 100))


def large_chunk(file):
    sides = (30_000, 30_000)
    replaced(file, shape=(5, 16), maxshape=(None, None), dtype="f4", chunks=sides)


def gzip_bomb(file):
    zeros = replaced(file, shape=(1 << 28,), dtype="u1", compression="gzip", chunks=(1 << 24,))
    zeros[: 1 << 24] = 0


def long_text(file):
    del file["node/nodes/linear/type"]
    file["node/nodes/linear"].create_dataset("type", data="x" * 10**8, dtype=h5py.string_dtype())


def long_texts(file):
    texts = ["x" * 10**7] * 20
    del file["node/edges"]
    file["node"].create_dataset("edges", data=texts, dtype=h5py.string_dtype())


def many_edges(file):
    del file["node/edges"]
    file["node"].create_dataset("edges", (10**6, 2), dtype=h5py.string_dtype())


def a_group_in_itself(file):
    for name in "abcdef":
        file[f"node/nodes/conv/{name}"] = file["node/nodes"]


def empty_set(file):
    replaced(file, data=h5py.Empty("f4"))


def texts(file):
    replaced(file, data=["a", "b"])


def complex_numbers(file):
    replaced(file, data=np.ones((5, 16), complex))


def records(file):
    replaced(file, data=np.zeros((5, 16), [("a", "f4"), ("b", "i4")]))


def references(file):
    replaced(file, shape=(5, 16), dtype=h5py.ref_dtype)


def lists_of_any_length(file):
    replaced(file, shape=(5, 16), dtype=h5py.vlen_dtype("f4"))


def named_type(file):
    file["node/nodes/linear/t"] = np.dtype("f4")


def set_instead_of_a_node(file):
    del file["node/nodes/conv"]
    file["node/nodes/conv"] = np.ones(3)


def set_instead_of_a_graph(file):
    del file["node"]
    file["node"] = np.ones(3)


def no_graph(file):
    del file["node"]


def no_edges(file):
    del file["node/edges"]


def numbers_as_edges(file):
    del file["node/edges"]
    file["node/edges"] = np.ones((3, 2))


@pytest.mark.parametrize(
    "change, message",
    [
        (soft_link, "'x' is a link to somewhere else"),
        (external_link, "'conv' is a link to somewhere else"),
        (the_graph_is_a_link, "'node' is a link to somewhere else"),
        (virtual_set, "'weight' lies in another file"),
        (external_storage, "'weight' lies in another file"),
        (declared, "with 'weight' it has 1_000_000_000_"),
        (declared_in_chunks, "with 'weight' it has 1_000_000_000_"),
        (large_chunk, "with 'weight' it has 900_000_"),
        (gzip_bomb, "with 'weight' it has 268_4"),
        (long_text, "with 'type' its texts have more than 16_777_216 bytes"),
        (long_texts, "with 'edges' its texts have more than 16_777_216 bytes"),
        (many_edges, "with 'edges' it has more than 524_288 texts"),
        (a_group_in_itself, "more than 100_000 groups and data sets|more than 32 deep"),
        (empty_set, "'weight' is empty"),
        (texts, "weight must be numbers, got "),
        (complex_numbers, "weight must be numbers, got "),
        (records, "weight must be numbers, got "),
        (references, "'weight' must hold numbers or texts, got object"),
        (lists_of_any_length, "'weight' must hold numbers or texts, got object"),
        (named_type, "'t' is neither a group nor a data set"),
        (set_instead_of_a_node, "node 'conv' has no fields"),
        (set_instead_of_a_graph, "it has no group 'node'"),
        (no_graph, "it has no group 'node'"),
        (no_edges, r"node 'affine' \(Affine\): it reads no other node"),
        (numbers_as_edges, "a name must be a text, got 1.0"),
    ],
)
def test_other_content(path, sound, change, message):
    change(sound)
    sound.close()
    assert re.search(message, refusal_of_file(path))


def test_attributes_and_metadata_of_any_kind(path, sound):
    for k in range(2000):
        sound["node/nodes/conv"].attrs[f"a{k}"] = k
    metadata = sound["node/nodes/linear"].create_group("metadata")
    metadata["text"] = "x" * 5000
    metadata["type"] = "NIRGraph"
    metadata["bytes"] = np.array([b"\xff", b"a"])
    metadata["records"] = np.zeros(3, [("a", "f4")])
    metadata["flags"] = np.array([True, False])
    metadata["nodes/deeper/a"] = 1.0
    sound["node/metadata/x"] = np.nan
    sound.close()
    assert refusal_of_file(path) is None


MEMORY = """
import resource, sys
from async_tnt import Model
import async_tnt.networks.nir.from_nir, h5py
def peak(who):
    return resource.getrusage(who).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
before = peak(resource.RUSAGE_SELF)
try:
    Model.from_nir(sys.argv[1], reset="subtract", dt=1e-3)
except ValueError:
    pass
print(peak(resource.RUSAGE_SELF) - before, peak(resource.RUSAGE_CHILDREN))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no module resource")
@pytest.mark.parametrize(
    "change", [declared, large_chunk, gzip_bomb, long_text, long_texts, many_edges]
)
def test_memory(path, sound, change):
    """What a file asks for is refused before it is there."""
    change(sound)
    sound.close()
    with started("-c", MEMORY, path) as process:
        out, error = process.communicate(timeout=60)
    assert error == ""
    grown, in_worker = map(int, out.split())
    assert grown < 150e6
    assert in_worker < 700e6
