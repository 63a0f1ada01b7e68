"""What the commands of the laboratory share: options, exit codes, and files that they write."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

from async_tnt.base.files import check_writable
from async_tnt.base.messages import printable
from async_tnt.cli.options import positive_int
from async_tnt.views.figure_style import check_picture, save, styled
from experiments.records.files import add_result, read_numbers, result_of, write_result
from experiments.records.run import command_line, commit
from experiments.speed.interleaved import WorkDiffers
from experiments.tables.parts import REPORT_OF, Table


def writable_file(text: str, check: Callable[[Path], object] = check_writable) -> Path:
    """An argparse type: a path that can be written or replaced."""
    try:
        check(Path(text))
    except (OSError, ValueError) as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return Path(text)


def picture_file(text: str) -> Path:
    """An argparse type: a picture that can be written or replaced."""
    return writable_file(text, check_picture)


def plain_parser(
    name: str, description: str | None, epilog: str | None = None
) -> argparse.ArgumentParser:
    """The parser of `python -m experiments.NAME`.

    Its help shows description and epilog as they are, without new line breaks. Options that it
    parses have the attribute `module`, the words `experiments.NAME`.
    """
    # Results name the commit of the code as it is now. When they are written, hours later, the
    # checkout may have another one.
    commit()
    module = f"experiments.{name}"
    parser = argparse.ArgumentParser(
        prog=f"python -m {module}",
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(module=module)
    return parser


def picture_parser(name: str, description: str | None) -> argparse.ArgumentParser:
    """A `plain_parser` with the option --picture, for commands that only draw."""
    parser = plain_parser(name, description)
    parser.add_argument(
        "--picture", type=picture_file, metavar="FILE", required=True, help=".png, .svg or .pdf"
    )
    return parser


def script_parser(
    name: str, description: str | None, quick: str, *, draws: bool = False
) -> argparse.ArgumentParser:
    """A `plain_parser` with the options --quick and --json.

    quick : words for what --quick measures.
    draws : whether the command also draws. Then it has --picture and --from, too.
    """
    parser = plain_parser(name, description)
    parser.add_argument("--quick", action="store_true", help=f"{quick}: does it all run?")
    add_json(parser)
    if draws:
        parser.add_argument(
            "--picture",
            type=picture_file,
            metavar="FILE",
            help="also draw them: .png, .svg or .pdf",
        )
        help_from = "take the figures from such a JSON file instead of measuring"
        parser.add_argument("--from", dest="source", type=Path, metavar="FILE", help=help_from)
    return parser


def run_script(
    parser: argparse.ArgumentParser,
    argv: list[str] | None,
    measure: Callable[[bool], dict[str, Any]],
    name: str,
    draw: Callable[[Any], Any] | None = None,
    *,
    is_written: bool = False,
) -> int:
    """Measure a report or read it, print its tables, and write JSON and the picture if asked.

    measure : makes the report; called with True for --quick.
    name : name of the report, see `REPORT_OF`.
    draw : makes the picture of a report.
    is_written : whether `measure` itself writes the parts of the report as they are ready.

    Returns the exit code: 1 if backends do not give the same results.
    """
    args = parser.parse_args(argv)
    try:
        source = getattr(args, "source", None)
        report = read_numbers(source) if source else measure(args.quick)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    except WorkDiffers as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1
    # The files are written before the tables are printed, because measuring took minutes, and
    # printing may fail. A report that was read is not written again: its numbers are not new.
    if source is None and not is_written:
        write_outputs(args, report)
    if draw is not None and args.picture:
        draw_into(args.picture, draw, report)
    print_tables(report, name)
    return 0


def earlier_parts(args: argparse.Namespace) -> dict[str, Any]:
    """Name -> numbers, of the results in the file of --json. There may be no such file."""
    if args.json and args.json.exists():
        return read_numbers(args.json)
    return {}


def write_part(args: argparse.Namespace, name: str, numbers: dict[str, Any]) -> None:
    """Add a named result to the file of --json, if it is given, and keep the file's others."""
    if args.json:
        add_result(args.json, name, result_of(numbers, command_line(args.module)))


def print_tables(report: dict[str, Any], name: str) -> None:
    """Print the tables that RESULTS.md would have of the report `name`.

    It also prints what each row does, and which rows are left out and why.
    """
    from experiments.tables.sections import SECTIONS

    for section in SECTIONS:
        for table, caption in section.tables.items():
            if REPORT_OF.get(table) == name:
                make: Table = table
                text = make(report)
                if text:
                    print(f"{caption}\n\n{text}\n")
    for key, words in (("work", "What each row does"), ("left_out", "Left out")):
        rows = dict(_leaves(report.get(key, {})))
        if rows:
            print(f"{words}:", *(f"  {row:22}{why}" for row, why in rows.items()), sep="\n")


def _leaves(node: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Name and text of each leaf. The name of the leaf's parent node stands before its own name."""
    for name, value in node.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{name}: ")
        else:
            yield prefix + name, value


def write_outputs(args: argparse.Namespace, report: dict[str, Any]) -> None:
    """Write the file of --json, if it is given, with `report` as its only result."""
    if args.json:
        write_result(args.json, result_of(report, command_line(args.module)))


def draw_into(path: Path, draw: Callable[..., Any], *arguments: Any, dpi: int = 100) -> None:
    """Call `draw` with these arguments, in the style of all figures, and write the picture."""
    with styled():
        save(draw(*arguments), path, dpi)


def exit_with(main: Callable[[], int]) -> NoReturn:
    """Run a command, and end the process with its exit code.

    An error is printed in one line. The exit code is 2 after bad input, and 130 after Ctrl-C.
    """

    def show(message: Warning | str, *where: Any, **more: Any) -> None:
        _print_line(f"warning: {message}")

    try:
        with warnings.catch_warnings():
            warnings.showwarning = show
            code = main()
    except BrokenPipeError:  # the reader of the output, such as `| head`, has read enough
        code = 0
    except (OSError, ValueError, ImportError, RuntimeError, subprocess.CalledProcessError) as error:
        _print_line(str(error))
        code = 2
    except KeyboardInterrupt as error:
        _print_line(str(error) or "interrupted")
        code = 130
    sys.exit(code)


def _print_line(message: str) -> None:
    print(f"{Path(sys.argv[0]).stem}: {printable(message)}", file=sys.stderr, flush=True)


def add_count(parser: argparse._ActionsContainer, option: str, default: int, text: str) -> None:
    """Add an option that takes a whole number of at least 1."""
    text = f"{text} (default: {default:,})"
    parser.add_argument(option, type=positive_int, default=default, metavar="N", help=text)


def add_json(parser: argparse._ActionsContainer) -> None:
    """Add --json."""
    parser.add_argument(
        "--json", type=writable_file, metavar="FILE", help="also write the figures there"
    )


def add_folder(parser: argparse._ActionsContainer, option: str, text: str) -> None:
    """Add an option that takes a folder."""
    parser.add_argument(option, type=Path, metavar="FOLDER", help=text)


def data_folder(given: Path | None, name: str, option: str) -> Path:
    """The data folder that is given, or the folder `name` in $TNT_DATA.

    option : the option by which it is given, for the error.
    """
    folder = given
    if folder is None:
        root = os.environ.get("TNT_DATA")
        if not root:
            raise FileNotFoundError(
                f"no data: give {option} FOLDER, or set TNT_DATA to the folder with {name}/"
            )
        folder = Path(root) / name
    if not folder.is_dir():
        raise FileNotFoundError(f"no folder {folder}; give {option} FOLDER, or set TNT_DATA")
    return folder
