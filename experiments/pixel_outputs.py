"""Flow at every pixel after every event, on sensors of three sizes, beside ONNX Runtime.

    python -m experiments.pixel_outputs [--quick] [--json FILE]

The network is FireFlowNet (Paredes-Valles et al. 2021) with random weights: seven convolutions at
full size, and a vector for each pixel. An event changes its neighbourhood only, so its answer costs
about the same on any sensor. As in `experiments.zoo`, the outputs must have the bits of a whole
pass after each of 30 events, and an event and a whole pass of ONNX Runtime take turns.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

if __name__ == "__main__":  # libraries read these variables when they are imported
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")

import torch

from async_tnt.base.progress import progress
from experiments.published.trial import tried
from experiments.published.zoo_list import entries
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed.timing import machine

NETWORK = "fire_flow_net"
"""Name in the list of published networks."""

SENSORS = ((128, 96), (346, 260), (640, 480))
"""Width and height of the sensors, in pixels: the last two are those of a DAVIS346 and of VGA."""


def measure(quick: bool) -> dict[str, Any]:
    """The numbers of each sensor, see `tried`.

    quick : take the smallest sensor only.
    """
    torch.set_num_threads(1)
    sensors = SENSORS[:1] if quick else SENSORS
    (entry,) = (one for one in entries() if one.name == NETWORK)
    report: dict[str, Any] = {"machine": machine("torch", "onnxruntime"), "sensors": {}}
    with progress(len(sensors), "sensors") as bar:
        for width, height in sensors:
            channels = entry.shape[0]
            of_sensor = replace(entry, shape=(channels, height, width))
            report["sensors"][f"{width}x{height}"] = tried(of_sensor)
            bar.update()
    return report


def main(argv: list[str] | None = None) -> int:
    """Measure, print the table, and write the report."""
    parser = script_parser("pixel_outputs", __doc__, "the smallest sensor only")
    return run_script(parser, argv, measure, "pixel_outputs")


if __name__ == "__main__":
    exit_with(main)
