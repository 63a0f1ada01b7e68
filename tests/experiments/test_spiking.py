"""Spiking networks beside simulators: what is compared, what counts as a difference, and bins."""

from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np
import pytest

from async_tnt import EVENT_DTYPE, Model

torch = pytest.importorskip("torch", reason="simulators need torch")
nir = pytest.importorskip("nir", reason="graphs are read by nir (extra `nir`)")

from experiments.digit_data.recordings import CLASSES  # noqa: E402
from experiments.spiking_networks import simulators as S  # noqa: E402
from experiments.spiking_networks.agreement import compare  # noqa: E402
from experiments.spiking_networks.bins import binned_accuracy, step_of_events  # noqa: E402
from experiments.spiking_networks.graphs import (  # noqa: E402
    SENSOR,
    random_paper_graph,
    random_small_graph,
    stages_of,
)
from experiments.spiking_networks.recordings import Recording, decided  # noqa: E402
from experiments.spiking_networks.work import Operations, fan_out  # noqa: E402
from experiments.tables import spiking as tables  # noqa: E402
from experiments.tables.parts import results  # noqa: E402

STEP_S = 1e-4


class PlainNeurons:
    """Integrating neurons, in three lines of torch.

    Parameters
    ----------
    at_threshold : whether a membrane at its threshold fires, as in sinabs.
    late : the number of steps before which neurons never fire.
    """

    def __init__(self, node, *, at_threshold=False, late=0):
        self.threshold = torch.from_numpy(np.array(node.v_threshold, np.float64))
        self.at_threshold = at_threshold
        self.late = late

    def reset(self):
        self.membrane = torch.zeros_like(self.threshold)
        self.n_steps = 0

    def step(self, arriving):
        answers = []
        for inputs in arriving[0]:
            charged = self.membrane + inputs
            ratio = charged / self.threshold
            n = (ratio.floor() if self.at_threshold else ratio.ceil() - 1).clamp(min=0)
            self.n_steps += 1
            n = n if self.n_steps > self.late else torch.zeros_like(n)
            self.membrane = charged - n * self.threshold
            nearest = self.threshold * ratio.round().clamp(min=1)
            answers.append((n, self.membrane, (charged - nearest).abs()))
        return S.Answer(*(torch.stack(values)[None] for values in zip(*answers, strict=True)))


def plain_network(graph, **how):
    return S.SteppedNetwork(stages_of(graph, torch.float64), lambda node: PlainNeurons(node, **how))


def events_of(n, seed=0):
    rng = np.random.default_rng(seed)
    events = np.zeros(n, EVENT_DTYPE)
    events["t"] = np.round(1e6 * STEP_S * np.arange(n))
    # an object of 8x8 pixels, so that neurons fire after few events
    events["x"], events["y"] = rng.integers(12, 20, (2, n))
    events["p"] = rng.integers(0, 2, n)
    return events


def compared(model, graph, network, events):
    return compare(model, network, [events], stages_of(graph, torch.float64))


def model_of(graph, reset="subtract"):
    return Model.from_nir(graph, classes=CLASSES, window_us=1_000_000, reset=reset, dt=STEP_S)


@pytest.fixture(scope="module")
def graph():
    return random_paper_graph(np.random.default_rng(0))


def test_the_same_network_agrees_spike_for_spike(graph):
    report = compared(model_of(graph), graph, plain_network(graph), events_of(150))
    assert report["events"] == 150 and report["recordings"] == 1
    assert report["deviations"] == report["deviations_near"] == 0 and report["first"] == []
    assert all(n > 0 for n in report["spikes"].values())
    assert report["largest_difference"] < 1e-9 < report["nearest"]
    assert report["operations"] == report["our_operations"]
    assert all(n > 0 for n in report["operations"].values())


def test_a_network_that_fires_later_differs_where_it_does(graph):
    """The first spike that is not there is the first difference."""
    model = model_of(graph)
    events = events_of(150)
    first = next(
        k for k in range(150) if sum(compared_spikes(model, graph, events[: k + 1]).values())
    )
    report = compared(model, graph, plain_network(graph, late=150), events)
    assert report["deviations"] == 1 and report["deviations_near"] == 0
    assert report["events"] == first
    (found,) = report["first"]
    assert (found["recording"], found["event"], found["layer"]) == (0, first, "1")
    assert found["margin"] > 1e-5


def compared_spikes(model, graph, events):
    return compared(model, graph, plain_network(graph), events)["spikes"]


def one_pixel_graph(weight):
    """A dense layer of one weight for all inputs, and ten neurons with the threshold 1."""
    ones = np.ones(10, np.float32)
    nodes = {
        "input": nir.Input({"input": np.array([2, 4, 4])}),
        "flat": nir.Flatten({"input": np.array([2, 4, 4])}, 0, -1),
        "dense": nir.Linear(np.full((10, 32), weight, np.float32)),
        "out": nir.IF(ones, ones),
        "output": nir.Output({"output": np.array([10])}),
    }
    names = list(nodes)
    return nir.NIRGraph(nodes, list(pairwise(names)))


def test_a_membrane_at_its_threshold_is_counted_apart():
    """After two events of .5 the membrane is 1: NIR does not fire there, and sinabs does."""
    graph = one_pixel_graph(0.5)
    events = events_of(6)
    for name in "xy":
        events[name] = 1
    report = compared(model_of(graph), graph, plain_network(graph, at_threshold=True), events)
    assert (report["deviations"], report["deviations_near"], report["events"]) == (0, 1, 1)
    assert report["first"][0]["margin"] == 0.0 and report["first"][0]["neurons"] == 10


def test_a_bias_and_an_unknown_node_are_refused():
    graph = one_pixel_graph(0.5)
    graph.nodes["dense"] = nir.Affine(np.ones((10, 32)), np.ones(10))
    with pytest.raises(ValueError, match="a bias, which has no meaning at an event"):
        stages_of(graph, torch.float64)
    graph.nodes["dense"] = nir.Delay(np.ones(32))
    with pytest.raises(NotImplementedError, match="of type Delay"):
        stages_of(graph, torch.float64)


# -- work ------------------------------------------------------------------------------------------


def test_fan_out_by_hand():
    """A convolution of 3x3 with padding: a corner reaches 4 places, an edge 6, and 5 filters."""
    counts = fan_out(torch.nn.Conv2d(2, 5, 3, padding=1, bias=False), (2, 4, 4))
    assert counts.shape == (2, 4, 4)
    assert (counts[0, 0, 0], counts[1, 0, 1], counts[0, 1, 2]) == (20, 30, 45)
    assert fan_out(torch.nn.Linear(3, 7, bias=False), (3,)).tolist() == [7, 7, 7]


def test_operations_of_a_dense_layer_are_ten_an_event():
    graph = one_pixel_graph(0.5)
    stages = stages_of(graph, torch.float64)
    network = plain_network(graph)
    inputs = torch.zeros((1, 3, 2, 4, 4), dtype=torch.float64)
    inputs[0, 0, 0, 1, 1] = 1
    inputs[0, 2, 1, 3, 3] = 2  # two events of a pixel in one step
    operations = Operations(stages)
    operations.add(inputs, network.step(inputs))
    assert operations.by_layer == {"out": 20}


# -- bins ------------------------------------------------------------------------------------------


def test_steps_of_events():
    events = np.zeros(4, EVENT_DTYPE)
    events["t"] = (0, 999, 1_000, 3_500)
    assert step_of_events(events, 1_000).tolist() == [0, 0, 1, 3]
    assert step_of_events(events, None).tolist() == [0, 1, 2, 3]


def test_the_membrane_decides_between_as_many_spikes():
    counts = np.array([[2.0, 3.0, 3.0], [1.0, 0.0, 0.0]])
    membranes = np.array([[9.0, 0.1, 0.2], [0.0, 5.0, 5.0]])
    assert decided(counts, membranes).tolist() == [2, 0]


# -- the simulators --------------------------------------------------------------------------------

missing = S.missing_simulators()


@pytest.fixture
def without_warnings():
    """Simulators call parts of torch that will go."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.mark.skipif(S.SINABS in missing, reason="sinabs is not installed")
def test_sinabs_agrees_spike_for_spike_and_bins_of_one_event_decide_alike(graph, without_warnings):
    stages = stages_of(graph, torch.float64)

    def neurons(node):
        return S.SinabsNeurons(node, torch.float64, lowest=None, records=True)

    events = events_of(150)
    network = S.SteppedNetwork(stages, neurons)
    report = compared(model_of(graph), graph, network, events)
    assert report["events"] == 150 and report["deviations"] + report["deviations_near"] == 0

    digits = [Recording(events_of(60, seed), seed % 10) for seed in range(3)]
    stages = stages_of(graph, torch.float32)
    network = S.SteppedNetwork(
        stages, lambda node: S.SinabsNeurons(node, torch.float32, lowest=None, records=True)
    )
    row = binned_accuracy(network, digits, None, SENSOR)
    assert (row["recordings"], row["steps_a_recording"]) == (3, 60)


@pytest.mark.skipif(S.NORSE in missing, reason="Norse is not installed")
def test_norse_agrees_spike_for_spike(without_warnings):
    graph = random_small_graph("IF", STEP_S, np.random.default_rng(0))
    network = S.SteppedNetwork(
        stages_of(graph, torch.float64),
        lambda node: S.NorseNeurons(node, torch.float64, records=True),
    )
    report = compared(model_of(graph, "value"), graph, network, events_of(600))
    assert report["events"] == 600 and report["deviations"] + report["deviations_near"] == 0
    assert all(n > 0 for n in report["spikes"].values())


@pytest.mark.skipif(S.SNNTORCH in missing, reason="snnTorch is not installed")
@pytest.mark.parametrize("reset, ours", [("zero", "value"), ("subtract", "subtract")])
def test_snntorch_agrees_spike_for_spike(reset, ours, without_warnings):
    graph = random_small_graph("LIF", STEP_S, np.random.default_rng(0))
    network = S.SteppedNetwork(
        stages_of(graph, torch.float64),
        lambda node: S.SnnTorchNeurons(
            node, torch.float64, step_s=STEP_S, reset=reset, records=True
        ),
    )
    report = compared(model_of(graph, ours), graph, network, events_of(600))
    assert report["events"] == 600 and report["deviations"] + report["deviations_near"] == 0
    assert all(n > 0 for n in report["spikes"].values())


def test_tables_of_a_report_without_parts_say_so():
    assert tables.spiking_accuracy({}) == tables.spiking_bins({}) == "not measured"
    assert tables.spiking_times({}) == tables.spiking_machine({}) == "not measured"


def test_the_recorded_simulators_agree_spike_for_spike():
    parts = results("spiking")
    rows = parts["agreement"]["rows"]
    assert len(rows) == 4 and not parts["agreement"]["left_out"]
    for row in rows.values():
        assert row["deviations"] == row["deviations_near"] == 0
        assert row["operations"] == row["our_operations"]
        assert all(n > 0 for n in row["spikes"].values())
    assert parts["accuracy"]["recordings"] == 1_000
    assert not any(part["quick"] for part in parts.values())
