"""The two CNNs for N-MNIST of the NIR paper's code, from their published weights.

    python examples/nir_cnn.py pretrained_ann_weights.pth nir.safetensors N-MNIST/Test
    async-tnt run 3 --model nir.safetensors --every-events 500

The weights are in neuromorphs/NIR on GitHub (commit 7232ada, BSD-3-Clause), in the folder
paper/02_cnn/ann_pretraining:

pretrained_ann_weights.pth     The network that the paper makes its spiking network of. Its layers
                               are in paper/02_cnn/README.md.
checkpoints/cnn-step=7030-epoch=04-valid_loss=0.06-valid_acc=0.98.ckpt
                               The network that cnn.py and train.py of that folder train.

Both see the counts of events of each pixel, and OFF is their first channel. Here ON is the first
channel, so the model has the first layer's weights with their channels swapped.

With N-MNIST's Test, or another folder `<digit>/<name>.bin`, the model is tested. Windows of 105 ms
follow each other from a recording's first event on. (The published ones are thirds of a recording,
whose end a stream does not know.) The class of a recording is that of the largest sum of its
windows' outputs, as the paper's code sums the spikes of its spiking network.

References
----------
Pedersen, Abreu, Jobst, Lenz, Fra, Bauer, Muir, Zhou, Vogginger, Heckel, Urgese, Shankar, Stewart,
Sheik, Eshraghian 2024, Neuromorphic intermediate representation: A unified instruction set for
interoperable brain-inspired computing, Nature Communications 15, 8122. The published numbers here
are from files of its repository: paper/02_cnn/*_accuracy.npy, of which cnn_plots.ipynb makes the
paper's table, and the checkpoint itself.
"""

import sys
import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch
from torch import nn

import async_tnt
from async_tnt.sources import open_recording


def convolution(
    inputs: int, outputs: int, kernel: int, stride: int = 1, padding: int = 0
) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, kernel, stride, padding, bias=False)


def sum_pooling() -> nn.Module:
    return nn.AvgPool2d(2, divisor_override=1)


def paper_network() -> nn.Sequential:
    """The network of pretrained_ann_weights.pth: counts (N, 2, 34, 34), OFF first -> (N, 10)."""
    return nn.Sequential(
        convolution(2, 16, 5, stride=2, padding=1),
        nn.ReLU(),
        convolution(16, 16, 3, padding=1),
        nn.ReLU(),
        sum_pooling(),
        convolution(16, 8, 3, padding=1),
        nn.ReLU(),
        sum_pooling(),
        nn.Flatten(),
        nn.Linear(4 * 4 * 8, 256, bias=False),
        nn.ReLU(),
        nn.Linear(256, 10, bias=False),
        nn.ReLU(),
    )


def checkpoint_network() -> nn.Sequential:
    """The network of the checkpoint: counts (N, 2, 34, 34), OFF first -> (N, 10)."""
    return nn.Sequential(
        convolution(2, 20, 5),
        nn.ReLU(),
        nn.AvgPool2d(2),
        convolution(20, 32, 5),
        nn.ReLU(),
        nn.AvgPool2d(2),
        convolution(32, 128, 3),
        nn.ReLU(),
        nn.AvgPool2d(2),
        nn.Flatten(),
        nn.Linear(128, 500, bias=False),
        nn.ReLU(),
        nn.Linear(500, 10, bias=False),
    )


# network -> accuracies that were published of it, on the official test
PUBLISHED = {
    paper_network: "none; its spiking network has .954 (Speck) to .985 (sinabs) of the recordings",
    checkpoint_network: ".982 of thirds of the recordings, on which its epoch was chosen",
}

EXPECTED = (
    "expected pretrained_ann_weights.pth or the .ckpt of paper/02_cnn/ann_pretraining in "
    "https://github.com/neuromorphs/NIR"
)


def read_weights(path: str | Path) -> dict[str, torch.Tensor]:
    """Tensors by name. Those of a Lightning checkpoint lose the prefix "model."."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such file; {EXPECTED}")
    if not zipfile.is_zipfile(path):  # torch.load also takes the models that this program writes
        raise ValueError(f"{path}: no file of torch weights; {EXPECTED}")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises errors of many types
        kind = type(error).__name__
        raise ValueError(f"{path}: torch cannot load it ({kind}); {EXPECTED}") from None
    if isinstance(content, dict):
        content = content.get("state_dict", content)
    if not isinstance(content, dict) or not all(
        isinstance(name, str) and torch.is_tensor(value) for name, value in content.items()
    ):
        raise ValueError(f"{path}: holds other things than weights; {EXPECTED}")
    return {name.removeprefix("model."): tensor for name, tensor in content.items()}


def read_network(path: str | Path) -> tuple[nn.Sequential, str]:
    """The published network, which sees OFF first, and what was published of it."""
    weights = read_weights(path)
    shapes = {name: tensor.shape for name, tensor in weights.items()}
    for make, published in PUBLISHED.items():
        network = make()
        if shapes == {name: tensor.shape for name, tensor in network.state_dict().items()}:
            network.load_state_dict(weights)
            return network, published
    first = [f", the first {name} {tuple(shape)}" for name, shape in shapes.items()][:1]
    got = f"{len(shapes)} tensors{''.join(first)}"
    raise ValueError(f"{path}: weights of another network, {got}; {EXPECTED}")


def on_first(network: nn.Sequential) -> nn.Sequential:
    """The same network for images whose first channel is ON. It changes the network itself."""
    weight = next(network.parameters())  # of the first layer: (outputs, 2, 5, 5)
    weight.data = weight.data.flip(1)
    return network


def convert(path: str | Path) -> tuple[async_tnt.Model, str]:
    """The model of a file of weights, and what was published of its network."""
    network, published = read_network(path)
    config = async_tnt.TNTConfig(representation="count", polarity="split")  # 34x34, 105 ms
    model = async_tnt.Model.from_torch(
        on_first(network), config, classes=list("0123456789"), record={"weights": Path(path).name}
    )
    return model, published


def count_right(model: async_tnt.Model, paths: Iterable[Path]) -> dict[str, int]:
    """The numbers of windows and of recordings, and how many are right.

    paths : recordings `<digit>/<name>.bin`.
    """
    counts = dict.fromkeys(("windows", "windows_right", "recordings", "recordings_right"), 0)
    processor = async_tnt.Processor(model)
    for path in paths:
        digit = int(path.parent.name)
        decisions = processor.push(open_recording(path).read()) + processor.finish()
        processor.reset()
        outputs = np.sum([decision.logits for decision in decisions], axis=0)  # (10,)
        counts["windows"] += len(decisions)
        counts["windows_right"] += sum(decision.index == digit for decision in decisions)
        counts["recordings"] += 1
        counts["recordings_right"] += int(outputs.argmax()) == digit
    return counts


def main(weights: str, out: str, folder: str | None = None) -> None:
    model, published = convert(weights)
    model.save(out)
    print(f"{out}: {model}")
    print(f"published: {published}")
    if folder is None:
        return
    paths = sorted(Path(folder).glob("[0-9]/*.bin"))
    if not paths:
        raise FileNotFoundError(f"{folder}: no recordings; expected N-MNIST's <digit>/<name>.bin")
    counts = count_right(model, paths)
    for name in ("windows", "recordings"):
        share = counts[f"{name}_right"] / counts[name]
        print(f"{share:.4f} of {counts[name]:,} {name} are right")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except (OSError, ValueError) as error:
        sys.exit(str(error))
