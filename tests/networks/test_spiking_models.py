"""Spiking models: what they refuse, their files, and the state of their streams."""

import re
from dataclasses import replace

import numpy as np
import pytest
from made import random_events
from networks.random_spiking import CONFIG, random_spiking_model
from networks.test_spiking_by_hand import dense_model, integrate, layer, model_of

from async_tnt import (
    CompiledClassifier,
    Model,
    Processor,
    SpikingVolume,
    TNTConfig,
    load_model,
    stream,
)
from async_tnt.base.box import Box
from async_tnt.networks.models.spiking_network import SpikingNetwork
from async_tnt.networks.models.torch_modules import torch_classifier


def events_of(config, n=300, seed=0):
    return random_events(n, seed=seed, duration_us=3 * config.window_us, sensor=config.sensor)


@pytest.mark.parametrize("raw", [False, True])
def test_a_model_file_keeps_the_network(tmp_path, raw):
    for seed in range(10):
        model = random_spiking_model(seed, raw=raw)
        again = load_model(model.save(tmp_path / "m.safetensors"))
        assert again.network == model.network and again.outputs == model.outputs
        assert (again.config, again.classes) == (model.config, model.classes)
        assert again.weights.keys() == model.weights.keys()
        for name, weight in model.weights.items():
            np.testing.assert_array_equal(again.weights[name], weight)


@pytest.mark.parametrize("hop_us", [None, 400])
def test_a_saved_state_continues_the_stream(hop_us):
    model = random_spiking_model(9)
    events = events_of(CONFIG)
    whole = Processor(model, every_events=3, hop_us=hop_us)
    expected = whole.push(events)
    first = Processor(model, every_events=3, hop_us=hop_us)
    decisions = first.push(events[:150])
    state = first.save_state()
    assert len(state) < 200_000
    continued = Processor.from_state(state, model)
    decisions += continued.push(events[150:])
    assert [d.logits.tolist() for d in decisions] == [d.logits.tolist() for d in expected]

    other = Model(CONFIG, {}, ["a"], network=tiny_network())
    with pytest.raises(ValueError, match="`state` must be of a stream with another network, got"):
        Processor.from_state(state, other)


def tiny_network():
    return {
        "classifier": [
            {"op": "global_average_pool", "name": "m", "inputs": ["volume"]},
            {"op": "pick", "name": "p", "inputs": ["m"], "channels": [0]},
        ]
    }


def test_the_stream_of_another_network_is_refused():
    model = Model(CONFIG, {}, ["a"], network=tiny_network())
    state = Processor(model).save_state()
    with pytest.raises(ValueError, match="of a stream with a spiking network, got one with anoth"):
        Processor.from_state(state, random_spiking_model(9))


def changed(model, **fields):
    """The model whose last layer has other fields."""
    *layers, last = model.network["spiking"]
    return replace(model, network={"spiking": [*layers, last | fields]})


LEAKY = {"tau": [1.0] * 2, "r": [1.0] * 2, "v_leak": [0.0] * 2, "v_threshold": [1.0] * 2}


def leaky(**values):
    return layer("lif", "out", "fc", LEAKY | values, reset="value", dt=1e-3)


CURRENT = {"tau_mem": [1.0] * 2, "tau_syn": [1.0] * 2, "w_in": [1.0] * 2}
WITH_CURRENT = CURRENT | {role: LEAKY[role] for role in ("r", "v_leak", "v_threshold")}


def with_current(**values):
    return layer("cuba_lif", "out", "fc", WITH_CURRENT | values, reset="value", dt=1e-3)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: integrate("subtract", [0.0, 1.0]), "v_threshold must be positive with the reset"),
        (lambda: integrate("subtract", v_reset=[0.0, -1.0]), "v_reset must be 0 with the reset"),
        (lambda: integrate("value", v_reset=[2.0, 0.0]), "v_reset must not be above v_threshold"),
        (
            lambda: integrate("value", [-0.5, 1.0], v_reset=[-1.0, 0.0]),
            "its rest, 0, must not be above v_threshold",
        ),
        (lambda: integrate("value", [np.inf, 1.0]), "`out.v_threshold` must be finite numbers"),
        (lambda: integrate("never"), "`reset` must be one of subtract, value, got 'never'"),
        (lambda: leaky(tau=[0.0, 1.0]), "tau must be positive, got 0"),
        (lambda: leaky(v_leak=[2.0, 0.0]), "v_leak must not be above v_threshold"),
        (lambda: with_current(tau_mem=[1.0, -1.0]), "tau_mem must be positive, got -1"),
        (lambda: with_current(tau_syn=[0.0, 1.0]), "tau_syn must be positive, got 0"),
        (lambda: with_current(v_leak=[0.0, 2.0]), "v_leak must not be above v_threshold"),
        (lambda: leaky(r=[1.0] * 3), "its r must have shape (2,) here, got (3,)"),
        (
            lambda: layer("lif", "out", "fc", LEAKY, reset="value", dt=0.0),
            "`dt` must be a positive number, got 0.0",
        ),
        (
            lambda: layer("lif", "out", "fc", LEAKY, reset="value"),
            "must have dt",
        ),
    ],
)
def test_neurons_without_a_meaning_are_refused(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        dense_model(make())


def test_a_neuron_may_be_reset_to_its_threshold_and_rest_there():
    """As it fires above the threshold only."""
    model = dense_model(integrate("value", v_reset=[1.0, -1.0]))
    assert model.weights["out.v_reset"].tolist() == [1.0, -1.0]
    assert dense_model(leaky(v_leak=[1.0, 0.0])).is_spiking


FLAT = layer("flatten", "flat", "volume")
DENSE = layer("dense", "fc", "flat", {"weight": np.ones((2, 24))})


@pytest.mark.parametrize(
    "layers, message",
    [
        (
            [FLAT, DENSE, layer("threshold", "t", "fc", {"threshold": [0.5, -0.5]})],
            "layer 't' (threshold): threshold must not be negative, as it would fire without",
        ),
        (
            [
                FLAT,
                DENSE,
                layer("li", "li", "fc", {r: LEAKY[r] for r in ("tau", "r", "v_leak")}, dt=1e-3),
                layer("scale", "t", "li", {"scale": [1.0] * 2}),
            ],
            "layer 'li' (li) must be the last one, as it never fires",
        ),
        (
            [
                layer("pick", "swapped", "volume", channels=[1, 0]),
                layer("scale", "scaled", "volume", {"scale": [1.0] * 2}),
                (
                    {"op": "add", "name": "t", "inputs": ["swapped", "scaled"]},
                    {},
                ),
            ],
            "layer 'swapped' (pick) must be the only one that reads the events",
        ),
        (
            [layer("pick", "t", "volume", channels=[0, 0])],
            "layer 't' (pick): it must read the events, and exchange or keep their channels [0, 1]",
        ),
        (
            [
                layer("scale", "scaled", "volume", {"scale": [1.0] * 2}),
                layer("pick", "t", "scaled", channels=[1, 0]),
            ],
            "layer 't' (pick): it must read the events, and exchange or keep their channels [0, 1]",
        ),
    ],
)
def test_layers_without_a_meaning_at_an_event_are_refused(layers, message):
    neurons = layer("if", "out", "t", {"r": [1.0] * 2, "v_threshold": [1.0] * 2}, reset="value")
    *_, (last, _) = layers
    is_map = last["op"] in ("pick", "add")
    ends = [layer("flatten", "flat", "t"), DENSE, integrate("value")] if is_map else [neurons]
    with pytest.raises(ValueError, match=re.escape(message)):
        model_of(*layers, *ends)


def test_other_layers_without_a_meaning_are_refused():
    base = dense_model(integrate("subtract"))
    with pytest.raises(ValueError, match=re.escape("'fc' (dense): its bias must be 0, got up to")):
        model_of(
            layer("flatten", "flat", "volume"),
            layer("dense", "fc", "flat", {"weight": np.ones((2, 24)), "bias": [0.0, 0.5]}),
            integrate("subtract"),
        )
    with pytest.raises(ValueError, match="the last layer of a spiking network must be of neurons"):
        Model(
            base.config,
            {"fc.weight": base.weights["fc.weight"]},
            ["a", "b"],
            network={"spiking": base.network["spiking"][:2]},
        )
    with pytest.raises(NotImplementedError, match="layer 'relu' is a 'relu'; this release knows"):
        model_of(layer("relu", "relu", "volume"), integrate("subtract"))
    with pytest.raises(ValueError, match="a spiking network reads the events of a sensor"):
        replace(base, config=base.config.replace(window_events=100, window_us=None))
    with pytest.raises(ValueError, match="a spiking network reads the events of a sensor"):
        replace(base, config=TNTConfig(sensor=(4, 3), grid=(4, 3), bins=2, transform="none"))
    with pytest.raises(ValueError, match="a spiking network reads the events of a sensor"):
        replace(base, config=base.config.replace(sensor=(8, 6)))
    with pytest.raises(ValueError, match="a spiking network reads the events of a sensor"):
        replace(base, config=base.config.replace(representation="mean_time"))
    one_channel = base.weights | {"fc.weight": base.weights["fc.weight"][:, :12]}
    with pytest.raises(ValueError, match="a spiking network reads the events of a sensor"):
        replace(base, config=base.config.replace(polarity="unsigned"), weights=one_channel)
    with pytest.raises(ValueError, match="the outputs of this spiking network must be spike"):
        replace(base, classes=(), outputs={"out": "out"})
    with pytest.raises(ValueError, match="the network must compute 3 logits"):
        replace(base, classes=("a", "b", "c"))


def test_networks_of_volumes_refuse_a_spiking_model():
    model = random_spiking_model(9)
    message = "`model` must have a network that reads volumes; events go through a spiking"
    for use in (CompiledClassifier, torch_classifier):
        with pytest.raises(ValueError, match=message):
            use(model)
    with pytest.raises(ValueError, match="`model` must be a spiking model"):
        SpikingVolume(Model(CONFIG, {}, ["a"], network=tiny_network()))


def test_settings_of_a_stream():
    model = random_spiking_model(9)
    raw = random_spiking_model(9, raw=True)
    events = events_of(CONFIG)
    assert len(list(stream(events, model, every_us=100))) > 10
    with pytest.raises(ValueError, match="`confidence` is for models with classes"):
        Processor(raw, confidence=0.9)
    with pytest.raises(TypeError, match="`classifier` must not be given"):
        Processor(model, classifier=lambda volume: [0, 0, 0])
    with pytest.raises(ValueError, match="`classes` must be 3 names, one for each neuron"):
        Processor(model, classes=["a", "b"])
    with pytest.raises(ValueError, match="`classes` are for a network of logits"):
        Processor(raw, classes=["a", "b", "c"])
    network = SpikingNetwork(model)
    assert Processor(model, classifier=network).classifier is network
    processor = Processor(model)
    with pytest.raises(TypeError, match="`classifier` cannot be exchanged"):
        processor.classifier = lambda volume: [0, 0, 0]
    with pytest.raises(ValueError, match="`layer` must be one of"):
        SpikingVolume(model).spikes("nothing")


def test_the_confidence_closes_a_window():
    model = random_spiking_model(9)
    decisions = list(stream(events_of(CONFIG), model, confidence=0.99))
    assert {d.trigger for d in decisions} >= {"confidence"}
    assert all(d.probability >= 0.99 for d in decisions if d.trigger == "confidence")


@pytest.mark.parametrize("ops", [("if",), ("if", "lif", "cuba_lif")], ids="+".join)
def test_logits_are_spikes_or_membranes_as_they_are_then(ops):
    """Where logits are equal, the largest membrane decides; where membranes are, the first class.

    It is so after each event, and in a window that has none yet, whose neurons go on.
    """
    n_leaky = 0
    n_tied = 0
    for seed in range(25):
        volume = SpikingVolume(random_spiking_model(seed, ops=ops), keep_neurons=True)
        fires = volume.network.fires
        for event in [None, *events_of(CONFIG, 40, seed).tolist(), None]:
            if event is None:
                volume.open(volume.start_us + CONFIG.window_us)
            else:
                volume.update_one(*event)
            index, logits, probabilities = volume.answer()
            membranes = volume.membranes()
            expected = volume.spike_counts() if fires else membranes
            np.testing.assert_allclose(logits, expected, rtol=1e-6, atol=1e-9)
            tied = np.flatnonzero(logits == logits.max())
            assert index == tied[np.argmax(membranes[tied])]
            shares = np.exp(logits.astype(float))
            np.testing.assert_allclose(probabilities, shares / shares.sum(), rtol=1e-9)
            n_leaky += not fires and len(set(membranes)) > 1
            n_tied += len(set(membranes[tied])) > 1 and index > 0
    assert n_tied > 20 and (n_leaky > 20 or ops == ("if",))


@pytest.mark.parametrize(
    "settings",
    [{}, {"every_events": 4}, {"confidence": 0.9}, {"every_events": 3, "confidence": 0.8}],
    ids=str,
)
def test_moments_in_pauses_are_the_same_in_one_compiled_call(settings, monkeypatch):
    """At moments without new events nothing is decided, also where they are windows apart."""
    model = random_spiking_model(9)
    rng = np.random.default_rng(4)
    events = events_of(CONFIG, 250)
    events["t"] = np.cumsum(
        rng.choice([0, 3, 20, 150, 700, 2500], 250, p=[0.3, 0.3, 0.2] + [0.2 / 3] * 3)
    )
    one_by_one = Processor(model, every_us=50, **settings)
    expected = [told(d) for event in events.tolist() for d in one_by_one.push_one(*event)]
    assert sum(trigger == "every_us" for trigger, *_ in expected) > 15
    for length in (1, 10_000):  # of a packet that is decided in one call
        monkeypatch.setattr("async_tnt.streaming.processor.STRETCH", length)
        assert [told(d) for d in Processor(model, every_us=50, **settings).push(events)] == expected


def told(decision):
    about = (decision.trigger, decision.window_start_us, decision.time_us, decision.events)
    return *about, decision.label, decision.logits.tolist()


def test_a_model_for_another_sensor_has_the_same_neurons():
    conv, weights = layer(
        "conv",
        "conv",
        "volume",
        {"weight": np.ones((2, 2, 3, 3))},
        kernel=[3, 3],
        stride=[1, 1],
        padding=[1, 1, 1, 1],
        dilation=[1, 1],
        groups=1,
    )
    values = {"r": [1.0] * 2, "v_threshold": [0.5] * 2}
    neurons, tensors = layer("if", "out", "conv", values, reset="value")
    network = {"spiking": [conv, neurons]}
    outputs = {"spikes": "out", "membranes": "out", "first_spike_us": "out"}
    model = Model(CONFIG, weights | tensors, network=network, outputs=outputs)
    large = model.for_sensor((20, 16))
    assert large.output_shapes["spikes"] == (2, 16, 20)
    volume = SpikingVolume(large)
    volume.update_one(5, 19, 15, 1)
    assert volume.spikes() == 8  # of 2 x 2 places in the corner
    assert Processor(large).fire().changed == (Box(0, 0, 20, 16),) * 3
