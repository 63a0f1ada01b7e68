"""The confusion matrix as drawn."""

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="pictures need matplotlib (extra `plot`)")

from async_tnt.views.figure_confusion import draw_confusion

CONFUSION = np.array([[90, 10, 0], [1, 1, 0], [0, 0, 0]])


def test_colours_are_shares_of_the_row_and_numbers_are_counts():
    axes = draw_confusion(CONFUSION, ["left", "right", "none"], "mine").axes[0]
    np.testing.assert_allclose(axes.images[0].get_array(), [[0.9, 0.1, 0], [0.5, 0.5, 0], [0, 0, 0]])
    assert [text.get_text() for text in axes.texts] == ["90", "10", "1", "1"]
    assert [text.get_position() for text in axes.texts] == [(0, 0), (1, 0), (0, 1), (1, 1)]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["left", "right", "none"]
    assert (axes.get_ylabel(), axes.get_xlabel()) == ("true", "decided")


def test_a_shape_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match=r"`confusion` must have shape \(2, 2\), .* got \(3, 3\)"):
        draw_confusion(CONFUSION, ["left", "right"])


def test_accuracy_against_time_stands_beside_it():
    figure = draw_confusion(CONFUSION, ["left", "right", "none"], "mine", [(10_000, 0.2, 0.5), (20_000, 0.9, 1.0)])
    right, decided = figure.axes[1 + 1].lines
    np.testing.assert_allclose(right.get_xydata(), [(10, 0.2), (20, 0.9)])
    np.testing.assert_allclose(decided.get_ydata(), [0.5, 1.0])
    boxes = [axes.get_position() for axes in figure.axes]
    assert boxes[0].x1 < boxes[1].x0 < boxes[1].x1 < boxes[2].x0 < boxes[2].x1 <= 1
