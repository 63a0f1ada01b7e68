"""Classifiers that never saw an event: trained on pictures alone, tested on recordings of real cameras.

    python -m experiments.from_pictures [--nmnist N-MNIST] [--poker POKER-DVS] [--characters FOLDER] [--made]
                                        [--fonts FOLDER] [--seeds N] [--out FOLDER] [--json FILE]

nmnist      MNIST's training images; all of N-MNIST's Test
poker       card pips, drawn with fonts; both parts of POKER-DVS, whose recordings are crops that follow a pip
characters  ten digits and 26 letters, drawn with fonts; both parts of HOTS' characters, as of
            `examples/hots_characters.py`
made        ten pictures of each of six objects, with backgrounds, and recordings of others (`made_pictures.py`)

Each network is trained by `async-tnt train PICTURES` with the options that its row states, and reads the recordings
once. Finished trainings in --out are kept, interrupted ones resume, and what FILE has of other sets stays there.
"""

from __future__ import annotations

import contextlib
import json
import string
import time
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.checks import needs_extra
from async_tnt.progress import progress
from experiments import made_pictures
from experiments.bare import lines
from experiments.bench_timing import machine
from experiments.mnist import load_mnist
from experiments.script_options import add_folder, data_folder, exit_with, script_parser, write_outputs
from experiments.unseen_motions import command

TITLES = {"nmnist": "N-MNIST", "poker": "POKER-DVS", "characters": "HOTS' characters", "made": "made objects"}
TESTS = {"nmnist": ["Test"], "poker": ["pips_train", "pips_test"], "characters": ["Train", "Test"], "made": ["Test"]}
OPTIONS = {
    "nmnist": "--sensor 34x34",
    "poker": "--sensor 35x35 --window-us 25000 --follow",
    "characters": "--sensor 32x32 --follow",
    "made": "--sensor 64x64 --size 0.7-1",
}
PIPS = {"cl": "♣", "di": "♦", "he": "♥", "sp": "♠"}
CHARACTERS = string.digits + string.ascii_uppercase
UNFIT = "LastResort", "FreeSerifBold"
"""Fonts that draw boxes, or a club as a spade."""
HEIGHT = 96
"""Of a drawn glyph, about, in pixels."""


def write_mnist(folder: Path, mnist: Path, n: int) -> None:
    """The first `n` training images of MNIST, `folder/<digit>/<number>.png`."""
    from PIL import Image

    images, labels = load_mnist(mnist, "train")
    for i, (image, label) in enumerate(zip(images[:n], labels[:n], strict=True)):
        path = folder / str(label) / f"{i:05}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            Image.fromarray(image).save(path)


def write_glyphs(folder: Path, glyphs: dict[str, str], fonts: Path | None, turned: tuple[int, ...] = (0,)) -> None:
    """Class -> a character, black on white, by each font that has them all, and turned by degrees."""
    from PIL import Image, ImageDraw

    for font_name, font in _fonts("".join(glyphs.values()), fonts):
        for name, text in glyphs.items():
            (folder / name).mkdir(parents=True, exist_ok=True)
            left, top, right, bottom = font.getbbox(text)
            picture = Image.new("L", (right - left + HEIGHT, bottom - top + HEIGHT), 255)
            ImageDraw.Draw(picture).text((HEIGHT / 2 - left, HEIGHT / 2 - top), text, 0, font)
            for degrees in turned:
                rotated = picture.rotate(degrees, Image.Resampling.BICUBIC, expand=True, fillcolor=255)
                rotated.save(folder / name / f"{font_name} {degrees}.png")


def _fonts(text: str, folder: Path | None) -> list[tuple[str, Any]]:
    """Fonts beneath a folder, by default matplotlib's, that draw each of these characters, and not as another font."""
    with needs_extra("plot", "fonts are matplotlib's"):
        from matplotlib import get_data_path
        from PIL import ImageFont
    fonts: dict[bytes, tuple[str, Any]] = {}
    for path in sorted((folder or Path(get_data_path(), "fonts/ttf")).rglob("*")):
        if path.suffix.lower() not in (".ttf", ".otf", ".ttc") or path.stem.startswith(UNFIT):
            continue
        with contextlib.suppress(OSError):  # a font that FreeType refuses
            font = ImageFont.truetype(str(path), HEIGHT)
            missing, *drawn = (bytes(font.getmask(character)) for character in ("\uffff", *text))
            if all(any(glyph) and glyph != missing for glyph in drawn):
                fonts.setdefault(b"".join(drawn), (path.stem, font))
    return list(fonts.values())


def write_pictures(name: str, folder: Path, mnist: Path | None, n: int, fonts: Path | None) -> None:
    """The pictures of a set."""
    if name == "nmnist":
        write_mnist(folder, data_folder(mnist, "mnist", "--mnist"), n)
    elif name == "poker":
        write_glyphs(folder, PIPS, fonts, (0, 180))
    elif name == "made":
        made_pictures.write_pictures(folder, 10, 0)
    else:
        write_glyphs(folder, {character: character for character in CHARACTERS}, fonts)


def measure(
    name: str, pictures: Path, tests: list[Path], seeds: int, out: Path, more: tuple[str, ...]
) -> dict[str, Any]:
    """Train with each seed, and test."""
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    with progress(seeds, f"training for {TITLES[name]}") as bar:
        for seed in range(seeds):
            model = out / f"{name}{seed}.safetensors"
            words = [*OPTIONS[name].split(), *more, "--seed", seed, "--out", model, "--json"]
            began = time.monotonic()
            record = command("train", pictures, *words)
            minutes = (time.monotonic() - began) / 60
            reports = [command("evaluate", model, folder, "--json") for folder in tests]
            confusion = np.sum([report["confusion"] for report in reports], 0)
            windows = np.sum([report["window_confusion"] for report in reports], 0)
            rows.append(
                {
                    "accuracy": float(np.trace(confusion) / confusion.sum()),
                    "recordings": int(confusion.sum()),
                    "window_accuracy": float(np.trace(windows) / windows.sum()),
                    "windows": int(windows.sum()),
                    "minutes": minutes,
                    "simulated_held_out": record["validation"]["per_window"],
                    "confusion": confusion.tolist(),
                }
            )
            bar.update()
    given = f"async-tnt train PICTURES {OPTIONS[name]}"
    return {
        "title": TITLES[name],
        "command": " ".join((given, *more)),
        "pictures": record["data"]["pictures"],
        "classes": reports[0]["classes"],
        "networks": rows,
        "machine": machine("torch"),
    }


def main(argv: list[str] | None = None) -> int:
    """Draw, train, test, print and write."""
    parser = script_parser("from_pictures", __doc__, "one seed and epoch, 500 pictures")
    for name in [name for name in TITLES if name != "made"]:
        add_folder(parser, f"--{name}", TITLES[name])
    parser.add_argument("--made", action="store_true", help="made objects")
    add_folder(parser, "--mnist", "with MNIST's IDX files (default: $TNT_DATA/mnist)")
    add_folder(parser, "--fonts", "TrueType and OpenType files, at any depth (default: those of matplotlib)")
    parser.add_argument("--pictures", type=int, default=60_000, metavar="N", help="of MNIST (default: 60000)")
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="networks (default: 5)")
    parser.add_argument("--out", type=Path, default=Path("pictures"), metavar="FOLDER", help="default: pictures")
    args = parser.parse_args(argv)
    folders = {name: getattr(args, name) for name in TITLES if getattr(args, name)}
    if not folders:
        parser.error(f"give one of --{', --'.join(TITLES)}")
    if args.made:
        folders["made"] = args.out / "recordings"
        made_pictures.write_recordings(folders["made"] / "Test", 30, 1)
    report: dict[str, Any] = {"sets": {}}
    if args.json and args.json.exists():
        report = json.loads(args.json.read_text(encoding="utf-8"))
    for name, folder in folders.items():
        pictures = args.out / name
        write_pictures(name, pictures, args.mnist, 500 if args.quick else args.pictures, args.fonts)
        seeds, more = (1, ("--epochs", "1")) if args.quick else (args.seeds, ())
        parts = [folder / part for part in TESTS[name]]
        report["sets"][name] = measure(name, pictures, parts, seeds, args.out / "models", more)
        write_outputs(args, report)
    print("\n".join(lines(report["sets"])))
    return 0


if __name__ == "__main__":
    exit_with(main)
