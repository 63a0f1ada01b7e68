"""async-tnt export: a model's network as an ONNX file or a NIR graph, and models of NIR graphs."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from async_tnt.base.extras import needs_extra
from async_tnt.base.files import check_writable, replacing, user_path
from async_tnt.base.messages import one_line
from async_tnt.cli.options import MODELS_TEXT, model_of, positive_int, positive_number
from async_tnt.cli.output import say
from async_tnt.networks.layers.conversion_check import Function, compare
from async_tnt.networks.models.compiled_network import CompiledNetwork, compiled_network_of
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.nir_export import to_nir
from async_tnt.networks.spiking.operations import RESETS
from async_tnt.volume.config import WINDOW_US

DESCRIPTION = """\
Write a model's network to an ONNX file, for other programs and languages.

  input   `volume`, float32, (1, C, H, W)
  output  `logits`, float32, (1, n_classes); of a map model (1, n_classes + 1, R, C);
          of a model of raw outputs these, with their names

The file also holds configuration, classes and training record. So
`async-tnt run --model FILE.onnx` and `async_tnt.networks.OnnxClassifier` know how
events become its volume. A model with a landmark network (landmark "regressor") has no
such form and is not exported.

Before the file gets its name, onnxruntime runs it on sparse, dense and empty volumes.
All outputs must agree with the compiled network's to 1e-4 of the largest number.

  async-tnt export digits --out digits.onnx         a bundled model
  async-tnt export mine.safetensors --out mine.onnx --json
  async-tnt run --model digits.onnx                 run it by onnxruntime

A model is also written as a NIR graph, and a NIR graph of another simulator becomes a
spiking model. A graph leaves some things open, which the options say. NIR has no ReLU: in
the graph of a network of ReLUs neurons with a threshold of 1 stand for them, and its
metadata say so.

  async-tnt export spiking.safetensors --out spiking.nir
  async-tnt export digits --out digits.nir          ReLUs, average poolings, dense layers
  async-tnt export net.nir --reset subtract --out net.safetensors
  async-tnt run a.npz --model net.safetensors

Needs onnx and onnxruntime (extra `onnx`), or nir (extra `nir`). Exit code 0 if the file
is written, 1 if ONNX does not agree and nothing is written, 2 for bad usage or bad input.
"""

FROM_NIR = ("reset", "dt", "polarity", "classes", "window_us")
"""The options for a NIR graph. They are parameters of `Model.from_nir`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("model", metavar="MODEL", help=f"{MODELS_TEXT}, or a .nir graph")
    parser.add_argument(
        "--out",
        required=True,
        type=user_path,
        metavar="FILE",
        help="FILE.onnx; FILE.nir; FILE.safetensors of a .nir graph. It is replaced if it exists",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object")
    group = parser.add_argument_group("NIR graphs")
    group.add_argument(
        "--reset",
        choices=RESETS,
        help="what a spike does to the membrane: it takes the threshold from it (sinabs), or sets "
        "it to v_reset (Norse)",
    )
    group.add_argument(
        "--dt",
        type=positive_number,
        metavar="S",
        help="the time step, in seconds, of the program that trained leaky neurons",
    )
    group.add_argument(
        "--polarity",
        choices=("off_first", "on_first"),
        help="the order of the two input channels (default: off_first)",
    )
    group.add_argument(
        "--classes", type=_names, metavar="A,B,...", help="class names (default: raw outputs)"
    )
    group.add_argument(
        "--window-us",
        type=positive_int,
        metavar="US",
        help=f"length of a window, in microseconds (default: {WINDOW_US:,})",
    )


def _names(text: str) -> list[str]:
    """Read names that commas separate. This is an argparse type."""
    return [name.strip() for name in text.split(",")]


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt export`. Returns the exit code."""
    given = {name: value for name in FROM_NIR if (value := getattr(args, name)) is not None}
    if Path(args.model).suffix.lower() == ".nir":
        return _model_of_nir(args, given)
    if args.out.suffix.lower() == ".nir":
        polarity = given.pop("polarity", None)
        _refuse(given, args)
        return _write_nir(args, polarity)
    _refuse(given, args)
    return _write_onnx(args)


def _refuse(given: dict[str, Any], args: argparse.Namespace) -> None:
    """Refuse options for a NIR graph where there is none."""
    if given:
        option = "--" + next(iter(given)).replace("_", "-")
        raise ValueError(f"{option} is for a .nir graph, got {args.model}")


def _model_of_nir(args: argparse.Namespace, given: dict[str, Any]) -> int:
    """Write the model file of a NIR graph."""
    check_writable(args.out, (".safetensors",))
    model = Model.from_nir(args.model, **given)
    path = model.save(args.out)
    if args.json:
        report: dict[str, Any] = {"files": {str(path): path.stat().st_size}}
        if model.is_spiking:
            report["neurons"] = model.n_neurons
        say(json.dumps(report))
    else:
        say(f"{path} ({path.stat().st_size / 1e3:.0f} kB): {model}")
    return 0


def _write_nir(args: argparse.Namespace, polarity: Any) -> int:
    """Write the NIR graph of a model."""
    check_writable(args.out, (".nir",))
    with needs_extra("nir", "NIR graphs are written by nir"):
        import nir
    graph = to_nir(model_of(args.model), polarity=polarity)
    with replacing(args.out) as part:
        nir.write(part, graph)
    size = args.out.stat().st_size
    if args.json:
        say(json.dumps({"files": {str(args.out): size}, "nodes": len(graph.nodes)}))
    else:
        say(f"{args.out} ({size / 1e3:.0f} kB): {len(graph.nodes)} nodes")
    return 0


def _write_onnx(args: argparse.Namespace) -> int:
    """Write a model's network to an ONNX file, and compare the two."""
    from async_tnt.networks.onnx.export import exported_shapes, to_onnx
    from async_tnt.networks.onnx.network import import_onnxruntime, output_function

    check_writable(args.out, (".onnx",))
    model = model_of(args.model)
    if model.config.needs_regressor:
        raise ValueError(
            f"{args.model} has a landmark network, which has no ONNX form; its classifier alone "
            "runs by onnxruntime: Processor(model, classifier=OnnxClassifier(to_onnx(model)))"
        )
    # imported before any work, in case onnxruntime is missing
    version = import_onnxruntime().__version__

    content = to_onnx(model).SerializeToString()
    difference = None
    try:
        with replacing(args.out) as part:
            part.write_bytes(content)
            # the check reads the file itself, because the file is what is kept
            compare(output_function(part), _compiled_function(model), model.config.shape)
    except ValueError as error:
        difference = one_line(error)
    agrees = difference is None

    if args.json:
        report = {
            "agrees": agrees,
            "difference": difference,
            "files": {str(args.out): len(content)} if agrees else {},
            "onnxruntime": version,
        }
        say(json.dumps(report))
    elif agrees:
        shapes = exported_shapes(model).items()
        outputs = ", ".join(f"{name} {(1, *shape)}" for name, shape in shapes)
        size = f"{args.out} ({len(content) / 1e3:.0f} kB)"
        say(f"{size}: volume {(1, *model.config.shape)} -> {outputs}")
        say(f"onnxruntime {version} agrees with the compiled network")
    else:
        say(
            f"onnxruntime {version} does NOT agree with the compiled network, nothing is written: "
            f"{difference}"
        )
    return 0 if agrees else 1


def _compiled_function(model: Model) -> Function:
    """The compiled network of a model, as a function of a volume to all outputs."""
    network = compiled_network_of(model)
    if isinstance(network, CompiledNetwork):
        return network
    return lambda volume: [network(volume)]
