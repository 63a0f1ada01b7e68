"""Cost follows what changed: how many cells are marked after one event, counted, not timed.

An event writes 2 x 2 pixels x0..x0+1, y0..y0+1 (of two bins). Through a 3x3 convolution and 2x2 pooling pixel x
reaches the pooled cells (x - 1) // 2 to (x + 1) // 2: both pixels together (x0 - 1) // 2 to (x0 + 2) // 2, three
cells where x0 is even and two where it is odd. Three cells k..k+2 reach (k - 1) // 2 to (k + 3) // 2 of the next
map: three again. So no more than nine cells of any map, of 289, 64 and 64 that there are with 34 x 34 pixels.
"""

import numpy as np
import pytest
from incremental.cases import CASES, Case, model_of
from made import random_events

from async_tnt import CompiledClassifier, TNTVolume
from async_tnt.kernels import layout as L
from async_tnt.kernels import state as S
from async_tnt.kernels.dense import forward_partials
from async_tnt.kernels.forward import forward_conv_1, forward_conv_2
from async_tnt.kernels.sync_input import sync_input

CASE = Case((34, 34), 9, "signed", "none", (16, 32, 64), 10)


class Marks:
    """A classifier that runs layer by layer."""

    def __init__(self, case: Case, changes: dict | None = None) -> None:
        self.network = CompiledClassifier(model_of(case)).network
        self.volume = TNTVolume(case.config.replace(**(changes or {})))
        self.volume.open(0)
        self.steps()

    def marked(self, which: int, rows: int, columns: int) -> np.ndarray:
        """Which cells of a map are marked: bool (rows, columns)."""
        layout, _, _, dirty = self.network
        n_rows, n_columns = layout[rows], layout[columns]
        flags = dirty[layout[which] : layout[which] + n_rows * (1 + n_columns)]
        cells = flags[n_rows:].reshape(n_rows, n_columns) == 1
        assert not cells[flags[:n_rows] == 0].any()  # a row with a marked cell is marked itself
        return cells

    def steps(self) -> list[np.ndarray]:
        """Bring all up to date; what was marked of pooled 1, pooled 2 and the partials on the way."""
        layout, weights, maps, dirty = self.network
        sync_input(self.volume.state(), layout, maps, dirty)
        seen = [self.marked(L.DIRTY_1, L.ROWS_1, L.COLUMNS_1)]
        forward_conv_1(layout, weights, maps, dirty)
        seen.append(self.marked(L.DIRTY_2, L.ROWS_2, L.COLUMNS_2))
        forward_conv_2(layout, weights, maps, dirty)
        seen.append(self.marked(L.DIRTY_3, L.ROWS_2, L.COLUMNS_2))
        forward_partials(layout, weights, maps, dirty)
        assert not dirty.any()  # all done
        return seen


def reached(first: int, last: int, n: int) -> np.ndarray:
    """Which of n pooled cells pixels first..last reach."""
    return np.array([any((x - 1) // 2 <= k <= (x + 1) // 2 for x in range(first, last + 1)) for k in range(n)])


def test_at_first_all_is_marked():
    network = CompiledClassifier(model_of(CASE)).network
    assert network.dirty.all()
    marks = Marks(CASE)
    assert [cells.sum() for cells in marks.steps()] == [0, 0, 0]  # and now nothing


@pytest.mark.parametrize("x, n_columns", [(0, 2), (1, 2), (2, 3), (15, 2), (16, 3), (31, 2), (32, 2), (33, 1)])
@pytest.mark.parametrize("y, n_rows", [(0, 2), (17, 2), (18, 3), (33, 1)])
def test_pooled_cells_marked_by_one_event(x, y, n_columns, n_rows):
    marks = Marks(CASE)
    marks.volume.update_one(500, x, y, 1)
    seen = marks.steps()
    expected = np.outer(reached(y, min(y + 1, 33), 17), reached(x, min(x + 1, 33), 17))
    assert np.array_equal(seen[0], expected)
    assert seen[0].sum() == n_rows * n_columns
    for cells in seen[1:]:
        assert cells.any(0).sum() <= 3 and cells.any(1).sum() <= 3


@pytest.mark.parametrize("landmark", ["center", "running", "line"])
def test_never_more_than_nine_cells_of_any_map(landmark):
    """Each event of a stream, wherever the transform puts it."""
    marks = Marks(CASE, {"transform": "tnt", "landmark": landmark})
    most = [0, 0, 0]
    for event in random_events(400, seed=1, duration_us=3900).tolist():
        marks.volume.update_one(*event)
        most = [max(n, int(cells.sum())) for n, cells in zip(most, marks.steps(), strict=True)]
    assert most == [9, 9, 9]


def test_several_events_mark_all_that_their_pixels_reach_and_no_more_than_each_alone():
    together, alone = Marks(CASE), [Marks(CASE) for _ in range(4)]
    events = [(100, 3, 5, 1), (200, 30, 5, 0), (300, 4, 6, 1), (400, 17, 31, 1)]
    at_least, at_most = np.zeros((2, 17, 17), bool)
    for marks, (t, x, y, p) in zip(alone, events, strict=True):
        marks.volume.update_one(t, x, y, p)
        together.volume.update_one(t, x, y, p)
        at_least |= np.outer(reached(y, y, 17), reached(x, x, 17))  # untransformed, an event is all in its pixel
        at_most |= marks.steps()[0]
    found = together.steps()[0]
    assert not (at_least & ~found).any() and not (found & ~at_most).any() and at_least.sum() == 12


def test_an_event_that_the_transform_drops_marks_nothing():
    marks = Marks(CASE, {"transform": "tnt", "landmark": "center", "t_max": 2.0})
    marks.volume.update_one(3000, 17, 17, 1)
    assert marks.steps()[0].any()
    before = marks.network.maps.copy()
    for t, x in ((0, 17), (10, 33), (20, 0)):  # TNT time zero; far outside of the grid
        marks.volume.update_one(t, x, 5, 1)
        assert [cells.sum() for cells in marks.steps()] == [0, 0, 0]
    assert marks.volume.counts.kept == 1 and marks.volume.n_events == 4
    assert marks.network.maps.tobytes() == before.tobytes()


def test_events_that_cancel_mark_nothing():
    marks = Marks(CASE)
    marks.volume.update(([500, 500], [17, 17], [9, 9], [1, 0]))
    assert [cells.sum() for cells in marks.steps()] == [0, 0, 0]


def test_where_a_relu_holds_back_the_change_ends():
    """A network that answers only to ON events: an OFF event reaches the first map, and nothing behind it."""
    case = Case((34, 34), 1, "signed", "none", (1, 1, 1), 1)
    marks = Marks(case)
    weights, layout = marks.network.weights, marks.network.layout
    assert (weights[layout[L.CONV_1] : layout[L.BIAS_1]] >= 0).all()
    weights[layout[L.BIAS_1]] = 0
    marks.network.dirty[:] = 1
    marks.steps()
    marks.volume.update_one(500, 17, 17, 0)
    assert [cells.sum() > 0 for cells in marks.steps()] == [True, False, False]
    marks.volume.update(([500, 500], [17, 17], [17, 17], [1, 1]))
    assert [cells.sum() > 0 for cells in marks.steps()] == [True, True, True]


@pytest.mark.parametrize("case", [CASES[7], CASES[10]], ids=str)
def test_another_window_marks_only_where_the_two_differ(case):
    """A window is over and the next begins with nearly the same events: what is the same is not computed again."""
    events = random_events(300, seed=3, duration_us=3900, sensor=case.config.sensor)
    marks = Marks(case, {"transform": "none", "landmark": "center"})
    marks.volume.update(events)
    marks.steps()
    marks.volume.open(0)
    marks.volume.update(events)
    assert [cells.sum() for cells in marks.steps()] == [0, 0, 0]
    marks.volume.open(0)
    marks.volume.update(events)
    marks.volume.update_one(3999, 9, 9, 1)
    first = marks.steps()[0]
    assert 1 <= first.sum() <= 9 and first[4, 4]


def test_the_log_gives_the_same_marks_as_all_cells():
    followed, looked = Marks(CASES[7]), Marks(CASES[7])
    for event in random_events(200, seed=4, duration_us=3900).tolist():
        for marks in (followed, looked):
            marks.volume.update_one(*event)
        looked.network.layout[L.EPOCH] = 0
        for one, other in zip(followed.steps(), looked.steps(), strict=True):
            assert not (other & ~one).any()  # the log may mark a pixel more: the cell's share there was zero
    assert followed.network.maps[: followed.network.layout[L.TILE]].tobytes() == (
        looked.network.maps[: looked.network.layout[L.TILE]].tobytes()
    )
    assert int(followed.volume.buffer.view(np.int64)[S.N_LOG]) == 200
