"""Optical flow after every event, by a small network that is trained on simulated scenes.

    python -m examples.flow_per_event --out flow.safetensors       train and test it, 6 minutes
    python -m examples.flow_per_event --model flow.safetensors --picture flow.gif

Run it in a checkout, after `pip install -e '.[train,onnx]'`. The network, the scenes and the
training are in `examples/optical_flow`.

The model has raw outputs: `Processor.push` returns an `Output` for each event, whose array is the
flow at each pixel, in pixels per second. Test sequences show other kinds of pictures and motions
than the training. They are streamed event by event. After some events, drawn at random, the flow at
the event's pixel is compared with the true flow, which the simulation knows. The mean distance
between both, the endpoint error, is printed beside those of zero flow and of plane fits.

`async-tnt bench --model flow.safetensors` then says how many microseconds an event takes, and
`python -m experiments.flow` compares errors and times at length.
"""

import argparse
from pathlib import Path

import numpy as np

import async_tnt
from async_tnt.base.progress import progress
from examples.optical_flow.network import HOP_US
from examples.optical_flow.picture import draw_picture
from examples.optical_flow.plane_fit import PLANE_SETTINGS, POOLED_SETTINGS
from examples.optical_flow.scenes import UNSEEN
from examples.optical_flow.sequences import (
    TEST,
    KnownSequence,
    endpoint_errors,
    plane_way,
    pooled_way,
    sequences,
    zero_flow,
)
from examples.optical_flow.training import STEPS, train_flow

SEED = 0
"""Seed of the test sequences."""


def stream_flow(model: async_tnt.Model, sequence: KnownSequence) -> np.ndarray:
    """The network's flow right after each event that is compared: float64, (n, 2)."""
    model = model.for_sensor(sequence.sensor)
    # Windows last 30 ms, and a new one opens every 15 ms. The oldest open window answers.
    processor = async_tnt.Processor[async_tnt.Output](
        model, every_events=1, hop_us=HOP_US, start_us=0
    )
    compared = set(sequence.compared.tolist())
    flow = []
    for number, (t, x, y, p) in enumerate(sequence.events.tolist()):
        output = processor.push((t, x, y, p))[-1]
        if number in compared:
            # the array is a view, which the next event changes
            flow.append(output["output"][:, y, x].copy())
    return np.array(flow, np.float64).reshape(-1, 2)


def print_errors(model: async_tnt.Model, n_sequences: int, n_compared: int) -> None:
    """Print the endpoint errors of several ways to flow, on test sequences."""
    ways = {
        "network": lambda sequence: stream_flow(model, sequence),
        "zero flow": zero_flow,
        "plane fit": plane_way(PLANE_SETTINGS),
        "plane fits, pooled": pooled_way(POOLED_SETTINGS),
    }
    errors: dict[str, list[float]] = {name: [] for name in ways}
    n_events = 0
    with progress(n_sequences, "test sequences") as bar:
        for sequence in sequences(TEST, UNSEEN, n_sequences, n_compared, SEED):
            n_events += len(sequence.events)
            for name, way in ways.items():
                errors[name].append(endpoint_errors(way(sequence), sequence.true).mean())
            bar.update()
    print(
        f"{n_sequences} test sequences (seed {SEED}), {n_events:,} events, flow compared after up "
        f"to {n_compared} of each; mean endpoint error ± standard deviation over sequences:"
    )
    for name, values in errors.items():
        print(f"  {name:20}{np.mean(values):6.1f} ± {np.std(values):5.1f} px/s")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", metavar="FILE", help="a trained model, instead of training one")
    parser.add_argument("--steps", type=int, default=STEPS, help="steps of the training")
    parser.add_argument("--seed", type=int, default=0, help="seed of the training")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the trained model there")
    parser.add_argument("--sequences", type=int, default=10, help="number of test sequences")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw a .gif or .png")
    parser.add_argument("--quick", action="store_true", help="a few seconds: does it all run?")
    args = parser.parse_args()

    if args.model:
        model = async_tnt.load_model(args.model)
    else:
        model = train_flow(20 if args.quick else args.steps, args.seed)
    if args.out:
        print(f"model in {model.save(args.out)}")
    print(model)
    print_errors(model, 2 if args.quick else args.sequences, 20 if args.quick else 200)
    if args.picture:
        draw_picture(args.picture, model)


if __name__ == "__main__":
    main()
