"""Spiking networks at every event: the same spikes and membranes as with all neurons computed.

Membranes of IF neurons have the same bits. Those that leak differ by rounding: the reference lets
them leak at each event, and the package when they are touched.

ASYNC_TNT_FUZZ_CASES makes it a long run.
"""

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import nasty_streams
from networks.random_spiking import CONFIG, random_spiking_model

from async_tnt import Model, open_recording
from async_tnt.networks.models.spiking_volume import SpikingVolume

torch = pytest.importorskip("torch", reason="the reference needs torch")

from tnt_reference.spiking import SpikingNetwork  # noqa: E402

CASES = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", "60"))
EVENTS = 120
REAL_EVENTS = int(os.environ.get("ASYNC_TNT_REAL_EVENTS", "1500"))
"""Number of events of real recordings."""

LEAKY_BOUND = 1e-9
"""How much membranes that leak may differ, as a share of their layer's largest one if that is above
1."""


def stream_of(seed, n=EVENTS, config=CONFIG):
    """Events of one window: bursts at a few pixels, ties, and events that come late."""
    rng = np.random.default_rng(seed)
    width, height = config.sensor
    t = np.sort(rng.integers(0, config.window_us, n))
    x = np.clip(rng.normal(rng.integers(width), 1.5, n).round(), 0, width - 1).astype(int)
    y = np.clip(rng.normal(rng.integers(height), 1.5, n).round(), 0, height - 1).astype(int)
    p = rng.integers(0, 2, n)
    late = rng.random(n) < 0.05
    t[late] = np.maximum(0, t[late] - 50)
    return np.stack([t, x, y, p], axis=1)


def compare_at_every_event(model, events, where):
    """Step through the events, and compare the states after each of them."""
    volume = SpikingVolume(model)
    volume.open(0)
    reference = SpikingNetwork(model.network["spiking"], model.weights, model.config.shape)
    own = []
    expected = []
    newest_us = 0
    for t, x, y, p in events.tolist():
        volume.update_one(t, x, y, p)
        newest_us = max(newest_us, t)  # a late event acts at the time of the newest
        reference.step(newest_us, x, y, p == 1)
        own.append(state_of_volume(volume, reference.spikes))
        expected.append(state_of_reference(reference, volume.network.fires))
    if own:
        assert_equal(own, expected, reference.leaks, where)
    return reference


def state_of_volume(volume, spiking_layers):
    """Name -> numbers. Layers of neurons are named by themselves."""
    state = {layer: volume.membranes(layer) for layer in volume.network.layers}
    state["spikes"] = np.array([volume.spikes(layer) for layer in spiking_layers])
    if volume.network.fires:
        state["counts"] = volume.spike_counts()
        state["first_us"] = volume.first_spikes_us()
    return state


def state_of_reference(reference, fires):
    """The same of the reference."""
    state = {layer: values.numpy() for layer, values in reference.membranes.items()}
    state["spikes"] = np.array(list(reference.spikes.values()))
    if fires:
        state["counts"] = reference.counts.numpy().copy()
        state["first_us"] = reference.first_us.numpy().copy()
    return state


def assert_equal(own, expected, leaks, where):
    """Compare the states after each event, those of all events at once."""
    assert own[0].keys() == expected[0].keys()
    for name in own[0]:
        found = np.array([state[name].reshape(-1) for state in own])
        right = np.array([state[name].reshape(-1) for state in expected])
        place = str((*where, name))
        if name in ("spikes", "counts", "first_us"):
            np.testing.assert_array_equal(found, right, place)
        elif leaks:
            largest = np.maximum(1.0, np.abs(right).max(1, keepdims=True))
            np.testing.assert_allclose(
                found / largest, right / largest, rtol=0, atol=LEAKY_BOUND, err_msg=place
            )
        else:
            np.testing.assert_array_equal(found.view(np.int64), right.view(np.int64), place)


def test_where_rounding_leaves_more_than_the_threshold_there_is_one_more_spike():
    """An event adds the product r w, which is n h + 2^-23 for the threshold h and n spikes.

    The quotient of both is rounded to n, so that its formula has n - 1 spikes.
    """
    r = 16541121.0
    w = 10639287.0 / 2**16
    h = 12732511.0 / 2**23
    n = 1769185505.0
    assert r * w - (n - 1) * h > h and np.ceil(r * w / h) - 1 == n - 1
    layers = [
        {"op": "flatten", "name": "flat", "inputs": ["volume"]},
        {"op": "dense", "name": "fc", "inputs": ["flat"], "weights": {"weight": "w"}},
        {
            "op": "if",
            "name": "out",
            "inputs": ["fc"],
            "reset": "subtract",
            "weights": {"r": "r", "v_threshold": "h"},
        },
    ]
    shape = (2, *CONFIG.shape[-2:])
    weights = {
        "w": np.full((2, np.prod(shape)), w, np.float32),
        "r": np.full(2, r, np.float32),
        "h": np.float32([h, 1e30]),
    }
    model = Model(CONFIG, weights, ["a", "b"], network={"spiking": layers})
    reference = compare_at_every_event(model, np.array([[10, 1, 2, 1]]), ())
    assert reference.counts.flatten().tolist() == [n, 0]
    assert reference.spikes == {"out": n}
    assert reference.membranes["out"].flatten().tolist() == [2.0**-23, r * w]


ALL = ("if", "lif", "cuba_lif", "threshold")


@given(data=st.data())
def test_hard_streams(data):
    """Ties, bursts at one pixel, times that run backwards, the window's first microsecond."""
    ops = data.draw(st.sampled_from([("if",), ALL]))
    model = random_spiking_model(data.draw(st.integers(0, 500)), ops=ops)
    events = data.draw(nasty_streams(CONFIG.sensor, CONFIG.window_us, 0, max_events=40))
    columns = np.stack([events[name].astype(np.int64) for name in "txyp"], axis=1)
    compare_at_every_event(model, columns, ())


@pytest.mark.parametrize("ops", [("if",), ("if", "lif"), ("cuba_lif",), ALL], ids="+".join)
def test_spikes_and_membranes_at_every_event(ops):
    fired = 0
    for seed in range(CASES):
        model = random_spiking_model(seed, raw=seed % 2 == 0, ops=ops)
        reference = compare_at_every_event(model, stream_of(seed), (seed,))
        fired += sum(n > 10 for n in reference.spikes.values()) > 1
    assert fired > CASES // 4


def test_random_graphs():
    """What graphs of maps, of lines of pixels and of vectors become."""
    pytest.importorskip("nir", reason="needs the extra `nir`")
    from networks.nir.random_graphs import RandomGraph

    for seed in range(CASES):
        drawn = RandomGraph(seed)
        model = Model.from_nir(drawn.graph, **drawn.meaning, window_us=1000)
        compare_at_every_event(model, stream_of(seed, 40, model.config), (seed,))


def test_the_published_graph_on_real_recordings(data):
    """At every event. ASYNC_TNT_REAL_EVENTS makes it a long run."""
    pytest.importorskip("h5py", reason="needs the extra `nir`")
    path = data / "nir" / "cnn_sinabs.nir"
    if not path.is_file():
        pytest.skip(f"no file {path}")
    model = Model.from_nir(path, reset="subtract", window_us=1_000_000)
    n_left = REAL_EVENTS
    n_fired = 0
    for recording in sorted((data / "nmnist" / "Test").glob("*/*.bin")):
        events = open_recording(recording).read()[:n_left]
        columns = np.stack([events[name].astype(np.int64) for name in "txyp"], axis=1)
        columns[:, 0] -= columns[0, 0]
        reference = compare_at_every_event(model, columns, (recording.name,))
        n_fired += sum(reference.spikes.values())
        n_left -= len(events)
        if n_left == 0:
            break
    assert n_fired > REAL_EVENTS
