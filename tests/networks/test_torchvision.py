"""Networks of torchvision, with a stem for volumes, run after every event as torch runs them."""

import numpy as np
import pytest
import torch
from torch import nn

from async_tnt import Model, Processor, TNTConfig, TNTVolume
from async_tnt.sources.files.recording import open_recording, sample_recordings

torchvision = pytest.importorskip("torchvision", reason="torchvision is not installed")
CONFIG = TNTConfig(sensor=(34, 34), grid=(64, 64), bins=1, transform="none", landmark="center", polarity="split")


def swapped(module, activation):
    """The same network with another activation."""
    for name, part in module.named_children():
        if isinstance(part, nn.ReLU):
            setattr(module, name, activation())
        else:
            swapped(part, activation)
    return module


def with_a_stem(name):
    module = getattr(torchvision.models, name)(num_classes=10)
    if name == "resnet18":
        module.conv1 = nn.Conv2d(2, 64, 7, 2, 3, bias=False)
    else:
        first = module.features[0] if name == "vgg11_bn" else module.features[0][0]
        stem = nn.Conv2d(2, first.out_channels, 3, first.stride, 1, bias=first.bias is not None)
        if name == "vgg11_bn":
            module.features[0] = stem
        else:
            module.features[0][0] = stem
    return module


@pytest.mark.parametrize(
    "name, activation",
    [("resnet18", None), ("mobilenet_v2", None), ("vgg11_bn", None), ("resnet18", nn.SiLU), ("resnet18", nn.GELU)],
)
def test_after_every_event_it_is_within_1e_4_of_torch(name, activation):
    torch.manual_seed(0)
    module = with_a_stem(name)
    module = module.eval() if activation is None else swapped(module, activation).eval()
    events = open_recording(sample_recordings()[7]).read()[:40]
    processor = Processor(Model.from_torch(module, CONFIG, "0123456789"), every_events=1)
    volume = TNTVolume(CONFIG)
    volume.open(int(events["t"][0]))
    for k, decision in enumerate(processor.push(events)):
        volume.update(events[k : k + 1])
        with torch.no_grad():
            expected = module(torch.tensor(volume.array)[None])[0].numpy()
        assert np.abs(decision.logits - expected).max() <= 1e-4 * np.abs(expected).max()
