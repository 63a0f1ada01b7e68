"""Shared by commands that read folders of data: their options, and the command that repeats a result."""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Callable, Collection
from pathlib import Path

from async_tnt.training.settings import PRECISIONS


def add_folder(parser: argparse._ActionsContainer, option: str, text: str) -> None:
    parser.add_argument(option, type=Path, metavar="FOLDER", help=text)


def add_precision(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--precision",
        choices=PRECISIONS,
        default="float32",
        help="of the networks' products (default: float32); bfloat16 is faster on hardware that supports it",
    )


def data_folder(given: Path | None, name: str, option: str, *, alternative: str = "") -> Path:
    """A data folder: as given, or `name` in $TNT_DATA. An error names `option`, after an `alternative` to it."""
    folder = given
    if folder is None:
        root = os.environ.get("TNT_DATA")
        if not root:
            raise FileNotFoundError(
                f"no data: give {alternative}{option} FOLDER, or set TNT_DATA to the folder with {name}/"
            )
        folder = Path(root) / name
    if not folder.is_dir():
        raise FileNotFoundError(f"no folder {folder}; give {option} FOLDER, or set TNT_DATA")
    return folder


def command_words(
    program: str,
    args: argparse.Namespace,
    add_arguments: Callable[[argparse.ArgumentParser], None],
    *,
    leave_out: Collection[str] = (),
) -> str:
    """The command that repeats this, without paths, which differ from machine to machine.

    Parameters
    ----------
    program : such as "async-tnt train".
    args, add_arguments : the parsed options, and the function that adds them to a parser.
    leave_out : options that do not change the result, by their name in `args`.
    """
    parser = argparse.ArgumentParser(add_help=False)
    add_arguments(parser)
    words = [program]
    for action in parser._actions:
        value = getattr(args, action.dest)
        if action.type is Path or value == action.default or action.dest in leave_out:
            continue
        if action.dest in ("start_from", "network"):
            value = Path(value).name
        text = shlex.join(map(str, value if isinstance(value, (list, tuple)) else [value]))
        name = action.option_strings[-1 if value is False else 0]  # --mirror, --no-mirror
        words.append(name if isinstance(value, bool) else f"{name} {text}")
    return " ".join(words)
