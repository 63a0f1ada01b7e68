"""Your own torch module on `TNTVolume.array`: here templates of ten digits, compared by cosine
similarity.

The templates are the first saccades of the ten bundled samples. The module then has to recognise
the same digits in their second and third saccades, which move in other directions. It mostly does
if the flow is removed from the volume, and does not on the plain event volume (`transform="none"`).
Ten recordings show how it is done; they say nothing about accuracy.
"""

import torch

import async_tnt
from async_tnt.sources import open_recording, sample_recordings

SACCADES_US = (0, 105_000, 210_000)


class NearestTemplate(torch.nn.Module):
    def __init__(self, volumes: torch.Tensor) -> None:  # (n_classes, C, H, W)
        super().__init__()
        self.register_buffer("templates", self.features(volumes))

    def features(self, volumes: torch.Tensor) -> torch.Tensor:
        # over time; (N, H W)
        return torch.nn.functional.normalize(volumes.sum(1).flatten(1), dim=1)

    def forward(self, volumes: torch.Tensor) -> torch.Tensor:  # (N, C, H, W) -> (N, n_classes)
        return self.features(volumes) @ self.templates.T


def volume_of(config: async_tnt.TNTConfig, digit: int, start_us: int) -> torch.Tensor:
    volume = async_tnt.TNTVolume(config)
    volume.open(start_us)
    for packet in open_recording(sample_recordings()[digit]):
        inside = (packet["t"] >= start_us) & (packet["t"] < start_us + config.window_us)
        volume.update(packet[inside])
    # `array` is a read-only view that the next event changes, and torch has no read-only tensors:
    # copy it.
    return torch.tensor(volume.array)


def volumes_of(config: async_tnt.TNTConfig, start_us: int) -> torch.Tensor:
    """One saccade of each digit."""
    return torch.stack([volume_of(config, digit, start_us) for digit in range(10)])


CONFIGS = {
    "flow removed": async_tnt.TNTConfig(
        landmark="line", remove_flow=True, t_max=2.0, polarity="unsigned"
    ),
    "no transform": async_tnt.TNTConfig(transform="none", polarity="unsigned"),
}
for name, config in CONFIGS.items():
    module = NearestTemplate(volumes_of(config, SACCADES_US[0]))
    right = 0
    with torch.no_grad():  # no training here: keep no graph
        for start_us in SACCADES_US[1:]:
            similarities = module(volumes_of(config, start_us))
            right += int((similarities.argmax(dim=1) == torch.arange(10)).sum())
    print(f"{name}: {right} of 20 saccades recognised")
