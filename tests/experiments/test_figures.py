"""The figures that only the pages show: what they draw is what the package computes, and the pages have it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

image = pytest.importorskip("matplotlib.image", reason="figures need matplotlib (extra: plot)")

from made import random_model  # noqa: E402
from views.test_figure_content import assert_equal  # noqa: E402
from views.test_plot_command import in_squares  # noqa: E402

from async_tnt import Processor, TNTConfig, load_model  # noqa: E402
from async_tnt.views.figure_subject import Subject  # noqa: E402
from experiments import figure_motions, figure_pipeline  # noqa: E402
from experiments.figure_pipeline import draw_pipeline  # noqa: E402
from experiments.figure_script import subject_of  # noqa: E402

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
DIGITS = load_model("digits")


def words(figure):
    from matplotlib.text import Text

    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def stacked(axes):
    return [np.asarray(image.get_array()) for image in sorted(axes.images, key=lambda image: -image.get_zorder())]


@pytest.mark.parametrize("changes", [{}, {"landmark": "regressor"}], ids=str)
def test_the_pipeline_shows_what_the_network_sees_and_decides(changes):
    model = random_model(TNTConfig(**changes), widths=(5, 6, 7)) if changes else DIGITS
    shown = Subject("9.bin", subject_of("9").events, model.config, model, "mine")
    window = shown.window(1)
    figure = draw_pipeline(window)
    decision = next(d for d in Processor(model).push(shown.events) if d.trigger == "window")
    assert f"9.bin, window 1: from events to “{decision.label}”" in words(figure)
    assert_equal(stacked(figure.axes[-3]), window.volumes()[1])
    np.testing.assert_array_equal([bar.get_width() for bar in figure.axes[-1].patches], decision.probabilities)
    *path, cross = figure.axes[2].lines
    landmarks = window.coordinates().landmark
    assert_equal(cross.get_xydata(), landmarks[-1:])
    assert [line.get_xydata()[[0, -1]].tolist() for line in path] == [landmarks[[0, -1]].tolist()] * (not changes)
    with pytest.raises(ValueError, match="a pipeline is drawn with a model and its own configuration"):
        draw_pipeline(replace(shown, config=shown.config.replace(t_max=2.0)).window(1))


@pytest.mark.parametrize("script, name", [(figure_motions, "motions"), (figure_pipeline, "pipeline")])
def test_the_pictures_of_the_pages_are_what_the_scripts_draw(script, name, tmp_path):
    """Up to the dots that one matplotlib puts elsewhere than the next. When this fails: draw them again."""
    again = tmp_path / "again.png"
    assert script.main(["3", "--picture", str(again)]) == 0
    kept, drawn = (in_squares(image.imread(path)) for path in (IMAGES / f"{name}.png", again))
    assert kept.shape == drawn.shape and np.abs(kept - drawn).max() < 0.2
