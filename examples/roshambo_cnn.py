"""RoShamBo: rock, scissors, paper or background, by a CNN whose weights are published.

    python examples/roshambo_cnn.py model/numpy_weights roshambo.safetensors
    python examples/roshambo_cnn.py model/numpy_weights roshambo.safetensors throws.aedat4

The folder model/numpy_weights is in SensorsINI/dextra-roshambo-python on GitHub (commit 2247023).
That repository names no licence. The second command also prints what recordings of a DAVIS show.

The network sees the counts of 5,000 events of both polarities, on 64x64 pixels. Its weights are
whole numbers of 16 bits, with a number of binary digits behind the point for each layer. Its first
layers here make the published image of the counts, so the model can be used on any stream of events
that `on_64x64` has scaled. The published program uses a camera that filters noise, and leaves
frames out when it is late; this program does neither.

This was tried with the published weights: on the 360 images of sample_frames, beside them, the
model's answers are those of the published layers. We know no published accuracy of these weights,
and had no labelled recordings to measure it. The older network roshambo-v1.pb of jAER, which pools
by the maximum, was not tried.

References
----------
Lungu, Corradi, Delbruck 2017, Live Demonstration: Convolutional Neural Network Driven by Dynamic
Vision Sensor Playing RoShamBo, ISCAS: the data that the network was trained on. Its layers are in
RoshamboNet.py of that repository, the image in producer.py and consumer.py, and the order of the
classes in globals_and_utils.py.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from torch import nn

import async_tnt
from async_tnt.sources import open_recording

SIDE = 64  # pixels of the image, in width and height
WINDOW_EVENTS = 5_000  # for a DAVIS; the published program has 1,500 for a DVS128
MOST = 16  # events of a pixel; more of them count as 16
CLASSES = ("paper", "scissors", "rock", "background")

# shapes of the weights: (height, width, inputs, outputs) of convolutions, (inputs, outputs) at last
KERNELS = (
    (5, 5, 1, 16),
    (3, 3, 16, 32),
    (3, 3, 32, 64),
    (3, 3, 64, 128),
    (1, 1, 128, 128),
    (128, 4),
)

EXPECTED = (
    "expected model/numpy_weights of https://github.com/SensorsINI/dextra-roshambo-python, with "
    "layer1_kernel.npy and others"
)


class CountsToImage(nn.Module):
    """Counts c of events -> floor(255 min(c, 16) / 16) / 256.

    That is (16 c - 1) / 256 for c from 1 to 16: the first event adds 15, the next ones add 16.
    """

    def forward(self, counts: torch.Tensor) -> torch.Tensor:  # (N, 1, 64, 64), as is the image
        first = counts.clamp(0, 1)
        others = (counts - 1).clamp(0, MOST - 1)
        return (15 * first + 16 * others) / 256


def read_whole_numbers(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """An array of a file, which must have this shape and hold whole numbers."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; {EXPECTED}")
    try:
        with path.open("rb") as file:
            numbers: np.ndarray = np.lib.format.read_array(file, allow_pickle=False)
    except ValueError:
        raise ValueError(f"{path}: no array of NumPy; {EXPECTED}") from None
    if numbers.dtype.kind != "i" or numbers.shape != shape:
        got = f"{numbers.dtype} of shape {numbers.shape}"
        raise ValueError(f"{path}: must be whole numbers of shape {shape}, got {got}; {EXPECTED}")
    return numbers


def read_weights(folder: str | Path) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Weights and biases of the layers, with axes in torch's order."""
    n = len(KERNELS)
    kernel_digits = read_whole_numbers(Path(folder, "shift_per_layer_kernel.npy"), (n,))
    bias_digits = read_whole_numbers(Path(folder, "shift_per_layer_bias.npy"), (n,))
    layers = []
    for k, shape in enumerate(KERNELS):
        kernel = read_whole_numbers(Path(folder, f"layer{k + 1}_kernel.npy"), shape)
        bias = read_whole_numbers(Path(folder, f"layer{k + 1}_bias.npy"), shape[-1:])
        # outputs and inputs come first in torch
        weight = kernel.transpose(3, 2, 0, 1) if kernel.ndim == 4 else kernel.T
        layers.append(
            (
                torch.tensor(weight * 2.0 ** -int(kernel_digits[k]), dtype=torch.float32),
                torch.tensor(bias * 2.0 ** -int(bias_digits[k]), dtype=torch.float32),
            )
        )
    return layers


def published_network(folder: str | Path) -> nn.Module:
    """The network of published weights: images (N, 1, 64, 64) -> logits (N, 4)."""
    layers = read_weights(folder)
    modules: list[nn.Module] = []
    for weight, bias in layers[:-1]:
        outputs, inputs, height, width = weight.shape
        convolution = nn.Conv2d(inputs, outputs, (height, width))
        convolution.load_state_dict({"weight": weight, "bias": bias})
        modules += [convolution, nn.ReLU(), nn.AvgPool2d(2)]
    weight, bias = layers[-1]
    dense = nn.Linear(weight.shape[1], weight.shape[0])
    dense.load_state_dict({"weight": weight, "bias": bias})
    return nn.Sequential(*modules, nn.Flatten(), dense)


def convert(folder: str | Path) -> async_tnt.Model:
    """The model of a folder of weights, for events on 64x64 pixels."""
    config = async_tnt.TNTConfig(
        sensor=(SIDE, SIDE),
        grid=(SIDE, SIDE),
        representation="count",
        polarity="unsigned",
        window_events=WINDOW_EVENTS,
    )
    network = nn.Sequential(CountsToImage(), published_network(folder))
    return async_tnt.Model.from_torch(network, config, CLASSES)


def on_64x64(events: np.ndarray, sensor: tuple[int, int]) -> np.ndarray:
    """A copy of events of a sensor (width, height), scaled to 64x64 pixels."""
    scaled = events.copy()
    for axis, side in zip(("x", "y"), sensor, strict=True):
        scaled[axis] = events[axis].astype(np.int64) * SIDE // side
    return scaled


def main(folder: str, out: str, *recordings: str) -> None:
    model = convert(folder)
    model.save(out)
    print(f"{out}: {model}")
    for path in recordings:
        recording = open_recording(path)
        if recording.sensor is None:
            raise ValueError(f"{path}: does not state its sensor; expected a recording of a DAVIS")
        packets = (on_64x64(packet, recording.sensor) for packet in recording)
        for decision in async_tnt.stream(packets, model):
            if decision.complete:
                time_ms = decision.time_us / 1000
                print(f"{time_ms:9.1f} ms  {decision.label} ({decision.probability:.0%})")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except (OSError, ValueError) as error:
        sys.exit(str(error))
