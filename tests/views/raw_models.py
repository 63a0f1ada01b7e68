"""Models of raw outputs whose outputs can be computed by hand."""

import torch
from torch import nn

from async_tnt import Model, TNTConfig

CONFIG = TNTConfig(
    sensor=(8, 6),
    grid=(8, 6),
    bins=1,
    polarity="unsigned",
    transform="none",
    landmark="center",
    window_us=50_000,
)
"""The volume is the number of events at each pixel."""


class Net(nn.Module):
    """The number n of events at each place, in several forms.

    flow : (n, n), right and down
    image : n
    parts/of a : 0.5 for channel 0, n for channel 1, 0 for channel 2
    total : the number N of all events, and -N
    many : 25 numbers k N
    """

    def __init__(self, config):
        super().__init__()
        _, height, width = config.shape
        self.mean = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Flatten())
        self.flow = _layer(nn.Conv2d(1, 2, 1), [1, 1])
        self.image = _layer(nn.Conv2d(1, 1, 1), [1])
        self.parts = _layer(nn.Conv2d(1, 3, 1), [0, 1, 0], [0.5, 0, 0])
        n_places = height * width
        self.total = _layer(nn.Linear(1, 2), [n_places, -n_places])
        self.many = _layer(nn.Linear(1, 25), [k * n_places for k in range(25)])

    def forward(self, volume):
        mean = self.mean(volume)
        return {
            "flow": self.flow(volume),
            "image": self.image(volume),
            "parts/of a": self.parts(volume),
            "total": self.total(mean),
            "many": self.many(mean),
        }


def _layer(layer, weights, bias=None):
    """The layer with these weights, one for each of its outputs."""
    with torch.no_grad():
        layer.weight[:] = torch.tensor(weights, dtype=torch.float32).reshape(layer.weight.shape)
        layer.bias[:] = torch.tensor(bias or [0.0] * len(weights))
    return layer


def raw_model(config=CONFIG):
    return Model.from_torch(Net(config), config)


def overflowing_model(config=CONFIG):
    """(inf, inf) at a place with events, and there nan in the image; 0 elsewhere."""

    class Overflowing(nn.Module):
        def __init__(self):
            super().__init__()
            self.large = _layer(nn.Conv2d(1, 2, 1), [3e38, 3e38])
            self.larger = nn.Conv2d(2, 2, 1)
            self.difference = nn.Conv2d(2, 1, 1)
            with torch.no_grad():
                self.larger.weight[:] = torch.tensor([[10.0, 0], [0, 10]])[:, :, None, None]
                self.larger.bias.zero_()
                self.difference.weight[:] = torch.tensor([[1.0, -1.0]])[:, :, None, None]
                self.difference.bias.zero_()

        def forward(self, volume):
            flow = self.larger(self.large(volume))
            return {"flow": flow, "image": self.difference(flow)}

    return Model.from_torch(Overflowing(), config)
