"""The manifest of a set of moving digits: `set.json` beside its shards.

format, version   "async_tnt.moving_mnist", 1
parameters        everything that decides the content: split, kind of motion, indices of images,
                  seed, sensor, simulator, recordings_per_shard, package_version, and a checksum of
                  the images and labels
motions           by index
shards            names of the files, motion by motion, and by image within each motion
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from async_tnt.base.files import write_text
from experiments.motions.kinds import Motion, motions_of
from experiments.moving_set.shards import Shard, open_shard

MANIFEST = "set.json"
"""Name of the manifest in the folder of a set."""

FORMAT = "async_tnt.moving_mnist"
"""The manifest's entry `format`, which tells that the folder is a set."""

VERSION = 1
"""Version of the format."""

PARAMETERS = ("split", "kind", "images", "seed", "sensor", "simulator", "recordings_per_shard")
"""Parameters that readers need."""


@dataclass(frozen=True)
class MovingMnist:
    """A set on disk, as `build` and `open_set` return it.

    Attributes
    ----------
    folder : folder of the set.
    shards : the files, motion by motion, and by image within each motion.
    motions : the motions, by index.
    parameters : everything that decides the content: split, kind, indices of images, seed,
        simulator ...
    """

    folder: Path
    shards: tuple[Path, ...]
    motions: tuple[Motion, ...]
    parameters: dict[str, Any]

    def __len__(self) -> int:
        """The number of recordings in the complete set."""
        return len(self.motions) * len(self.parameters["images"])

    def __iter__(self) -> Iterator[Shard]:
        """The shards, which are opened one after the other."""
        return map(open_shard, self.shards)

    def locate(self, motion: int, image: int) -> tuple[Path, int]:
        """The shard that holds the recording of an image under a motion, and its place there."""
        images = self.parameters["images"]
        step = self.parameters["recordings_per_shard"]
        shards_of_motion = -(-len(images) // step)  # rounded up
        place = images.index(image)
        shard = motion * shards_of_motion + place // step
        return self.shards[shard], place % step


def write_manifest(moving_set: MovingMnist) -> None:
    """Write the manifest of a set, unless the same manifest is there.

    Raises
    ------
    ValueError : the folder has a manifest with other parameters, or shards without a manifest.
    """
    path = moving_set.folder / MANIFEST
    if path.exists():
        existing: Any = read_manifest(moving_set.folder).parameters
        requested: Any = moving_set.parameters
        if existing == requested:
            return
        # go down to the first parameter that differs, for the message
        while isinstance(existing, dict) and isinstance(requested, dict):
            name = next(
                key
                for key in sorted(existing | requested)
                if existing.get(key) != requested.get(key)
            )
            existing = existing.get(name)
            requested = requested.get(name)
        raise ValueError(
            f"{path}: made with other parameters: {name} is {existing!r}, requested "
            f"{requested!r}. Give the same parameters, or another folder"
        )
    if any(shard.exists() for shard in moving_set.shards):
        raise ValueError(
            f"{moving_set.folder}: shards without {MANIFEST}, which says how they were made. Give "
            "another folder"
        )
    content = {
        "format": FORMAT,
        "version": VERSION,
        "parameters": moving_set.parameters,
        "motions": [dataclasses.asdict(motion) for motion in moving_set.motions],
        "shards": [path.name for path in moving_set.shards],
    }
    write_text(path, json.dumps(content, indent=1) + "\n")


def read_manifest(folder: Path) -> MovingMnist:
    """Read the manifest of a set.

    Raises
    ------
    FileNotFoundError : the folder has no manifest.
    ValueError : the manifest is damaged, or not that of a set.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise FileNotFoundError(
            f"{folder}: no {MANIFEST} in it; expected a folder that experiments.moving_mnist made"
        )
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if (content["format"], content["version"]) != (FORMAT, VERSION):
            raise ValueError(
                f"expected {FORMAT} version {VERSION}, got {content['format']} {content['version']}"
            )
        parameters = {name: content["parameters"][name] for name in PARAMETERS}
        motions = motions_of(parameters["kind"])
        names = shard_names(motions, len(parameters["images"]), parameters["recordings_per_shard"])
        motion_entries = [dataclasses.asdict(motion) for motion in motions]
        if content["motions"] != motion_entries or content["shards"] != names:
            raise ValueError(
                f"expected the motions of kind {parameters['kind']!r} and their {len(names)} shards"
            )
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else error
        raise ValueError(f"{path}: damaged, or not a set of this release: {reason}") from None
    shards = tuple(folder / name for name in names)
    return MovingMnist(folder, shards, motions, content["parameters"])


def shard_names(motions: Sequence[Motion], n_images: int, recordings_per_shard: int) -> list[str]:
    """Names of the files of a set, motion by motion."""
    firsts = range(0, n_images, recordings_per_shard)
    return [f"{m.name}_{first:05}.safetensors" for m in motions for first in firsts]
