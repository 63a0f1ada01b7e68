"""The classifier, the landmark regressor, and the way from events to logits and back."""

import pytest
import torch
from tnt_reference import (
    Classifier,
    LandmarkRegressor,
    LayerNetwork,
    Pipeline,
    event_volume,
    landmark,
    tnt_volume,
)

SETTINGS = dict(sensor=(12, 10), window_us=5_000, bins=5, t_max=2.0)


def window(seed=0, n=200, start_us=1_000):
    g = torch.Generator().manual_seed(seed)
    t = torch.randint(start_us, start_us + 5_000, (n,), generator=g).sort().values
    x = torch.randint(0, 12, (n,), generator=g)
    y = torch.randint(0, 10, (n,), generator=g)
    p = torch.randint(0, 2, (n,), generator=g)
    return t, x, y, p, start_us


@pytest.fixture(autouse=True)
def seeded():
    torch.manual_seed(0)


def test_classifier_by_hand():
    """Grid 8 wide, 4 high.

    Both convolutions copy their channels, so pooling twice averages 4 x 4 blocks.
    """
    network = Classifier(channels=2, grid=(8, 4), n_classes=1, widths=(2, 2, 1))
    with torch.no_grad():
        for w in network.parameters():
            w.zero_()
        for channel in range(2):
            network.conv1.weight[channel, channel, 1, 1] = 1
            network.conv2.weight[channel, channel, 1, 1] = 1
        network.conv2.bias[1] = -1
        # Flattened channel by channel, then row by row: (c0 left, c0 right, c1 left, c1 right).
        network.fc1.weight[:] = torch.tensor([[1.0, 10.0, 100.0, 1000.0]])
        network.fc2.weight[:] = 1
        network.fc2.bias[:] = 0.5
    volume = torch.zeros(2, 4, 8)
    # channel 0: left mean 1, right mean 4 * 4 / 16 = 1
    volume[0, 1, 2] = 16
    volume[0, 3, 4:] = 4
    # channel 1: left 3 - 1, right 0 - 1; ReLU cuts the negative ones
    volume[1, :, :4] = 3
    volume[1, 0, 7] = -16
    assert network(volume).tolist() == [1 + 10 + 200 + 0.5]


def test_regressor_by_hand():
    """h = 3 on pixel (3, 0) of a 5 x 3 grid and 1 elsewhere: l = (15 (2, 1) + 2 (3, 0)) / 17."""
    network = LandmarkRegressor(1, (5, 3), n_filters=1).double()
    with torch.no_grad():
        for w in network.parameters():
            w.zero_()
        for conv in (network.conv1, network.conv2, network.conv3):
            conv.weight[0, 0, 1, 1] = 1
        network.heatmap.weight[:] = 1
    volume = torch.zeros(1, 3, 5, dtype=torch.float64)
    volume[0, 0, 3] = torch.log(torch.tensor(3.0, dtype=torch.float64))
    assert network(volume).tolist() == pytest.approx([36 / 17, 15 / 17])
    # An exponent of 1e5 does not overflow: all the weight on that pixel.
    assert network(volume * 1e5).tolist() == pytest.approx([3, 0])


@pytest.mark.parametrize(
    "options",
    [
        {"landmark": "center", "polarity": "split"},
        {"landmark": "line", "polarity": "unsigned", "remove_flow": True},
        {"landmark": "window"},
        {"transform": "none"},
    ],
    ids=str,
)
def test_pipeline_is_volume_then_classifier(options):
    classifier = Classifier(10 if options.get("polarity") == "split" else 5, (9, 8), n_classes=3)
    pipeline = Pipeline(classifier, **SETTINGS, grid=(9, 8), **options)
    *events, start_us = window()
    at = dict(start_us=start_us, window_us=5_000, sensor=(12, 10), grid=(9, 8), bins=5)
    if "transform" in options:
        volume = event_volume(*events, **at)
    else:
        volume = tnt_volume(*events, **at, t_max=2.0, **options)
    assert volume.abs().sum() > 10
    assert torch.equal(pipeline.volume(*window()), volume)
    torch.testing.assert_close(pipeline(*window()), classifier(volume))


def test_batch_equals_one_by_one_and_may_hold_empty_windows():
    regressor = LandmarkRegressor(5, (12, 10), n_filters=4)
    for settings in ({"landmark": "regressor", "regressor": regressor}, {"landmark": "line"}):
        pipeline = Pipeline(Classifier(5, (12, 10)), **SETTINGS, **settings)
        windows = [window(0), ([], [], [], [], 77), window(2, n=1), window(3, start_us=9)]
        together = pipeline.batch(windows)
        assert together.isfinite().all()
        torch.testing.assert_close(together, torch.stack([pipeline(*w) for w in windows]))


def test_a_window_without_a_length_ends_with_its_newest_event():
    *events, start_us = window()
    newest = int(events[0].max()) - start_us
    for name in ("running", "line"):
        made = {}
        for window_us in (None, newest):
            pipeline = Pipeline(
                torch.nn.Identity(), **SETTINGS | {"window_us": window_us}, landmark=name
            )
            made[window_us] = pipeline.volume(*events, start_us)
        assert torch.equal(made[None], made[newest])
        assert made[None][-1].abs().sum() > 0  # the newest event lies in the last bin


def test_what_a_pipeline_gives_has_the_form_and_type_of_its_classifier():
    class Two(torch.nn.Module):
        def forward(self, volume):
            return volume.sum((1, 2, 3)), 2 * volume

    total, twice = Pipeline(Two(), **SETTINGS)(*window())
    assert total.shape == () and twice.shape == (5, 10, 12) and twice.dtype == torch.float32
    both = Pipeline(Two(), **SETTINGS).batch([window(), window(1)])
    assert [tensor.shape[0] for tensor in both] == [2, 2]
    classifier = Classifier(5, (12, 10)).double()
    assert Pipeline(classifier, **SETTINGS).volume(*window()).dtype == torch.float64


def test_training_changes_all_weights_of_layers_but_means_and_variances():
    layers = [
        {
            "op": "batch_norm",
            "name": "norm",
            "inputs": ["volume"],
            "epsilon": 1e-5,
            "weights": {role: role for role in ("mean", "variance", "weight", "bias")},
        },
        {"op": "prelu", "name": "bends", "inputs": ["norm"], "weights": {"slope": "slope"}},
        {
            "op": "conv",
            "name": "conv",
            "inputs": ["bends"],
            "stride": (1, 1),
            "padding": (0, 0, 0, 0),
            "dilation": (1, 1),
            "groups": 1,
            "weights": {"weight": "kernel", "bias": "added"},
        },
    ]
    tensors = {name: torch.rand(3) + 0.5 for name in ("mean", "variance", "weight", "bias")}
    tensors |= {"slope": torch.rand(3), "kernel": torch.rand(2, 3, 2, 2), "added": torch.rand(2)}
    network = LayerNetwork(layers, tensors).train()
    step = torch.optim.SGD(network.parameters(), lr=0.1)
    network(torch.randn(2, 3, 4, 5)).square().sum().backward()
    step.step()
    unchanged = [name for name, given in tensors.items() if network.tensors[name].equal(given)]
    assert unchanged == ["mean", "variance"]


def test_the_line_of_many_events_is_that_of_each_prefix():
    """Prefixes are computed some hundred at a time."""
    t, x, y, _, start_us = window(n=700)
    at = dict(start_us=start_us, window_us=5_000, sensor=(12, 10), grid=(12, 10))
    whole = landmark("line", t, x, y, **at)
    for n in (1, 90, 93, 94, 95, 300, 700):
        prefix = landmark("line", t[:n], x[:n], y[:n], **at)
        torch.testing.assert_close(whole[n - 1], prefix[-1], rtol=0, atol=1e-9)
