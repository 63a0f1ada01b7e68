"""What NIR graphs become, and what a graph leaves open."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from networks.modules import EVEN_KERNEL
from torch.nn import functional as F

nir = pytest.importorskip("nir", reason="needs the extra `nir`")

from async_tnt import Model, SpikingVolume, load_model  # noqa: E402
from async_tnt.cli import main  # noqa: E402
from async_tnt.networks import to_nir  # noqa: E402

SHARED = Path(os.environ.get("TNT_DATA", Path(__file__).parents[4] / "shared" / "data")) / "nir"
ONES = np.ones(2)


def graph_of(*nodes, sides=(2, 3, 4)):
    n_out = 2
    return nir.NIRGraph.from_list(
        nir.Input({"input": np.array(sides)}),
        *nodes,
        nir.Output({"output": np.array([n_out])}),
        type_check=False,
    )


def dense(*nodes, bias=None):
    """A graph of a dense layer and these neurons."""
    weight = np.arange(48.0).reshape(2, 24) / 10
    linear = nir.Linear(weight) if bias is None else nir.Affine(weight, bias)
    flatten = nir.Flatten({"input": np.array([2, 3, 4])}, start_dim=0, end_dim=-1)
    return graph_of(flatten, linear, *nodes)


IF = nir.IF(r=ONES, v_threshold=ONES)
LIF = nir.LIF(tau=ONES, r=ONES, v_leak=0 * ONES, v_threshold=ONES)


@pytest.mark.parametrize(
    "graph, settings, message",
    [
        (dense(IF), {}, "`reset` must be subtract or value: NIR leaves open how a neuron is reset"),
        (
            dense(LIF),
            {"reset": "value"},
            "`dt` is missing: a leaky neuron's input counts r dt",
        ),
        (dense(IF), {"reset": "zero"}, "`reset` must be subtract or value, got 'zero'"),
        *(
            (dense(LIF), {"reset": "value", "dt": dt}, f"`dt` must be a positive number, got {dt}")
            for dt in (-1, 0, True, np.inf)
        ),
        (
            dense(IF),
            {"reset": "value", "polarity": "on"},
            "`polarity` must be off_first or on_f",
        ),
        (dense(IF), {"reset": "value", "classes": ["a"]}, "the network must compute 1 logits, one"),
        (3, {}, "`graph` must be the path of a .nir file, or a nir.NIRGraph, got int"),
    ],
)
def test_what_a_graph_leaves_open_is_asked_for(graph, settings, message):
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}"):
        Model.from_nir(graph, **settings)


CURRENT = {"tau_mem": ONES, "tau_syn": ONES, "r": ONES, "v_leak": 0 * ONES, "w_in": ONES}


@pytest.mark.parametrize(
    "neurons, needed",
    [
        (IF, {"reset"}),
        (LIF, {"reset", "dt"}),
        (nir.CubaLIF(**CURRENT, v_threshold=ONES), {"reset", "dt"}),
        (nir.LI(tau=ONES, r=ONES, v_leak=0 * ONES), {"dt"}),
        (nir.CubaLI(**CURRENT), {"dt"}),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_graph_leaves_open_what_its_kinds_of_neurons_need(neurons, needed):
    everything = {"reset": "value", "dt": 1e-3}
    for name in everything:
        others = {other: value for other, value in everything.items() if other != name}
        if name in needed:
            with pytest.raises(TypeError, match=f"^`{name}` "):
                Model.from_nir(dense(neurons), **others)
        else:
            assert Model.from_nir(dense(neurons), **others).is_spiking


@pytest.mark.parametrize("graph", [dense(IF), to_nir(load_model("digits"))], ids=["IF", "ReLU"])
def test_a_second_input_is_refused(graph):
    (first,) = [node for node in graph.nodes.values() if isinstance(node, nir.Input)]
    (reader,) = [target for source, target in graph.edges if source == "input"]
    nodes = {**graph.nodes, "second": nir.Input(first.input_type)}
    edges = [*graph.edges, ("second", reader)]
    two = nir.NIRGraph(nodes, edges, metadata=graph.metadata, type_check=False)
    reset = None if "activation" in graph.metadata else "subtract"
    with pytest.raises(NotImplementedError, match=r"'second' \(Input\) must be the only one"):
        Model.from_nir(two, reset=reset)


def test_all_nodes_without_a_meaning_are_named_and_what_does_not_fit_behind_them_is_not():
    graph = dense(nir.Delay(ONES), nir.I(ONES), IF)
    with pytest.raises(NotImplementedError) as raised:
        Model.from_nir(graph, reset="subtract")
    delay, current = str(raised.value).split("; ")[:2]
    assert "(Delay) has no meaning here" in delay
    assert "(I) has no meaning here" in current

    line = nir.Conv1d(4, np.ones((1, 2, 3)), 1, 0, 1, 1, np.zeros(1))
    with pytest.raises(NotImplementedError, match=r"\(Delay\) has no meaning here"):
        Model.from_nir(graph_of(nir.Delay(ONES), line, IF), reset="subtract")


def test_nodes_that_the_output_does_not_need_are_left_out():
    graph = dense(IF)
    expected = Model.from_nir(graph, reset="subtract")
    unread = {"unread": nir.Scale(np.ones((2, 3, 4)))}
    edges = [*graph.edges, ("input", "unread")]
    larger = nir.NIRGraph({**graph.nodes, **unread}, edges, type_check=False)
    model = Model.from_nir(larger, reset="subtract")
    assert model.network == expected.network
    assert model.weights.keys() == expected.weights.keys()


@pytest.mark.parametrize(
    "graph, message",
    [
        (dense(nir.Delay(ONES), IF), "(Delay) has no meaning here"),
        (dense(nir.I(ONES), IF), "(I) has no meaning here"),
        (dense(), "the graph's last node must be of neurons (IF, LIF, CubaLIF, LI or CubaLI)"),
        (graph_of(IF, sides=(3, 4)), "must be the only one, with a shape (1 or 2, H, W)"),
        (graph_of(IF, sides=(3, 4, 4)), "must be the only one, with a shape (1 or 2, H, W)"),
    ],
)
def test_a_graph_without_a_meaning_at_an_event_is_refused(graph, message):
    with pytest.raises(NotImplementedError, match=re.escape(message)):
        Model.from_nir(graph, reset="subtract")


def test_a_bias_is_refused_where_it_is_not_zero():
    model = Model.from_nir(dense(IF, bias=0 * ONES), reset="subtract")
    assert not any("bias" in name for name in model.weights)
    message = "(dense): its bias must be 0, got up to 0.5: a constant current has no meaning at an"
    with pytest.raises(ValueError, match=re.escape(message)):
        Model.from_nir(dense(IF, bias=np.array([0.0, 0.5])), reset="subtract")


def test_a_model_of_a_graph_has_the_window_and_the_record_that_are_given():
    model = Model.from_nir(dense(IF), reset="subtract", window_us=7_000, record={"a": 1})
    assert (model.config.window_us, model.record) == (7_000, {"a": 1})
    plain = Model.from_nir(dense(IF), reset="subtract")
    assert (plain.config.window_us, plain.record) == (105_000, {})
    with pytest.raises(ValueError, match=r"`window_us` must be in \[1, 3600000000\], got 0"):
        Model.from_nir(dense(IF), reset="subtract", window_us=0)


@pytest.mark.parametrize("polarity, first", [("off_first", 0), ("on_first", 1)])
def test_the_order_of_polarities(polarity, first):
    """An event of channel 0 at (x 1, y 2) is number 9 of the input, one of channel 1 number 21."""
    graph = dense(nir.IF(r=ONES, v_threshold=np.full(2, 99.0)))
    volume = SpikingVolume(Model.from_nir(graph, reset="subtract", polarity=polarity))
    volume.open(0)
    volume.update_one(5, 1, 2, first)
    np.testing.assert_allclose(volume.membranes(), [0.9, 3.3], rtol=1e-6)
    volume.update_one(6, 1, 2, 1 - first)
    np.testing.assert_allclose(volume.membranes(), [0.9 + 2.1, 3.3 + 4.5], rtol=1e-6)


def test_an_input_of_one_channel_takes_both_polarities_alike():
    weight = np.arange(24.0).reshape(2, 12)
    flatten = nir.Flatten({"input": np.array([1, 3, 4])}, start_dim=0, end_dim=-1)
    neurons = nir.IF(r=ONES, v_threshold=np.full(2, 999.0))
    graph = graph_of(flatten, nir.Linear(weight), neurons, sides=(1, 3, 4))
    volume = SpikingVolume(Model.from_nir(graph, reset="subtract"))
    volume.open(0)
    for t, p in ((1, 0), (2, 1), (3, 1)):
        volume.update_one(t, 1, 2, p)
    assert volume.membranes().tolist() == [27.0, 63.0]


def test_two_paths_are_added():
    sides = {"input": np.array([2, 2, 2])}
    nodes = {
        "input": nir.Input(sides),
        "flat": nir.Flatten(sides, start_dim=0, end_dim=-1),
        "a": nir.Linear(np.ones((2, 8))),
        "b": nir.Linear(np.array([[0.5] * 8, [0.25] * 8])),
        "out": nir.IF(r=ONES, v_threshold=np.full(2, 9.0)),
        "output": nir.Output({"output": np.array([2])}),
    }
    edges = [("input", "flat"), ("flat", "a"), ("flat", "b"), ("a", "out"), ("b", "out")]
    graph = nir.NIRGraph(nodes, [*edges, ("out", "output")], type_check=False)
    volume = SpikingVolume(Model.from_nir(graph, reset="subtract"))
    volume.open(0)
    volume.update_one(5, 1, 1, 0)
    assert volume.membranes().tolist() == [1.5, 1.25]


def test_the_sensor_of_a_file_is_checked():
    flatten = nir.Flatten({"input": np.array([2, 0, 2])}, start_dim=0, end_dim=-1)
    graph = graph_of(flatten, nir.Linear(np.ones((2, 4))), IF, sides=(2, 0, 2))
    with pytest.raises(ValueError, match=r"its shape \(2, 0, 2\): .* must have sides of 1 to"):
        Model.from_nir(graph, reset="subtract")


def impulse_of(graph, pixel, channel):
    """Membranes after one event, at an x of a line of pixels."""
    model = Model.from_nir(graph, reset="subtract", polarity="off_first")
    assert model.config.sensor[1] == 1
    volume = SpikingVolume(model)
    volume.open(0)
    volume.update_one(5, pixel, 0, channel)
    return volume.membranes()


@pytest.mark.parametrize("padding", [0, 2, "same", "valid"])
@pytest.mark.parametrize("stride, dilation, groups", [(1, 1, 1), (2, 1, 2), (1, 2, 1), (3, 2, 2)])
def test_a_convolution_along_a_line(padding, stride, dilation, groups):
    if padding == "same":
        stride = 1  # torch has no other
    rng = np.random.default_rng(5)
    weight = rng.normal(size=(4, 2 // groups, 3)).astype(np.float32)
    layer = torch.nn.Conv1d(2, 4, 3, stride, padding, dilation=dilation, groups=groups, bias=False)
    layer.weight.data[:] = torch.from_numpy(weight)
    for pixel, channel in ((0, 0), (4, 1), (8, 0)):
        events = torch.zeros(1, 2, 9)
        events[0, channel, pixel] = 1.0
        expected = layer(events)[0].detach().numpy()
        high = np.full(expected.shape, 99.0)  # no neuron fires
        graph = graph_of(
            nir.Conv1d(9, weight, stride, padding, dilation, groups, np.zeros(4)),
            nir.IF(r=np.ones(expected.shape), v_threshold=high),
            sides=(2, 9),
        )
        np.testing.assert_array_equal(impulse_of(graph, pixel, channel)[:, 0, :], expected)


def membranes_of(node, side=1):
    """Membranes after an ON event at (2, 3) of 5x6 pixels, and what torch has as its map."""
    graph = graph_of(
        node, nir.IF(r=np.ones(side), v_threshold=np.full(side, 99.0)), sides=(2, 6, 5)
    )
    volume = SpikingVolume(Model.from_nir(graph, reset="subtract", polarity="on_first"))
    volume.open(0)
    volume.update_one(5, 2, 3, 1)
    events = torch.zeros(1, 2, 6, 5)
    events[0, 0, 3, 2] = 1.0
    return volume.membranes(), events


@EVEN_KERNEL
def test_the_padding_same_of_an_even_kernel_is_longer_at_the_end():
    """As in torch. Such a graph is written as it was read."""
    weight = np.arange(1.0, 17.0, dtype=np.float32).reshape(1, 2, 2, 4)
    node = nir.Conv2d((6, 5), weight, 1, "same", 1, 1, np.zeros(1))
    membranes, events = membranes_of(node)
    expected = F.conv2d(events, torch.tensor(weight), padding="same")[0]
    np.testing.assert_array_equal(membranes, expected.numpy())
    model = Model.from_nir(
        graph_of(node, nir.IF(ONES[:1], ONES[:1]), sides=(2, 6, 5)), reset="value"
    )
    (again,) = [one for one in to_nir(model).nodes.values() if isinstance(one, nir.Conv2d)]
    assert again.padding == "same"

    line = nir.Conv1d(9, weight[:, :, 0], 1, "same", 1, 1, np.zeros(1))
    events = torch.zeros(1, 2, 9)
    events[0, 0, 4] = 1.0
    expected = F.conv1d(events, torch.tensor(weight[:, :, 0]), padding="same")[0]
    neurons = nir.IF(ONES[:1], 99 * ONES[:1])
    found = impulse_of(graph_of(line, neurons, sides=(2, 9)), 4, 0)
    np.testing.assert_array_equal(found[:, 0], expected.numpy())


@pytest.mark.parametrize("kind, divisor", [("SumPool2d", 1), ("AvgPool2d", None)])
def test_the_padding_of_a_pool_has_rows_and_columns(kind, divisor):
    node = getattr(nir, kind)(np.array([4, 2]), np.array([2, 1]), np.array([2, 0]))
    membranes, events = membranes_of(node, 2)
    expected = F.avg_pool2d(events, (4, 2), (2, 1), (2, 0), divisor_override=divisor)[0]
    np.testing.assert_array_equal(membranes, expected.numpy())


@pytest.mark.parametrize("end, sides", [(2, (2, 3, 4)), (1, (2, 12)), (0, (24,))])
def test_a_flatten_may_name_its_last_axis(end, sides):
    def graph(last_axis):
        flatten = nir.Flatten({"input": np.array(sides)}, 0, last_axis)
        return graph_of(flatten, nir.Linear(np.ones((2, 24))), IF, sides=sides)

    model = Model.from_nir(graph(end), reset="value")
    assert model.network == Model.from_nir(graph(-1), reset="value").network
    for other in {0, 1, 2, 3} - {end}:
        with pytest.raises(NotImplementedError, match=f"a Flatten from 0 to {other}, not of all"):
            Model.from_nir(graph(other), reset="value")


def test_an_input_without_polarity():
    """Both polarities of a pixel add 1 to the same number."""
    weight = np.array([[1.0, 2.0, 4.0], [8.0, 16.0, 32.0]])
    neurons = nir.IF(r=ONES, v_threshold=np.full(2, 99.0))
    for channel in (0, 1):
        graph = graph_of(nir.Linear(weight), neurons, sides=(3,))
        assert impulse_of(graph, 2, channel).tolist() == [4.0, 32.0]


def test_neurons_of_single_pixels():
    """Without a dense layer before them, neurons of a vector are those of its pixels."""
    weight = np.array([[1.0, 2.0, 4.0], [8.0, 16.0, 32.0]])
    gains = np.array([2.0, 3.0, 5.0])
    pixels = nir.IF(r=gains, v_threshold=np.full(3, 99.0))
    assert impulse_of(graph_of(pixels, sides=(3,)), 1, 0).tolist() == [0.0, 3.0, 0.0]
    named = Model.from_nir(graph_of(pixels, sides=(3,)), classes=["a", "b", "c"], reset="subtract")
    assert named.logits_shape == (3,)
    one_gain = nir.LIF(np.ones(1), np.ones(1), np.zeros(1), np.ones(1))
    alike = Model.from_nir(graph_of(one_gain, sides=(3,)), reset="subtract", dt=1e-3)
    assert alike.output_shapes["membranes"] == (3,)
    fires = nir.IF(r=gains, v_threshold=np.array([9.0, 2.0, 9.0]))
    last = nir.IF(r=ONES, v_threshold=np.full(2, 99.0))
    for between in ([], [nir.Flatten({"input": np.array([3])}, 0, 0)]):
        graph = graph_of(fires, *between, nir.Linear(weight), last, sides=(3,))
        assert impulse_of(graph, 1, 0).tolist() == [2.0, 16.0]
    assert impulse_of(graph, 2, 0).tolist() == [0.0, 0.0]


def test_values_of_single_pixels_are_added():
    nodes = {
        "input": nir.Input({"input": np.array([3])}),
        "scale": nir.Scale(np.array([1.0, 10.0, 100.0])),
        "out": nir.IF(r=np.ones(3), v_threshold=np.full(3, 99.0)),
        "output": nir.Output({"output": np.array([3])}),
    }
    edges = [("input", "scale"), ("scale", "out"), ("input", "out"), ("out", "output")]
    graph = nir.NIRGraph(nodes, edges, type_check=False)
    assert impulse_of(graph, 1, 0).tolist() == [0.0, 10.0 + 1.0, 0.0]


@pytest.mark.parametrize(
    "node, sides, message",
    [
        (
            nir.Conv1d(4, np.ones((1, 2, 3)), 1, 0, 1, 1, np.zeros(1)),
            (2, 3, 4),
            "(Conv1d): it needs a graph whose input has a shape (1 or 2, W)",
        ),
        (
            nir.Conv2d((1, 4), np.ones((1, 2, 1, 3)), 1, 0, 1, 1, np.zeros(1)),
            (2, 4),
            "(Conv2d): it needs a graph whose input has a shape (1 or 2, H, W)",
        ),
        (
            nir.SumPool2d(np.array([1, 2]), np.array([1, 2]), np.array([0, 0])),
            (2, 4),
            "(SumPool2d): it needs a graph whose input has a shape (1 or 2, H, W)",
        ),
        (
            nir.Conv1d(4, np.ones((1, 1, 3)), 1, 0, 1, 1, np.zeros(1)),
            (4,),
            "(Conv1d): it needs a graph whose input has a shape (1 or 2, W)",
        ),
    ],
)
def test_lines_and_maps_do_not_mix(node, sides, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        Model.from_nir(graph_of(node, IF, sides=sides), reset="subtract")


@pytest.mark.parametrize(
    "graph, error, message",
    [
        (dense(nir.Delay(ONES), IF), NotImplementedError, "(Delay) has no meaning here"),
        (dense(IF, bias=ONES), ValueError, "layer 'affine' (dense): its bias must be 0"),
    ],
)
def test_a_refusal_names_the_file(graph, error, message, tmp_path):
    path = tmp_path / "net.nir"
    nir.write(path, graph)
    with pytest.raises(error, match=f"^{re.escape(str(path))}: .*{re.escape(message)}"):
        Model.from_nir(path, reset="subtract")


def test_the_published_graph_of_n_mnist():
    path = SHARED / "cnn_sinabs.nir"
    if not path.exists():
        pytest.skip("no shared data: set TNT_DATA")
    model = load_model(path, reset="subtract", window_us=350_000)
    ops = [layer["op"] for layer in model.layers]
    expected = "pick conv if conv if sum_pool conv if sum_pool flatten dense if dense if"
    assert ops == expected.split() and model.n_neurons == 8_970
    assert model.config.sensor == (34, 34)


def test_a_recurrent_graph_names_a_node_of_the_circle():
    path = SHARED / "braille_noDelay_noBias_subtract.nir"
    if not path.exists():
        pytest.skip("no shared data: set TNT_DATA")
    with pytest.raises(NotImplementedError, match=r"'lif1\.lif' is part of a recurrent connection"):
        Model.from_nir(path, reset="subtract", dt=1e-4)


def test_a_command_tells_a_graph_that_cannot_run_in_one_line(tmp_path, capsys):
    """What this release cannot do is an error of the file, and not of the program."""
    circle = nir.NIRGraph(
        {
            "input": nir.Input({"input": np.array([2, 3, 4])}),
            "flat": nir.Flatten({"input": np.array([2, 3, 4])}, 0, -1),
            "fc": nir.Linear(np.ones((24, 24), np.float32)),
            "neurons": nir.IF(np.ones(24), np.ones(24)),
            "output": nir.Output({"output": np.array([24])}),
        },
        [
            ("input", "flat"),
            ("flat", "fc"),
            ("fc", "neurons"),
            ("neurons", "fc"),
            ("neurons", "output"),
        ],
    )
    nir.write(tmp_path / "circle.nir", circle)
    out = tmp_path / "net.safetensors"
    arguments = ["export", str(tmp_path / "circle.nir"), "--reset", "subtract", "--out", str(out)]
    assert main(arguments) == 2 and not out.exists()
    (line,) = capsys.readouterr().err.splitlines()
    assert "is part of a recurrent connection" in line


def test_parameters_for_graphs_are_refused_for_other_files(tmp_path):
    with pytest.raises(TypeError, match=r"`reset` is for \.nir graphs, got"):
        load_model("digits", reset="value")
    nir.write(tmp_path / "net.nir", dense(IF))
    with pytest.raises(TypeError, match=r"`config` is for \.onnx networks"):
        load_model(tmp_path / "net.nir", config=Model.from_nir(dense(IF), reset="value").config)
