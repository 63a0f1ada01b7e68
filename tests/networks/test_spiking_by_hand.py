"""Spikes and membranes of small networks, worked out by hand."""

import numpy as np
import pytest

from async_tnt import Model, Processor, SpikingVolume, TNTConfig
from async_tnt.base.box import Box
from async_tnt.kernels.volume.absorb import ABSORBED, REFUSED
from async_tnt.networks.models.spiking_network import SpikingNetwork

CONFIG = TNTConfig(sensor=(4, 3), grid=(4, 3), representation="count", window_us=1_000_000)


def layer(op, name, inputs, weights=None, **fields):
    made = {"op": op, "name": name, "inputs": [inputs], **fields}
    if weights:
        made["weights"] = {role: f"{name}.{role}" for role in weights}
    return made, {f"{name}.{role}": np.array(w, np.float32) for role, w in (weights or {}).items()}


def model_of(*layers, classes=("a", "b")):
    weights = {}
    for _, tensors in layers:
        weights |= tensors
    return Model(CONFIG, weights, classes, network={"spiking": [one for one, _ in layers]})


def dense_model(neurons, on=(1.0, 0.25), off=(-0.5, 0.5)):
    """Two neurons, to which each event at the pixel (1, 2) adds `on` or `off`."""
    weight = np.zeros((2, 2, 3, 4))
    weight[:, 0, 2, 1] = on
    weight[:, 1, 2, 1] = off
    return model_of(
        layer("flatten", "flat", "volume"),
        layer("dense", "fc", "flat", {"weight": weight.reshape(2, -1)}),
        neurons,
    )


def integrate(reset, threshold=(1.0, 1.0), **weights):
    given = {"r": [1.0, 1.0], "v_threshold": threshold, **weights}
    return layer("if", "out", "fc", given, reset=reset)


def volume_of(model):
    volume = SpikingVolume(model)
    volume.open(0)
    return volume


def push(volume, *events):
    for t, p in events:
        volume.update_one(t, 1, 2, p)
    return volume.spike_counts().tolist(), volume.membranes().tolist()


def test_a_neuron_fires_above_its_threshold_not_at_it():
    volume = volume_of(dense_model(integrate("subtract")))
    assert push(volume, (10, 1)) == ([0, 0], [1.0, 0.25])
    assert push(volume, (20, 1)) == ([1, 0], [1.0, 0.5])
    assert push(volume, (20, 0)) == ([1, 0], [0.5, 1.0])
    assert push(volume, (30, 0)) == ([1, 1], [0.0, 0.5])
    assert volume.first_spikes_us().tolist() == [20, 30]
    assert (volume.spikes(), volume.additions()) == (2, 8)


def test_what_neurons_did_is_told_by_copies():
    volume = volume_of(dense_model(integrate("subtract")))
    push(volume, (10, 1), (20, 1))
    told = [volume.spike_counts(), volume.first_spikes_us(), volume.membranes()]
    before = [array.copy() for array in told]
    push(volume, (30, 0), (40, 0), (50, 0))
    for array, expected in zip(told, before, strict=True):
        np.testing.assert_array_equal(array, expected)
        array[:] = 7.0
    assert volume.spike_counts().tolist() == [1, 1] and volume.membranes().tolist() == [-0.5, 1.0]


def test_a_neuron_has_as_many_spikes_at_once_as_its_threshold_fits():
    """3.5 is 3 times 1 and .5; 3 is 2 times 1 and 1, which is not above the threshold."""
    volume = volume_of(dense_model(integrate("subtract"), on=(3.5, 3.0)))
    assert push(volume, (10, 1)) == ([3, 2], [0.5, 1.0])


def test_a_reset_to_a_value_has_one_spike():
    model = dense_model(integrate("value", v_reset=[0.0, -0.25]), on=(3.5, 1.5))
    volume = volume_of(model)
    assert push(volume, (10, 1)) == ([1, 1], [0.0, -0.25])


def test_the_resistance_multiplies_what_arrives():
    volume = volume_of(dense_model(integrate("subtract", r=[0.5, 2.0])))
    assert push(volume, (10, 1)) == ([0, 0], [0.5, 0.5])


def test_a_leaky_neuron_halves_in_the_time_of_a_half_life():
    """tau is 1 / log 2 ms: a millisecond halves the distance from rest.

    An input counts r dt / tau.
    """
    tau = 1e-3 / np.log(2)
    weights = {
        "tau": [tau, tau],
        "r": [tau / 1e-4, 2 * tau / 1e-4],
        "v_leak": [0.0, 0.5],
        "v_threshold": [10.0, 1.2],
    }
    neurons = layer("lif", "out", "fc", weights, reset="value", dt=1e-4)
    volume = volume_of(dense_model(neurons))
    assert volume.membranes().tolist() == [0.0, 0.5]
    np.testing.assert_allclose(push(volume, (0, 1))[1], [1.0, 1.0], rtol=1e-6)
    np.testing.assert_allclose(push(volume, (1_000, 1))[1], [1.5, 0.0], atol=1e-6)  # 1.25 > 1.2
    assert volume.spike_counts().tolist() == [0, 1]
    # other events let time pass, too
    volume.update_one(2_000, 0, 0, 1)
    np.testing.assert_allclose(volume.membranes(), [0.75, 0.25], atol=1e-6)


def test_a_leaky_integrator_decides_by_its_membrane():
    tau = [1e-3 / np.log(2)] * 2
    r = [1e1 / np.log(2)] * 2
    weights = {"tau": tau, "r": r, "v_leak": [0.0, 0.0]}
    model = dense_model(layer("li", "out", "fc", weights, dt=1e-4))
    processor = Processor(model, every_events=1, start_us=0)
    (first,) = processor.push((0, 1, 2, 1))
    (second,) = processor.push((1_000, 1, 2, 0))
    np.testing.assert_allclose(first.logits, [1.0, 0.25], rtol=1e-6)
    np.testing.assert_allclose(second.logits, [0.0, 0.625], atol=1e-6)
    assert (first.label, second.label) == ("a", "b")
    assert not SpikingNetwork(model).fires
    assert SpikingNetwork(dense_model(integrate("subtract"))).fires


def cuba(tau_syn, tau_mem, threshold, op="cuba_lif", **fields):
    """Neurons to which an event gives a current of 1, of the resistance 8."""
    weights = {
        "tau_syn": [tau_syn] * 2,
        "tau_mem": [tau_mem] * 2,
        "r": [8.0] * 2,
        "v_leak": [0.0] * 2,
        "w_in": [tau_syn / 1e-4] * 2,
    }
    if op == "cuba_lif":
        weights["v_threshold"] = threshold
        fields["reset"] = "value"
    return dense_model(layer(op, "out", "fc", weights, dt=1e-4, **fields))


def test_a_current_raises_the_membrane_and_both_leak():
    """With half-lives of 1 ms of the current and 2 ms of the membrane, p = q / 2.

    v = 8 p (e^-qt - e^-pt) / (p - q) = 8 (2^-(t / 2) - 2^-t) is 2 after 2 ms, and 1.5 after 4 ms.
    """
    volume = volume_of(cuba(1e-3 / np.log(2), 2e-3 / np.log(2), [], "cuba_li"))
    assert push(volume, (0, 1))[1] == [0.0, 0.0]
    volume.update_one(2_000, 0, 0, 1)
    np.testing.assert_allclose(volume.membranes(), [2.0, 0.5], rtol=1e-6)
    volume.update_one(4_000, 0, 0, 1)
    np.testing.assert_allclose(volume.membranes(), [1.5, 0.375], rtol=1e-6)


def test_equal_leaks_of_current_and_membrane():
    """v = 8 p t e^-pt, with p = log 2 / ms: 8 log 2 / 2 after a millisecond."""
    volume = volume_of(cuba(1e-3 / np.log(2), 1e-3 / np.log(2), [], "cuba_li"))
    push(volume, (0, 1))
    volume.update_one(1_000, 0, 0, 1)
    np.testing.assert_allclose(volume.membranes(), 4 * np.log(2) * np.array([1, 0.25]), rtol=1e-6)


def test_a_neuron_with_a_current_fires_at_the_next_event_wherever_it_lies():
    """Its membrane rises to 2 in 2 ms, and passes 1.9 before. The second neuron stays below."""
    volume = volume_of(cuba(1e-3 / np.log(2), 2e-3 / np.log(2), [1.9, 1.9]))
    push(volume, (0, 1))
    assert push(volume, (1, 1))[0] == [0, 0]
    volume = volume_of(cuba(1e-3 / np.log(2), 2e-3 / np.log(2), [1.9, 1.9]))
    push(volume, (0, 1))
    volume.update_one(2_000, 0, 0, 1)
    assert volume.spike_counts().tolist() == [1, 0] and volume.membranes()[0] == 0.0
    # a current of a quarter is left, which raises it again, but less
    volume.update_one(4_000, 0, 0, 1)
    assert volume.spike_counts().tolist() == [1, 0]
    np.testing.assert_allclose(volume.membranes()[0], 0.5, rtol=1e-6)


def test_a_threshold_forgets():
    model = model_of(
        layer("flatten", "flat", "volume"),
        layer("dense", "fc", "flat", {"weight": np.ones((2, 24)) * [[0.4], [0.6]]}),
        layer("threshold", "hidden", "fc", {"threshold": [0.5, 0.5]}),
        layer("dense", "last", "hidden", {"weight": np.eye(2)}),
        layer("if", "out", "last", {"r": [1.0] * 2, "v_threshold": [1.5] * 2}, reset="subtract"),
    )
    volume = volume_of(model)
    for t in range(1, 5):
        volume.update_one(t, 1, 2, t % 2)
    assert volume.spikes("hidden") == 4  # of the second neuron, one for each event
    assert volume.spike_counts().tolist() == [0, 2] and volume.membranes().tolist() == [0.0, 1.0]


def test_a_late_event_acts_at_the_time_of_the_newest():
    weights = {"tau": [1e-3] * 2, "r": [10.0] * 2, "v_leak": [0.0] * 2, "v_threshold": [9.0] * 2}
    volume = volume_of(dense_model(layer("lif", "out", "fc", weights, reset="value", dt=1e-4)))
    push(volume, (500, 1))
    assert push(volume, (400, 1))[1] == pytest.approx([2.0, 0.5])
    assert volume.counts.dropped_late == 0


def test_a_late_event_is_dropped_or_refused_where_a_stream_says_so():
    """One event at a time."""
    model = dense_model(integrate("subtract", [9.0, 9.0]))
    for late, expected in (("accept", [2.0, 0.5]), ("drop", [1.0, 0.25])):
        processor = Processor(model, late=late, start_us=0)
        processor.push((500, 1, 2, 1))
        processor.push((400, 1, 2, 1))
        assert processor._windows.oldest.membranes().tolist() == expected
        assert processor.counts.dropped_late == (late == "drop")
    processor = Processor(model, late="raise", start_us=0)
    processor.push((500, 1, 2, 1))
    with pytest.raises(ValueError, match=r"`t` must .*, got 400"):
        processor.push((400, 1, 2, 1))


def test_a_volume_that_does_not_accept_late_events_looks_at_each():
    """Its decoder does, which the compiled call of one event passes by."""
    model = dense_model(integrate("subtract", [9.0, 9.0]))
    for late, answer in (("accept", ABSORBED), ("drop", REFUSED), ("raise", REFUSED)):
        volume = SpikingVolume(model, late=late)
        volume.open(0)
        assert volume.absorb_one(500, 1, 2, 1) == answer
        assert volume.n_events == (late == "accept")


def test_events_before_the_window_have_no_effect():
    volume = SpikingVolume(dense_model(integrate("subtract")))
    volume.open(1_000)
    assert push(volume, (999, 1)) == ([0, 0], [0.0, 0.0])
    assert volume.counts.dropped_late == 1


def test_spikes_go_through_convolution_pool_and_sum():
    """An ON event at (1, 1) of 4x3 pixels. The convolution doubles it, to the right neighbour too.

    Each neuron above .5 fires: 2 and 1 are 3 spikes and 1, of thresholds .5. The pool sums 3x2
    places, so its first column has 4, and its second one none.
    """
    kernel = np.zeros((1, 2, 1, 2))
    kernel[0, 0, 0] = 1.0, 2.0  # what lies to the right counts 2
    weight = np.array([[1.0, 0.0], [0.0, 1.0]])
    model = model_of(
        layer(
            "conv",
            "conv",
            "volume",
            {"weight": kernel},
            kernel=[1, 2],
            stride=[1, 1],
            padding=[0, 0, 0, 1],
            dilation=[1, 1],
            groups=1,
        ),
        layer("if", "hidden", "conv", {"r": [1.0], "v_threshold": [0.5]}, reset="subtract"),
        layer("sum_pool", "pool", "hidden", kernel=[3, 2], stride=[3, 2], padding=[0, 0, 0, 0]),
        layer("flatten", "flat", "pool"),
        layer("dense", "fc", "flat", {"weight": weight}),
        layer("if", "out", "fc", {"r": [1.0] * 2, "v_threshold": [0.75] * 2}, reset="subtract"),
    )
    volume = volume_of(model)
    volume.update_one(5, 1, 1, 1)
    np.testing.assert_array_equal(
        volume.membranes("hidden"), [[[0, 0, 0, 0], [0.5, 0.5, 0, 0], [0, 0, 0, 0]]]
    )
    assert volume.spikes("hidden") == 4
    assert volume.spike_counts().tolist() == [5, 0] and volume.membranes().tolist() == [0.25, 0.0]
    # a filter at two places; then two classes, for the pool's first column
    assert (volume.additions("hidden"), volume.additions()) == (2, 2)


@pytest.mark.parametrize("keep, expected", [(False, [1.0, 0.25]), (True, [1.5, 1.0])])
def test_neurons_may_go_on_from_window_to_window(keep, expected):
    """Membranes of .5 and .75 are left of the first window."""
    model = dense_model(integrate("subtract", [9.0, 9.0]))
    processor = Processor(model, every_events=1, start_us=0, keep_neurons=keep)
    processor.push(([10, 20], [1, 1], [2, 2], [1, 0]))
    processor.push((CONFIG.window_us + 10, 1, 2, 1))
    volume = processor._windows.oldest
    assert volume.membranes().tolist() == expected
    assert volume.additions() == 2 and volume.n_events == 1
    processor.reset()
    assert processor._windows.oldest.membranes().tolist() == [0.0, 0.0]


def test_spikes_are_counted_by_window_though_neurons_go_on():
    model = dense_model(integrate("subtract"))
    processor = Processor(model, start_us=0, keep_neurons=True)
    times = [10, 20, 1_000_010, 1_000_020, 2_000_000]
    first, second = processor.push((times, [1] * 5, [2] * 5, [1] * 5))
    assert first.logits.tolist() == [1.0, 0.0] and second.logits.tolist() == [2.0, 0.0]
    with pytest.raises(ValueError, match="`keep_neurons` must not be given with overlapping"):
        Processor(model, hop_us=100_000, keep_neurons=True)
    with pytest.raises(ValueError, match="`keep_neurons` is for spiking models"):
        Processor("digits", keep_neurons=True)


def test_a_tie_of_spikes_is_decided_by_the_membrane():
    model = dense_model(integrate("subtract"), on=(1.25, 1.5))
    (decision,) = Processor(model, every_events=1, start_us=0).push((10, 1, 2, 1))
    assert decision.logits.tolist() == [1.0, 1.0] and decision.label == "b"
    np.testing.assert_array_equal(decision.probabilities, [0.5, 0.5])


def test_raw_outputs_are_spikes_membranes_and_first_times():
    base = dense_model(integrate("subtract"))
    outputs = {"spikes": "out", "membranes": "out", "first_spike_us": "out"}
    model = Model(CONFIG, base.weights, network=base.network, outputs=outputs)
    processor = Processor(model, every_events=2, start_us=1_000)
    (output,) = processor.push(([1_500, 1_700], [1, 1], [2, 2], [1, 1]))
    assert output["spikes"].tolist() == [1.0, 0.0]
    assert output["membranes"].tolist() == [1.0, 0.5]
    assert output["first_spike_us"].tolist() == [700.0, -1.0]
    assert not any(array.flags.writeable for array in output.arrays)
    assert output.changed == (Box(0, 0, 1, 1),) * 3


def test_a_huge_number_of_spikes_leaves_nothing():
    volume = volume_of(dense_model(integrate("subtract", [1e-9, 1.0]), on=(1e6, 0.0)))
    counts, membranes = push(volume, (10, 1))
    assert counts[0] > 9e14 and membranes == [0.0, 0.0]
    # more than a whole number of 64 bits holds: the sum of all spikes takes it for 2**31
    volume = volume_of(dense_model(integrate("subtract", [1e-9, 1.0]), on=(1e38, 0.0)))
    counts, membranes = push(volume, (10, 1))
    assert counts[0] > 9e46 and membranes == [0.0, 0.0] and volume.spikes() == 1 << 31
