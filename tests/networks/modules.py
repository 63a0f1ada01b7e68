"""A torch module to convert, and what it computes."""

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional as F

from async_tnt import TNTConfig

CONFIG = TNTConfig(sensor=(20, 18), grid=(20, 18), bins=3)


class Block(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.norm1 = nn.BatchNorm2d(channels)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)
        self.norm2 = nn.BatchNorm2d(channels, affine=False)

    def forward(self, x):
        y = F.relu(self.norm1(self.conv1(x)))
        return torch.relu(self.norm2(self.conv2(y)) + x)


class Branches(nn.Module):
    """A module with residual blocks, a concatenation, a mean and a view.

    It has methods, functions and modules. One module has the name of a function.
    """

    def __init__(self):
        super().__init__()
        self.stem = nn.Sequential(
            nn.BatchNorm2d(3), nn.Conv2d(3, 6, 5, stride=2, padding=2), nn.ReLU6()
        )
        self.block = Block(6)
        self.pool = nn.MaxPool2d(3, 2, 1)
        self.mul = nn.Conv2d(12, 12, (3, 2), groups=12, padding="same")
        self.drop = nn.Dropout2d(0.5)
        self.head = nn.Sequential(
            nn.Linear(12, 7), nn.BatchNorm1d(7), nn.LeakyReLU(), nn.Dropout(), nn.Linear(7, 4)
        )

    def forward(self, x):
        x = self.pool(self.block(self.stem(x)))
        x = torch.cat([x, self.block(x).clamp(min=0.1)], 1)
        x = F.max_pool2d(F.leaky_relu(self.mul(x * 2), 0.2), kernel_size=2)
        x = F.dropout(self.drop(x), training=self.training).mean((2, 3))
        return self.head(x.reshape(shape=(x.size(0), -1)))


def branches():
    """A module of branches, with random weights and statistics."""
    torch.manual_seed(0)
    module = Branches()
    for part in module.modules():
        if isinstance(part, (nn.BatchNorm1d, nn.BatchNorm2d)):
            part.running_mean.uniform_(-1, 1)
            part.running_var.uniform_(0.5, 2)
            if part.weight is not None:
                nn.init.uniform_(part.weight, -1, 1)
                nn.init.uniform_(part.bias, -1, 1)
    return module


VOLUMES = np.random.default_rng(0).normal(size=(3, *CONFIG.shape)).astype(np.float32)


def logits_of(module, volumes=VOLUMES):
    with torch.no_grad():
        return module.eval()(torch.tensor(volumes)).numpy()


EVEN_KERNEL = pytest.mark.filterwarnings("ignore:Using padding='same' with even kernel")
