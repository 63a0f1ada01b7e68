"""The network `map` of `async-tnt train`, with two channels more, for the middles of boxes.

So it differs from `pyramid` by its levels and its layers, but not in what it says. For
`--network experiments/objects/one_level.py:one_level`.
"""

from torch import nn

from async_tnt.training.networks import object_map


def one_level(channels: int, grid: tuple[int, int], n_classes: int) -> nn.Module:
    """The network, see `training.networks.object_map`."""
    *layers, head = object_map(channels, grid, n_classes).children()
    assert isinstance(head, nn.Conv2d)
    return nn.Sequential(*layers, nn.Conv2d(head.in_channels, n_classes + 5, 1))
