"""Which published networks become compiled, incremental networks: from torch, and from ONNX?

    python -m experiments.zoo [NAME ...] [--list] [--json FILE]

The list is in `published/zoo_list.py`: networks of event-camera papers, and those that event-camera
work takes from torchvision, timm and segmentation-models-pytorch (`pip install
'async_tnt[zoo]'`). Each is built with random, calibrated weights, and taken by
`Model.from_torch`'s and by `Model.load`'s reader of ONNX. An accepted network computed what torch,
or ONNX Runtime, computed on random volumes; for a refused one there is the reason. FILE keeps the
entries of networks that this run does not try, so an interrupted run goes on when it is given
again.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from torch import nn

from async_tnt.base.progress import progress
from async_tnt.networks.onnx.from_onnx import layers_from_onnx
from async_tnt.networks.torch.from_torch import check_torch_layers, layers_from_torch
from experiments.published.build import build
from experiments.published.zoo_list import Entry, entries
from experiments.scripts.options import (
    add_json,
    earlier_parts,
    exit_with,
    plain_parser,
    write_part,
)
from experiments.speed.timing import machine

LONGEST = 300
"""Most characters of a reason."""

OPSET = 18
"""Version of ONNX's operators that networks are exported with."""


def tried(entry: Entry) -> dict[str, Any]:
    """What became of a network: the entry of the report.

    "torch" and "onnx" are empty if the network is accepted, and otherwise say why it is not.
    """
    started = time.monotonic()
    module = build(entry)
    numbers: dict[str, Any] = {
        "source": entry.source,
        "shape": entry.shape,
        "parameters": sum(parameter.numel() for parameter in module.parameters()),
        "torch": _reason(lambda: _from_torch(module, entry.shape)),
        "onnx": _reason(lambda: _from_onnx(module, entry.shape)),
    }
    return {**numbers, "seconds": round(time.monotonic() - started, 1)}


def _from_torch(module: nn.Module, shape: tuple[int, int, int]) -> None:
    check_torch_layers(module, layers_from_torch(module, shape), shape)


def _from_onnx(module: nn.Module, shape: tuple[int, int, int]) -> None:
    import onnx

    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter
        path = Path(folder) / "network.onnx"
        torch.onnx.export(
            module, (torch.zeros(1, *shape),), path, opset_version=OPSET, dynamo=False
        )
        layers_from_onnx(onnx.load(path), shape, has_classes=False)


def _reason(convert: Callable[[], object]) -> str:
    """Why a conversion is refused, in one line; empty if it is not."""
    try:
        convert()
    except (NotImplementedError, ValueError, TypeError, RuntimeError) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."
    return ""


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
    accepted = Counter(
        way for numbers in report.values() for way in ("torch", "onnx") if not numbers[way]
    )
    print(
        f"{len(report)} networks: {accepted['torch']} accepted from torch, {accepted['onnx']} from "
        "ONNX"
    )
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
