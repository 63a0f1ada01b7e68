"""The figures that only the pages show: what they draw is what the package computes, and the pages have it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

image = pytest.importorskip("matplotlib.image", reason="figures need matplotlib (extra: plot)")

from made import random_model  # noqa: E402
from views.test_figure_content import assert_equal, dots, pictures  # noqa: E402
from views.test_plot_command import in_squares  # noqa: E402

from async_tnt import Processor, TNTConfig, load_model  # noqa: E402
from async_tnt.views.figure_subject import Subject  # noqa: E402
from experiments import figure_motions, figure_pipeline  # noqa: E402
from experiments.figure_motions import draw_motions  # noqa: E402
from experiments.figure_pipeline import draw_pipeline  # noqa: E402
from experiments.figure_script import subject_of  # noqa: E402

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
DIGITS = load_model("digits")


def words(figure):
    from matplotlib.text import Text

    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def test_two_motions_are_drawn_along_the_axis_in_which_they_differ():
    shown = subject_of("3")
    windows = [shown.window(number) for number in (1, 2)]
    figure = draw_motions(*windows)
    assert {"window 1: moving down", "window 2: moving up"} <= set(words(figure))
    for axes, window in zip((figure.axes[1], figure.axes[11]), windows, strict=True):
        _, v, kept, _ = window.coordinates()
        assert_equal(dots(axes), (window.time_ms[kept], v[kept], window.events["p"][kept] == 1))
    expected = [volume[k] for window in windows for volume in window.volumes() for k in (2, 3, 4, 5)]
    assert_equal(pictures(figure.axes), expected)
    with pytest.raises(ValueError, match="one configuration, got sensors of 34x34 pixels and 40x34 pixels"):
        draw_motions(windows[0], replace(shown, config=shown.config.replace(sensor=(40, 34))).window(1))


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
