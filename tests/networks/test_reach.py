"""How many multiplications one event reaches: by hand, and as a bound of what is computed."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made import raw_model
from networks.random_networks import random_models
from torch import nn

from async_tnt import CompiledClassifier, CompiledNetwork, Model, TNTConfig, TNTVolume
from async_tnt.cli.output import reach_text
from async_tnt.networks.layers.reach import Work
from experiments.speed.work import work_of

ON_PIXELS = TNTConfig(sensor=(21, 15), grid=(21, 15), bins=2, transform="none")


def computed(network):
    """The multiplications of the last call."""
    return sum(step.products * n for step, n in work_of(network))


def test_by_hand():
    """One pixel, seen by 3 x 3 places, then by 5 x 5; a half map sees 5 rows with 2 or 3."""
    net = nn.Sequential(
        nn.Conv2d(2, 4, 3, padding=1),
        nn.Conv2d(4, 6, 3, padding=1, groups=2),
        nn.AvgPool2d(2),
        nn.Conv2d(6, 1, 1),
    )
    work = Model.from_torch(net, ON_PIXELS).work_of_one_event
    # the middle pixel is (10, 7); rows 5 to 9 lie in 3 rows of the half map, columns 8 to 12, too
    assert work.touched == 9 * 4 * 18 + 25 * 6 * 18 + 3 * 3 * 6
    # the pooling does not read the last row and column of the second convolution
    assert work.whole == 15 * 21 * 4 * 18 + 14 * 20 * 6 * 18 + 7 * 10 * 6


@pytest.mark.parametrize(
    ("changes", "n_blocks"),
    [
        ({"grid": (13, 9)}, 4),  # rows 3 and 4, columns 5 and 6
        ({"transform": "tnt"}, 2),  # rows 6 and 7, columns 9 and 10
    ],
)
def test_an_event_between_pixels_changes_two_rows_and_two_columns(changes, n_blocks):
    """They are seen by 4 x 4 places, and by so many blocks of 2 x 2."""
    model = Model.from_torch(nn.Conv2d(2, 4, 3, padding=1), ON_PIXELS.replace(**changes))
    assert model.work_of_one_event.touched == 16 * 4 * 18
    halves = Model.from_torch(nn.Conv2d(2, 4, 2, stride=2), model.config)
    assert halves.work_of_one_event.touched == n_blocks * 4 * 8


def test_what_one_of_two_joined_maps_sees_reaches_on():
    """One sees the pixel at 3 x 3 places, the other one at a single place."""

    class Joined(nn.Module):
        def __init__(self):
            super().__init__()
            self.wide = nn.Conv2d(2, 4, 3, padding=1)
            self.narrow = nn.Conv2d(2, 4, 1)
            self.last = nn.Conv2d(8, 5, 1)

        def forward(self, x):
            return self.last(torch.cat([self.wide(x), self.narrow(x)], 1))

    work = Model.from_torch(Joined(), ON_PIXELS).work_of_one_event
    assert work.touched == 9 * 4 * 18 + 4 * 2 + 9 * 5 * 8


def test_a_mean_has_multiplications_where_each_place_has_weights_of_its_own():
    """There are 9 of them in 2 channels. A plain mean is a sum, and has none."""
    plain = Model.from_torch(nn.AvgPool2d(3), ON_PIXELS)
    adaptive = Model.from_torch(nn.AdaptiveAvgPool2d((5, 7)), ON_PIXELS)
    assert plain.output_shapes == adaptive.output_shapes == {"output": (2, 5, 7)}
    assert plain.work_of_one_event.whole == 0
    assert adaptive.work_of_one_event.whole == 2 * 35 * 9


def test_a_gate_of_all_places_makes_everything_new():
    class Gated(nn.Module):
        def __init__(self):
            super().__init__()
            self.conv = nn.Conv2d(2, 3, 1)
            self.last = nn.Conv2d(3, 5, 1)

        def forward(self, x):
            h = self.conv(x)
            return self.last(h * h.mean((2, 3), keepdim=True).sigmoid())

    work = Model.from_torch(Gated(), ON_PIXELS).work_of_one_event
    assert work.touched == 6 + 315 * 3 + 315 * 15
    assert reach_text(work).endswith(
        ": a decision after each event costs about as much as a whole pass"
    )


@pytest.mark.parametrize("seed", range(3))
def test_it_is_what_one_event_computes_where_nothing_ends_a_change(seed):
    torch.manual_seed(seed)
    net = nn.Sequential(
        nn.Conv2d(2, 3, (3, 2), stride=(1, 2), dilation=(2, 1), padding=(1, 0)),
        nn.Sigmoid(),
        nn.Conv2d(3, 16, 1),
        nn.PixelShuffle(2),
        nn.Conv2d(4, 2, 3),
    )
    model = Model.from_torch(net, ON_PIXELS)
    network = CompiledNetwork(model)
    volume = TNTVolume(ON_PIXELS)
    volume.open(0)
    network.refresh(volume)
    volume.update_one(10, 10, 7, 1)
    network.refresh(volume)
    assert computed(network) == model.work_of_one_event.touched
    network(volume.array)
    assert computed(network) == model.work_of_one_event.whole


@given(random_models(), st.integers(0, 99))
def test_it_is_never_less_than_what_one_event_computes(model, seed):
    config = model.config
    network = CompiledClassifier(model)
    volume = TNTVolume(config.replace(transform="none", landmark="center", remove_flow=False))
    volume.open(0)
    network.refresh(volume)
    middle = ((config.sensor[0] - 1) // 2, (config.sensor[1] - 1) // 2)
    volume.update_one(1 + seed, *middle, 1)
    network.refresh(volume)
    work = model.work_of_one_event
    # an even side has two middle pixels: the kernel may reach one more place from the other one
    assert computed(network) <= 1.6 * work.touched + 3000
    network(volume.array)
    assert computed(network) == work.whole


def test_in_words():
    assert reach_text(Work(1234, 100_000)) == (
        "reaches at most 1,234 multiplications, 1% of a whole pass"
    )
    assert reach_text(Work(5, 10_000)).endswith("5 multiplications, 0.1% of a whole pass")
    assert Work(0, 0).share == 0
    assert raw_model(ON_PIXELS).work_of_one_event.share < 0.2
