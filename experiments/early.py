"""How early a model decides, and how sure it is: `async-tnt evaluate MODEL N-MNIST`.

    python -m experiments.early [MODEL] [--nmnist N-MNIST] [--json FILE]

MODEL is `digits` by default. The recordings of Test are read once.
"""

from __future__ import annotations

from typing import Any

from experiments.scripts.options import (
    add_folder,
    add_json,
    data_folder,
    exit_with,
    plain_parser,
    print_tables,
    write_outputs,
)
from experiments.scripts.processes import command
from experiments.speed.timing import machine


def main(argv: list[str] | None = None) -> int:
    """Evaluate the model, print the table, and write the file that is asked for."""
    parser = plain_parser("early", __doc__)
    parser.add_argument(
        "model", nargs="?", default="digits", metavar="MODEL", help="default: digits"
    )
    add_folder(parser, "--nmnist", "with Test/<digit>/*.bin (default: $TNT_DATA/nmnist)")
    add_json(parser)
    args = parser.parse_args(argv)
    nmnist = data_folder(args.nmnist, "nmnist", "--nmnist")
    evaluation = command("evaluate", args.model, nmnist / "Test", "--json")
    report: dict[str, Any] = {**evaluation, "machine": machine()}
    write_outputs(args, report)
    print_tables(report, "early")
    return 0


if __name__ == "__main__":
    exit_with(main)
