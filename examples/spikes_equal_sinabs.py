"""The spikes of a NIR graph, event by event here and in time steps of sinabs: the same.

    python examples/spikes_equal_sinabs.py cnn_sinabs.nir a.bin [--events N]

The graph is a chain of Conv2d, IF, SumPool2d, Flatten and Affine or Linear nodes, such as the
network of the NIR paper for N-MNIST. sinabs gets one event in each time step, in float64. It needs
`pip install '.[nir,train]'` and sinabs, which wants an older nir than this package:

    pip install --no-deps sinabs==3.1.3 pbr==7.1.3
"""

import argparse

import nir
import numpy as np
import sinabs.layers
import torch
from torch import nn

import async_tnt
from async_tnt.sources import open_recording


def sinabs_network(graph: nir.NIRGraph) -> tuple[nn.Sequential, list[nn.Module]]:
    """The graph as a network of sinabs, and its layers of neurons."""
    following = dict(graph.edges)
    name = next(name for name, node in graph.nodes.items() if isinstance(node, nir.Input))
    layers: list[nn.Module] = []
    while (name := following[name]) in following:
        layers.append(module_of(graph.nodes[name]))
    neurons = [layer for layer in layers if isinstance(layer, sinabs.layers.IAFSqueeze)]
    return nn.Sequential(*layers).double(), neurons


def module_of(node: nir.NIRNode) -> nn.Module:
    """A node as a module."""
    if isinstance(node, nir.IF):
        # sinabs.from_nir would keep membranes at -1 at least, which the graph does not say
        return sinabs.layers.IAFSqueeze(
            batch_size=1, spike_threshold=torch.tensor(node.v_threshold), min_v_mem=None
        )
    if isinstance(node, nir.SumPool2d):
        return sinabs.layers.SumPool2d(tuple(node.kernel_size), tuple(node.stride))
    if isinstance(node, nir.Flatten):
        return nn.Flatten()
    weight = torch.tensor(node.weight)
    if isinstance(node, nir.Conv2d):
        n_out, n_in, *kernel = weight.shape
        stride, padding = tuple(node.stride), tuple(node.padding)
        module: nn.Module = nn.Conv2d(n_in, n_out, kernel, stride, padding, bias=False)
    else:
        module = nn.Linear(weight.shape[1], weight.shape[0], bias=False)
    module.weight.data = weight
    return module


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph", help="a .nir file")
    parser.add_argument("recording", help="a recording of the graph's sensor")
    parser.add_argument("--events", type=int, default=1_000, help="number of events")
    args = parser.parse_args()

    model = async_tnt.Model.from_nir(args.graph, reset="subtract", window_us=3_600_000_000)
    network, neurons = sinabs_network(nir.read(args.graph))
    events = open_recording(args.recording, sensor=model.config.sensor).read()[: args.events]
    volume = async_tnt.SpikingVolume(model)
    width, height = model.config.sensor

    torch.set_default_dtype(torch.float64)  # of sinabs' membranes
    totals = np.zeros(len(neurons))
    with torch.inference_mode():
        for number, (t, x, y, p) in enumerate(events.tolist()):
            volume.update_one(t, x, y, p)
            step = torch.zeros(1, 2, height, width, dtype=torch.float64)
            step[0, p, y, x] = 1.0  # channel 0 is OFF
            for layer in network:
                step = layer(step).double()  # sinabs returns spikes in float32
                if layer in neurons:
                    totals[neurons.index(layer)] += float(step.sum())
            own = [volume.spikes(layer) for layer in volume.network.layers]
            if own != totals.tolist():
                print(f"event {number}: spikes of the layers so far {own}, in sinabs {totals}")
                return
    by_layer = ", ".join(f"{layer}: {volume.spikes(layer):,}" for layer in volume.network.layers)
    print(f"{len(events):,} events, the same spikes after each of them; by layer {by_layer}")


if __name__ == "__main__":
    main()
