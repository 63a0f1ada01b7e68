"""async-tnt export: a model's network as an ONNX file."""

from __future__ import annotations

import argparse
import json

from async_tnt.base.files import check_writable, replacing, user_path
from async_tnt.base.messages import one_line
from async_tnt.cli.options import MODELS_TEXT, model_of
from async_tnt.cli.output import say
from async_tnt.networks.layers.conversion_check import Function, compare
from async_tnt.networks.models.compiled_network import CompiledNetwork, compiled_network_of
from async_tnt.networks.models.model import Model

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

Needs onnx and onnxruntime (extra `onnx`). Exit code 0 if the file is written, 1 if it
does not agree and nothing is written, 2 for bad usage or bad input.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("model", metavar="MODEL", help=MODELS_TEXT)
    parser.add_argument(
        "--out", required=True, type=user_path, metavar="FILE.onnx", help="replaced if it exists"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object")


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt export`. Returns the exit code."""
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
