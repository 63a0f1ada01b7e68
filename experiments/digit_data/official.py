"""N-MNIST's official test: 10,000 recordings, of which the n-th shows the n-th test image of MNIST.

A folder has them in one of two layouts:

official    Test/<digit>/00001.bin to 10000.bin, beside Train/<digit>/00001.bin to 60000.bin
mixed       The official test recording n has the number 60,000 + n, and may be in Train or in Test.
            The numbers up to 60,000 are those of the official training recordings.
"""

from __future__ import annotations

from pathlib import Path

N_TRAIN = 60_000
"""Number of official training recordings."""

PER_DIGIT = (980, 1135, 1032, 1010, 982, 892, 958, 1028, 974, 1009)
"""Number of official test recordings of each digit, from 0 to 9: as many as MNIST's test part has
images of it."""

N_TEST = sum(PER_DIGIT)
"""Number of official test recordings."""


def official_test(folder: Path) -> dict[int, Path]:
    """The official test recordings in a folder of N-MNIST: official number, from 1 -> file.

    Files whose name is not a number are left out.

    Raises
    ------
    FileNotFoundError : there are no official test recordings.
    ValueError : a number that neither layout has, both layouts at once, a recording twice, or more
        recordings of a digit than the official test has.
    """
    files: dict[int, Path] = {}
    layouts: dict[str, Path] = {}  # layout -> a file that has it
    for path in sorted(folder.glob("T*/[0-9]/*.bin")):
        part = path.parts[-3]
        if part not in ("Train", "Test") or not path.stem.isdecimal():
            continue
        number = int(path.stem)
        if number > N_TRAIN:
            layout = "mixed"
            official = number - N_TRAIN
        elif part == "Test":
            layout = "official"
            official = number
        else:  # an official training recording
            continue
        if not 1 <= official <= N_TEST:
            raise ValueError(
                f"{path}: official test recordings have numbers from 1 to {N_TEST:,}, or from "
                f"{N_TRAIN + 1:,} to {N_TRAIN + N_TEST:,}, got {number:,}"
            )
        if official in files and layout in layouts:
            raise ValueError(f"{path} and {files[official]} have the same number; remove one")
        files[official] = path
        layouts[layout] = path
    if len(layouts) > 1:
        raise ValueError(
            f"{layouts['official']} is numbered as in the official Test, and {layouts['mixed']} as "
            f"in a set with other parts, from {N_TRAIN + 1:,} on; give a folder with one of the two"
        )
    if not files:
        raise FileNotFoundError(
            f"{folder}: no official test recordings of N-MNIST; expected Test/<digit>/<number>.bin"
        )
    for digit, most in enumerate(PER_DIGIT):
        n = sum(path.parent.name == str(digit) for path in files.values())
        if n > most:
            raise ValueError(
                f"{folder}: {n:,} test recordings of digit {digit}, but the official test has "
                f"{most:,}"
            )
    return files


def missing_numbers(files: dict[int, Path]) -> list[int]:
    """The official numbers of the test recordings that are not among the files."""
    return [number for number in range(1, N_TEST + 1) if number not in files]


def link_recordings(files: dict[int, Path], folder: Path) -> None:
    """Write links to recordings, `folder/<digit>/<official number>.bin`."""
    for number, path in files.items():
        link = folder / path.parent.name / f"{number:05}.bin"
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(path.resolve())
