"""A spiking network after every event: which neurons fire, layer by layer.

    python examples/spiking_network.py                                 a small made network
    python examples/spiking_network.py net.nir a.bin --reset subtract  a NIR graph and a recording

The made network has two neurons that count events, one in the left half of the sensor and one in
the right half. Its classes are the halves. Needs nir (extra `nir`).
"""

import argparse

import nir
import numpy as np

import async_tnt
from async_tnt.sources import open_recording, sample_recordings

STEP_US = 20_000
"""Time between two lines, in microseconds."""


def two_halves(side: int = 34) -> nir.NIRGraph:
    """Two integrate-and-fire neurons, one for each half of a square sensor."""
    is_left = np.arange(side) < side // 2
    halves = np.stack([is_left, ~is_left]).astype(np.float32)
    weight = np.broadcast_to(halves[:, None, None], (2, 2, side, side)).reshape(2, -1)
    return nir.NIRGraph.from_list(
        nir.Input({"input": np.array([2, side, side])}),
        nir.Flatten({"input": np.array([2, side, side])}, start_dim=0, end_dim=-1),
        nir.Linear(weight),
        # with a threshold of 9.5, a neuron fires once for ten events, or a little more often
        nir.IF(r=np.ones(2), v_threshold=np.full(2, 9.5)),
        nir.Output({"output": np.array([2])}),
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("graph", nargs="?", help="a .nir file")
    parser.add_argument("recording", nargs="?", help="a recording of the graph's sensor")
    parser.add_argument("--reset", choices=("subtract", "value"), default="subtract")
    parser.add_argument("--dt", type=float, help="time step of the training, in seconds")
    args = parser.parse_args()

    settings = {"reset": args.reset, "dt": args.dt, "window_us": 400_000}
    if args.graph:
        model = async_tnt.Model.from_nir(args.graph, **settings)
        n_outputs = next(iter(model.output_shapes.values()))[0]
        classes = [str(k) for k in range(n_outputs)]
        model = async_tnt.Model.from_nir(args.graph, classes=classes, **settings)
    else:
        model = async_tnt.Model.from_nir(two_halves(), classes=["left", "right"], **settings)
    path = args.recording or sample_recordings()[3]
    events = open_recording(path, sensor=model.config.sensor).read()

    # the answers of a stream
    for decision in async_tnt.stream(events, model, every_us=STEP_US):
        counts = " ".join(f"{count:4.0f}" for count in decision.logits)
        print(f"{decision.time_us:>9,} us  spikes {counts}  {decision.label}")

    # the neurons of a window
    volume = async_tnt.SpikingVolume(model)
    for event in events.tolist():
        volume.update_one(*event)
    print(f"\n{volume.n_events:,} events in the last window")
    for layer in volume.network.layers:
        spikes = volume.spikes(layer) / volume.n_events
        additions = volume.additions(layer) / volume.n_events
        print(f"layer {layer}: {spikes:.3f} spikes and {additions:.1f} additions an event")


if __name__ == "__main__":
    main()
