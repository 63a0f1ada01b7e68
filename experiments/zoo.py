"""Which published networks become compiled, incremental networks: from torch, and from ONNX?

    python -m experiments.zoo [NAME ...] [--list] [--json FILE]

The list is in `published/zoo_list.py`: networks of event-camera papers, and those that event-camera
work takes from torchvision, timm and segmentation-models-pytorch (`pip install
'async_tnt[zoo]'`). Each is built with random, calibrated weights, and read by `Model.from_torch`
and, exported by torch, by `load_model`. For a refused one there is the reason. An accepted one is
compared with torch in float64, and fed with events: after each of 30 the outputs must have the bits
of a whole pass. Then an event's answer and a whole pass of ONNX Runtime take turns, on one thread.
FILE keeps the entries of networks that this run does not try, so an interrupted run goes on when it
is given again.
"""

from __future__ import annotations

import argparse
from typing import Any

import torch

from async_tnt.base.progress import progress
from experiments.published.trial import tried
from experiments.published.zoo_list import Entry, entries
from experiments.scripts.options import (
    add_json,
    earlier_parts,
    exit_with,
    plain_parser,
    write_part,
)
from experiments.speed.timing import machine
from experiments.tables.published import counts, zoo_accepted


def main(argv: list[str] | None = None) -> int:
    """Try the networks, print the tables, and write the report."""
    parser = plain_parser("zoo", __doc__)
    every = {entry.name: entry for entry in entries()}
    parser.add_argument("names", nargs="*", metavar="NAME", help="networks (default: all)")
    parser.add_argument("--list", action="store_true", help="print the networks, and stop")
    add_json(parser)
    args = parser.parse_args(argv)
    if args.list:
        for entry in every.values():
            print(f"{entry.name:<50} {'x'.join(map(str, entry.shape))}")
        return 0
    unknown = [name for name in args.names if name not in every]
    if unknown:
        parser.error(f"no network {unknown[0]!r} in the list; see --list")
    report = _tried_networks([every[name] for name in args.names or every], args)
    for name, numbers in report.items():
        for way in ("torch", "onnx"):
            if numbers[way]:
                print(f"{name}, from {way}: {numbers[way]}")
    print(zoo_accepted(report), counts(report), sep="\n\n")
    return 0


def _tried_networks(wanted: list[Entry], args: argparse.Namespace) -> dict[str, Any]:
    """The report, with those of the networks `wanted` that it did not have before."""
    torch.set_num_threads(1)
    report = earlier_parts(args)
    with progress(len(wanted), "networks") as bar:
        for entry in wanted:
            if entry.name not in report or args.names:
                report[entry.name] = tried(entry)
                write_part(args, entry.name, {**report[entry.name], "machine": machine("torch")})
            bar.update()
    return report


if __name__ == "__main__":
    exit_with(main)
