"""Digests of volumes and logits on the bundled recordings, which every processor should have.

    python -m experiments.same_bits [--json experiments/results/same_bits.json] [--check]

One digest is that of all volumes. They show the first window of each recording after several
numbers of events, for each landmark that needs no network, each polarity and each image. Each
bundled model has a digest of its logits. --check compares the digests with the recorded digests,
and exits with 1 if one differs.

Kernels state the order in which they add, so the length of a processor's vectors does not matter.
On a processor with AVX-512, the code for processors that have AVX2 only is compared by

    NUMBA_CPU_NAME=x86-64-v3 \\
    NUMBA_CPU_FEATURES=+avx,+avx2,+bmi,+bmi2,+f16c,+fma,+lzcnt,+movbe,+popcnt \\
    python -m experiments.same_bits --check
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from async_tnt import Processor, TNTConfig, TNTVolume, bundled_models, load_model
from async_tnt.cli.bench import machine
from async_tnt.sources import open_recording, sample_recordings
from experiments.scripts.options import add_json, exit_with, plain_parser, write_outputs
from experiments.tables.parts import results

PREFIXES = (1, 10, 100, 1_000, 100_000)
"""Numbers of events after which a volume is read."""

WINDOW_US = 105_000
"""Length of a window, in microseconds."""


def configs() -> Iterator[TNTConfig]:
    """The configurations of the volumes."""
    for landmark, polarity in itertools.product(
        ("center", "running", "line"), ("signed", "unsigned", "split")
    ):
        yield TNTConfig(t_max=4.0).replace(landmark=landmark, polarity=polarity)
    yield TNTConfig(landmark="line", remove_flow=True)
    yield TNTConfig(transform="none", landmark="center")
    for image in ("count", "count_time", "mean_time", "time_surface"):
        yield TNTConfig(transform="none", landmark="center", polarity="split").replace(
            representation=image
        )


def digests() -> dict[str, str]:
    """Name -> digest: `volumes` for all volumes, the name of each bundled model for its logits."""
    recordings = [open_recording(path).read() for path in sample_recordings().values()]
    volumes = hashlib.sha256()
    for config in configs():
        volume = TNTVolume(config)
        for events in recordings:
            window = events[events["t"] < WINDOW_US]
            volume.reset()
            volume.open(0)
            for first, last in itertools.pairwise((0, *PREFIXES)):
                volume.update(window[first:last])
                volumes.update(np.ascontiguousarray(volume.array).tobytes())
    digest_of = {"volumes": volumes.hexdigest()}
    for name in bundled_models():
        logits = hashlib.sha256()
        processor = Processor(load_model(name), start_us=0)
        for events in recordings:
            processor.reset()
            for first, last in itertools.pairwise((0, *PREFIXES[:4])):
                processor.push(events[first:last])
                logits.update(np.ascontiguousarray(processor.fire().logits).tobytes())
        digest_of[name] = logits.hexdigest()
    return digest_of


def main(argv: list[str] | None = None) -> int:
    """Print the digests, and write or compare them. Returns 1 if --check finds a difference."""
    parser = plain_parser("same_bits", __doc__)
    add_json(parser)
    parser.add_argument(
        "--check", action="store_true", help="compare with those of experiments/results"
    )
    args = parser.parse_args(argv)
    report: dict[str, Any] = {"machine": machine(), "sha256": digests()}
    for name, digest in report["sha256"].items():
        print(f"{name:<24} {digest}")
    write_outputs(args, report)
    if args.check:
        recorded = results("same_bits")["sha256"]
        differ = [name for name, digest in report["sha256"].items() if recorded.get(name) != digest]
        print(
            f"different from the recorded ones: {', '.join(differ)}"
            if differ
            else "the same as the recorded ones"
        )
        return int(bool(differ))
    return 0


if __name__ == "__main__":
    exit_with(main)
