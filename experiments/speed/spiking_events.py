"""Time of an event in a spiking network, by what any commit since the first such network has.

    python experiments/speed/spiking_events.py GRAPH RECORDING ... [--rounds N]

`experiments.between_commits` starts it with the package of one checkout or the other. Prints JSON:
microseconds of processor time an event, in the median over recordings, without decisions and with
one after each event.
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np

from async_tnt import Model, Processor, open_recording

WINDOW_US = 1_000_000
"""Length of a window, which holds a whole recording of N-MNIST."""


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("graph")
    parser.add_argument("recordings", nargs="+")
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    raw = Model.from_nir(args.graph, reset="subtract")
    (n_classes,) = next(iter(raw.output_shapes.values()))
    classes = [str(k) for k in range(n_classes)]
    model = Model.from_nir(args.graph, classes=classes, reset="subtract", window_us=WINDOW_US)
    packets = [open_recording(path).read() for path in args.recordings]
    cases = {
        "us_an_event": Processor(model),
        "us_an_event_and_decision": Processor(model, every_events=1),
    }
    times: dict[str, list[float]] = {name: [] for name in cases}
    for round_number in range(args.rounds + 1):
        for events in packets:
            for name, processor in cases.items():
                processor.reset()
                began = time.process_time()
                processor.push(events)
                took = time.process_time() - began
                if round_number:  # the first one warms up
                    times[name].append(1e6 * took / len(events))
    print(json.dumps({name: float(np.median(values)) for name, values in times.items()}))


if __name__ == "__main__":
    main()
