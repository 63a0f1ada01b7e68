"""Which options of `async-tnt train` go together."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

OF_VOLUME = "grid", "window_us", "representation", "transform", "landmark", "t_max", "polarity", "bins", "remove_flow"


def check_options(args: argparse.Namespace) -> None:
    """Refuse options that do not go together, by a ValueError that names them."""
    given = ["--shared-path"] if args.shared_path else []
    given += [f"--{name}" for name in ("variations", "recorded", "workers") if getattr(args, name) is not None]
    if given and args.motions == "recorded":
        raise ValueError(f"{', '.join(given)} must come with --motions resynthesized")
    if args.motions == "resynthesized" and args.roi and not args.crop:
        raise ValueError("--roi must come with --crop where motions are re-synthesized: objects leave the region")
    given = _given(args, OF_VOLUME)
    if args.start_from and given:
        raise ValueError(f"{', '.join(given)} must come without --start-from: the volume is that model's")
    if args.start_from and args.network is not None:
        raise ValueError("--network must come without --start-from: the network is that model's")
    if args.start_from and Path(args.start_from).resolve() == args.out.resolve():
        raise ValueError("--out must be another file than --start-from, which an interrupted training needs again")
    given = _given(args, ("mirror", "translate", "partial", "nothing"))
    if args.no_augmentation and given:
        raise ValueError(f"{', '.join(given)} must come without --no-augmentation")
    if args.epochs is not None and args.iterations is not None:
        raise ValueError("--epochs and --iterations both set the length of training; give only one")
    saccades = ["--saccades"] if args.saccades != [1, 2, 3] else []
    if args.dataset is None:
        given = _given(args, ("quick", "groups", "sensor", "grid", "window_us", "roi", "crop", "mask"))
        if given:
            raise ValueError(f"{', '.join(given)} must come with DATASET, a folder of class folders")
        given = _given(args, ("nmnist", "mnist", "simulated", "validation", "test", "iterations")) + saccades
        if args.smoke and given:
            raise ValueError(f"{', '.join(given)} must come without --smoke, which has ten recordings of its own")
        if args.mnist and not args.simulated:
            raise ValueError("--mnist must come with --simulated N: it is what is simulated")
        return
    given = _given(args, ("nmnist", "mnist", "simulated", "smoke")) + saccades
    if given:
        raise ValueError(f"{', '.join(given)} must come without DATASET: train on one or the other")


def _given(args: argparse.Namespace, names: Sequence[str]) -> list[str]:
    """Those of some options that ask for something."""
    return [f"--{name.replace('_', '-')}" for name in names if getattr(args, name)]
