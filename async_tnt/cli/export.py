"""async-tnt export: a model's networks as ONNX files."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from async_tnt.cli.options import model_of
from async_tnt.cli.output import say
from async_tnt.files import Replacement, check_ours, check_writable, naming
from async_tnt.networks.loading import bundled_models
from async_tnt.networks.model import FORMAT, Model

DESCRIPTION = """Write a model's classifier to an ONNX file, for other programs and languages: input `volume`, float32,
(1, C, H, W); output `logits`, float32, (1, n_classes). The file also holds configuration, classes and training
record, so that `async-tnt run --model FILE.onnx` and `async_tnt.networks.OnnxClassifier` know how events become its
volume. A model with landmark "regressor" has a second network, which goes into FILE.regressor.onnx: input `volume`
without the transform, output `landmark`, float64, (1, 2), the (x, y) in grid pixels.

Before the files get their names, onnxruntime runs them on windows of the bundled samples (or of made streams, where
the model is for another sensor): logits must agree with the compiled network's to 1e-4 (of the largest logit, where
that is above 1), landmarks to 1e-4 pixels, and every class must be the same.

  async-tnt export digits --out digits.onnx         a bundled model
  async-tnt export mine.safetensors --out mine.onnx --json
  async-tnt run --model digits.onnx                 run it by onnxruntime

Needs onnx and onnxruntime (extra `onnx`). Exit code 0 if the files are written, 1 if they do not agree and nothing is
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
    from async_tnt.networks.engines import regressor_path
    from async_tnt.networks.onnx_export import regressor_to_onnx, to_onnx
    from async_tnt.networks.onnx_network import OnnxClassifier, OnnxRegressor, import_onnxruntime

    out: Path = args.out
    check_writable(out, (".onnx",))
    model = model_of(args)
    if model.config.needs_regressor:
        check_ours([regressor_path(out)], [FORMAT])
    onnxruntime = import_onnxruntime()  # now, so that a missing one shows before any work
    contents = {out: to_onnx(model).SerializeToString()}
    if model.config.needs_regressor:
        contents[regressor_path(out)] = regressor_to_onnx(model).SerializeToString()
    files: dict[Path, Replacement] = {}
    try:
        for path, content in contents.items():
            files[path] = Replacement(path)
            with naming(path):
                files[path].part.write_bytes(content)
        # read back from the files: what is checked is what is kept
        regressor = OnnxRegressor(files[regressor_path(out)].part) if model.config.needs_regressor else None
        agreement = compare_engines(model, OnnxClassifier(files[out].part), regressor)
        if agreement.holds:
            for file in files.values():
                file.complete()
    finally:
        for file in files.values():
            file.discard()
    report = {
        "model": args.model,
        "agrees": agreement.holds,
        "files": {str(path): len(content) for path, content in contents.items()} if agreement.holds else {},
        "windows": agreement.logits.n,
        "recordings": agreement.recordings,
        "largest_logit_difference": agreement.plain_logits.worst,
        "classes_that_differ": agreement.n_differ,
        "largest_landmark_difference_px": agreement.landmarks.worst if agreement.landmarks.n else None,
        "onnxruntime": onnxruntime.__version__,
    }
    say(json.dumps(report)) if args.json else _print(report, model)
    return 0 if agreement.holds else 1


def _print(report: dict[str, Any], model: Model) -> None:
    gives = (f"logits (1, {len(model.classes)})", "landmark (1, 2)")
    for (path, n_bytes), what in zip(report["files"].items(), gives, strict=False):
        say(f"{path} ({n_bytes / 1e3:.0f} kB): volume {(1, *model.config.shape)} -> {what}")
    landmark = report["largest_landmark_difference_px"]
    say(
        f"onnxruntime {report['onnxruntime']} against the compiled network, {report['windows']} windows of "
        f"{report['recordings']}: logits within {report['largest_logit_difference']:.2g}, "
        + ("" if landmark is None else f"landmarks within {landmark:.2g} px, ")
        + f"{report['classes_that_differ'] or 'no'} classes differ"
    )
    if not report["agrees"]:
        say("they do NOT agree: nothing is written")
