"""The figures that only the pages show: the pages have what the scripts draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

image = pytest.importorskip("matplotlib.image", reason="figures need matplotlib (extra: plot)")

from views.test_plot_command import in_squares  # noqa: E402

from experiments import figure_groups, figure_motions, figure_stream  # noqa: E402

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"


@pytest.mark.parametrize("script, name", [(figure_motions, "motions")])
def test_the_pictures_of_the_pages_are_what_the_scripts_draw(script, name, tmp_path):
    """Dots that one matplotlib puts elsewhere than the next are not compared.

    When this fails: draw them again.
    """
    again = tmp_path / "again.png"
    assert script.main(["3", "--picture", str(again)]) == 0
    kept = in_squares(image.imread(IMAGES / f"{name}.png"))
    drawn = in_squares(image.imread(again))
    assert kept.shape == drawn.shape and np.abs(kept - drawn).max() < 0.2


def test_a_convolution_is_equivariant_to_what_the_figure_says(tmp_path):
    errors = {
        case.title: figure_groups.compared(case, figure_groups.counted())[2]
        for case in figure_groups.CASES
    }
    differ = {words for words, error in errors.items() if error > 1e-12}
    assert (
        differ == {"turned", "moved by 1 px, pooled by 2"}
        and min(errors[words] for words in differ) > 0.5
    )
    assert figure_groups.main(["--picture", str(tmp_path / "groups.png")]) == 0
    assert (tmp_path / "groups.png").stat().st_size > 10_000


def test_the_moving_picture_shows_what_is_decided():
    labels = [
        decision.label
        for _, decision, _ in figure_stream.moments()
        if decision is not None and decision.events > 900
    ]
    assert list(dict.fromkeys(labels)) == ["3", "7", "8"]
    picture = figure_stream.frame(*next(figure_stream.moments()))
    kept = IMAGES / "stream.gif"
    assert (
        picture.size == (figure_stream.WIDTH, figure_stream.HEIGHT)
        and 50_000 < kept.stat().st_size < 2_000_000
    )
