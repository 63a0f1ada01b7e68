"""async-tnt export: a model's classifier as an ONNX file."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from async_tnt.cli.options import model_of
from async_tnt.cli.output import say
from async_tnt.files import Replacement, check_writable, naming
from async_tnt.networks.loading import bundled_models
from async_tnt.networks.model import Model

DESCRIPTION = """Write a model's classifier to an ONNX file, for other programs and languages: input `volume`, float32,
(1, C, H, W); output `logits`, float32, (1, n_classes). The file also holds configuration, classes and training
record, so that `async-tnt run --model FILE.onnx` and `async_tnt.networks.OnnxClassifier` know how events become its
volume. A landmark network (landmark "regressor") has no such form: those models are not exported.

Before the file gets its name, onnxruntime runs it on windows of the bundled samples (or of made streams, where the
model is for another sensor): logits must agree with the compiled network's to 1e-4 (of the largest logit, where that
is above 1), and every class must be the same.

  async-tnt export digits --out digits.onnx         a bundled model
  async-tnt export mine.safetensors --out mine.onnx --json
  async-tnt run --model digits.onnx                 run it by onnxruntime

Needs onnx and onnxruntime (extra `onnx`). Exit code 0 if the file is written, 1 if it does not agree and nothing is
written, 2 for bad usage or bad input.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "model", metavar="MODEL", help=f"a bundled model ({', '.join(bundled_models())}) or a .safetensors file"
    )
    parser.add_argument("--out", required=True, type=Path, metavar="FILE.onnx", help="replaced if it exists")
    parser.add_argument("--json", action="store_true", help="one JSON object with files and differences")


def main(args: argparse.Namespace) -> int:
    from async_tnt.checking.agreement import compare_engines
    from async_tnt.networks.onnx_export import to_onnx
    from async_tnt.networks.onnx_network import OnnxClassifier, import_onnxruntime

    check_writable(args.out, (".onnx",))
    model = model_of(args)
    if model.config.needs_regressor:
        raise ValueError(
            f"{args.model} has a landmark network, which has no ONNX form; its classifier alone runs by onnxruntime: "
            "Processor(model, classifier=OnnxClassifier(to_onnx(model)))"
        )
    onnxruntime = import_onnxruntime()  # now, so that a missing one shows before any work
    content = to_onnx(model).SerializeToString()
    file = Replacement(args.out)
    try:
        with naming(args.out):
            file.part.write_bytes(content)
        agreement = compare_engines(model, OnnxClassifier(file.part))  # read back: what is checked is what is kept
        if agreement.holds:
            file.complete()
    finally:
        file.discard()
    report = {
        "model": args.model,
        "agrees": agreement.holds,
        "files": {str(args.out): len(content)} if agreement.holds else {},
        "windows": agreement.logits.n,
        "recordings": agreement.recordings,
        "largest_logit_difference": agreement.logits.worst,
        "classes_that_differ": agreement.n_differ,
        "onnxruntime": onnxruntime.__version__,
    }
    say(json.dumps(report)) if args.json else _print(report, model)
    return 0 if agreement.holds else 1


def _print(report: dict[str, Any], model: Model) -> None:
    logits = (len(model.classes),) if model.places is None else model.logits_shape
    for path, n_bytes in report["files"].items():
        say(f"{path} ({n_bytes / 1e3:.0f} kB): volume {(1, *model.config.shape)} -> logits {(1, *logits)}")
    say(
        f"onnxruntime {report['onnxruntime']} against the compiled network, {report['windows']} windows of "
        f"{report['recordings']}: logits within {report['largest_logit_difference']:.2g} of the largest, "
        f"{report['classes_that_differ'] or 'no'} classes differ"
    )
    if not report["agrees"]:
        say("it does NOT agree: nothing is written")
