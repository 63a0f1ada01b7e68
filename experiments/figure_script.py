"""What the scripts share that draw recordings: figure_heatmap and figure_motions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from async_tnt.networks.loading import load_model
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.views.figure_style import check_picture, save, styled
from async_tnt.views.figure_subject import Subject, Window
from async_tnt.volume import TNTVolume
from experiments.script_options import plain_parser

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def run(
    name: str, description: str | None, draw: Callable[..., Figure], argv: list[str] | None, n_windows: int = 1
) -> int:
    """Draw windows of recordings, with the configuration of a model, into a file. Returns the exit code.

    draw : given `n_windows` windows.
    """
    parser = plain_parser(name, description)
    parser.add_argument("files", nargs="*", default=["3"], help="recordings, or digits of bundled ones (default: 3)")
    parser.add_argument("--model", default="digits", help="a bundled model or a file (default: %(default)s)")
    parser.add_argument("--windows", type=int, nargs="+", help="numbers, counted from 1 (default: each file's first)")
    parser.add_argument("--picture", type=Path, required=True, metavar="FILE", help=".png, .svg or .pdf")
    parser.add_argument("--dpi", type=int, default=150)
    args = parser.parse_args(argv)
    check_picture(args.picture)
    with styled():
        save(draw(*windows_of(args.files, args.model, args.windows, n_windows)), args.picture, args.dpi)
    return 0


def windows_of(files: list[str], model_name: str, numbers: list[int] | None, n_windows: int) -> list[Window]:
    """So many windows: of one recording the first ones, of several the first of each, unless there are numbers.

    Raises
    ------
    ValueError : another number of files or windows; no such window.
    """
    if len(files) not in (1, n_windows):
        raise ValueError(f"{n_windows} windows of one recording or of as many are drawn, got {len(files)} recordings")
    subjects = [subject_of(name, model_name) for name in files]
    if numbers is None:
        numbers = list(range(1, n_windows + 1)) if len(files) == 1 else [1] * n_windows
    if len(numbers) != n_windows:
        raise ValueError(f"{n_windows} windows are drawn, got the numbers {numbers}")
    if len(subjects) == 1:
        subjects *= n_windows
    return [subject.window(number) for subject, number in zip(subjects, numbers, strict=True)]


def subject_of(name: str, model_name: str = "digits") -> Subject:
    """A recording, or the bundled one of a digit, as a model sees it."""
    path = sample_recordings()[int(name)] if name.isdigit() else Path(name)
    model = load_model(model_name)
    return Subject(path.name, open_recording(path).read(), model.config, model, model_name)


def grid_xy(window: Window) -> np.ndarray:
    """Each event's pixel on the volume's grid: float64, shape (2, N)."""
    gain_x, gain_y = window.subject.config.to_grid(1.0, 1.0)
    return np.stack([window.events["x"] * gain_x, window.events["y"] * gain_y])


def flow_of(window: Window) -> tuple[float, float]:
    """The ridge line's slope (x, y), in grid pixels per window: the direction in which the events move."""
    volume = TNTVolume(window.subject.config.replace(landmark="line", remove_flow=False))
    volume.open(window.start_us)
    volume.update(window.events)
    return volume.flow
