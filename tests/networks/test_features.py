"""Features: what a network computes inside, after every event."""

import numpy as np
import pytest
import torch
from made import random_events, random_model
from networks.random_spiking import random_spiking_model
from torch import nn

from async_tnt import CompiledClassifier, Model, Processor, TNTConfig, load_model

CONFIG = TNTConfig(sensor=(20, 16), grid=(20, 16), bins=2, polarity="split", transform="none")


class Net(nn.Module):
    """Two convolutions with a way past the second one, and two dense layers."""

    def __init__(self):
        super().__init__()
        self.first = nn.Conv2d(4, 6, 3, 2, 1)
        self.second = nn.Conv2d(6, 6, 3, padding=1)
        self.hidden = nn.Linear(6 * 8 * 10, 7)
        self.last = nn.Linear(7, 3)

    def body(self, volume):
        x = torch.relu(self.first(volume))
        return torch.relu(x + self.second(x))

    def forward(self, volume):
        return self.last(torch.relu(self.hidden(self.body(volume).flatten(1))))


@pytest.fixture
def net():
    torch.manual_seed(0)
    return Net().eval()


def test_features_in_a_stream_are_those_inside_the_whole_network(net):
    model = Model.from_torch(net, CONFIG, ["a", "b", "c"])
    features = model.features()
    assert features.output_shapes == {"features": (6, 8, 10)} and features.classes == ()
    assert not any("hidden" in name or "last" in name for name in features.weights)
    processor = Processor(features, every_events=1)
    events = random_events(150, sensor=CONFIG.sensor, duration_us=CONFIG.window_us - 1)
    for event in events.tolist():
        (output,) = processor.push(event)
    with torch.no_grad():
        expected = net.body(torch.from_numpy(processor.volume().copy())[None])[0].numpy()
    np.testing.assert_allclose(output["features"], expected, atol=1e-5)
    # and the same bits as the classifier has inside: its head gives the same logits
    flat = torch.from_numpy(output["features"].copy()).flatten()
    with torch.no_grad():
        logits = net.last(torch.relu(net.hidden(flat))).numpy()
    np.testing.assert_allclose(
        CompiledClassifier(model)(processor.volume()), logits, rtol=1e-4, atol=1e-5
    )


def test_a_layer_by_its_name(net):
    model = Model.from_torch(net, CONFIG, ["a", "b", "c"])
    names = [layer["name"] for layer in model.layers]
    volume = random_events(60, sensor=CONFIG.sensor)
    for name in names:
        found = model.features(name)
        processor = Processor(found)
        processor.push(volume)
        array = processor.fire()["features"]
        (shape,) = found.output_shapes.values()
        assert array.shape == shape and np.isfinite(array).all()
    with pytest.raises(ValueError, match=r"`layer` must be a layer of the network: .*got 'nose'"):
        model.features("nose")


def test_a_layer_that_is_no_text(net):
    model = Model.from_torch(net, CONFIG, ["a", "b", "c"])
    with pytest.raises(ValueError, match="`layer` must be a layer of the network"):
        model.features(["first"])


def test_the_bundled_models(tmp_path):
    digits = load_model("digits").features()
    assert digits.output_shapes == {"features": (32, 8, 8)}
    everywhere = load_model("digits-everywhere").features()
    (shape,) = everywhere.output_shapes.values()
    assert len(shape) == 3
    wider = everywhere.for_sensor((200, 120))
    assert next(iter(wider.output_shapes.values()))[1:] != shape[1:]
    loaded = load_model(digits.save(tmp_path / "f.safetensors"))
    assert loaded.output_shapes == digits.output_shapes


def test_behind_several_flattens_lies_the_map():
    shape = {"kernel": [1, 1], "stride": [1, 1], "padding": [0] * 4, "dilation": [1, 1]}
    conv = {"op": "conv", "name": "map", "inputs": ["volume"], **shape, "groups": 1}
    layers = [
        conv | {"weights": {"weight": "w"}},
        {"op": "flatten", "name": "flat", "inputs": ["map"]},
        {"op": "flatten", "name": "flatter", "inputs": ["flat"]},
        {"op": "dense", "name": "last", "inputs": ["flatter"], "weights": {"weight": "v"}},
    ]
    weights = {"w": np.ones((2, 4, 1, 1)), "v": np.ones((3, 2 * 16 * 20))}
    model = Model(CONFIG, weights, ["a", "b", "c"], network={"classifier": layers})
    for layer in (None, "map", "flat", "flatter"):
        assert model.features(layer).output_shapes == {"features": (2, 16, 20)}


def test_a_landmark_network_stays():
    model = random_model(TNTConfig(landmark="regressor"))
    processor = Processor(model.features())
    processor.push(random_events(300))
    assert processor.fire()["features"].any()


def test_what_has_no_features():
    with pytest.raises(NotImplementedError, match="SpikingVolume shows the spikes and membranes"):
        random_spiking_model(0).features()
    flat = nn.Sequential(nn.Flatten(), nn.Linear(4 * 16 * 20, 3))
    model = Model.from_torch(flat, CONFIG, ["a", "b", "c"])
    with pytest.raises(ValueError, match="`layer` must be another one: this one is the volume"):
        model.features()
