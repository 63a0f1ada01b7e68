"""Cost follows what changed: how many cells are dirty after one event, counted, not timed.

An event writes 2 x 2 pixels x0..x0+1, y0..y0+1 (of two bins). Through a 3x3 convolution and 2x2 pooling pixel x
reaches the pooled cells (x - 1) // 2 to (x + 1) // 2: both pixels together (x0 - 1) // 2 to (x0 + 2) // 2, three
cells where x0 is even and two where it is odd. Three cells k..k+2 reach (k - 1) // 2 to (k + 3) // 2 of the next
map: three again. So no more than nine cells of any map, of 289, 64 and 64 that there are with 34 x 34 pixels.
"""

import numpy as np
import pytest
from incremental.cases import NETWORKS
from made import random_events

from async_tnt.kernels import layout as L
from async_tnt.kernels.dense import forward_partials
from async_tnt.kernels.forward import forward_conv_1, forward_conv_2
from async_tnt.kernels.sync_input import sync_input

RAW = NETWORKS[8]


class Layers:
    """A classifier that runs layer by layer."""

    def __init__(self, **changes) -> None:
        self.network = RAW.classifier().network
        self.volume = RAW.volume(RAW.config.replace(**changes))
        self.volume.open(0)
        assert self.network.dirty.all()  # at first
        self.steps()

    def dirty(self, which: int, rows: int, columns: int) -> np.ndarray:
        """Which cells of a map are dirty: bool (rows, columns)."""
        layout, _, _, dirty = self.network
        n_rows, n_columns = layout[rows], layout[columns]
        flags = dirty[layout[which] : layout[which] + n_rows * (1 + n_columns)]
        cells = flags[n_rows:].reshape(n_rows, n_columns) == 1
        assert not cells[flags[:n_rows] == 0].any()  # a row with a dirty cell is marked itself
        return cells

    def steps(self) -> list[np.ndarray]:
        """Bring all up to date; what was dirty of pooled 1, pooled 2 and the partials on the way."""
        layout, weights, maps, dirty = self.network
        sync_input(self.volume.state(), layout, maps, dirty)
        seen = [self.dirty(L.DIRTY_1, L.ROWS_1, L.COLUMNS_1)]
        forward_conv_1(layout, weights, maps, dirty)
        seen.append(self.dirty(L.DIRTY_2, L.ROWS_2, L.COLUMNS_2))
        forward_conv_2(layout, weights, maps, dirty)
        seen.append(self.dirty(L.DIRTY_3, L.ROWS_2, L.COLUMNS_2))
        forward_partials(layout, weights, maps, dirty)
        assert not dirty.any()  # all done
        return seen

    def counts(self) -> list[int]:
        return [int(cells.sum()) for cells in self.steps()]


def reached(first: int, last: int, n: int) -> np.ndarray:
    """Which of n pooled cells pixels first..last reach."""
    return np.array([any((x - 1) // 2 <= k <= (x + 1) // 2 for x in range(first, last + 1)) for k in range(n)])


@pytest.mark.parametrize("x, n_columns", [(0, 2), (2, 3), (15, 2), (32, 2), (33, 1)])
@pytest.mark.parametrize("y, n_rows", [(17, 2), (18, 3)])
def test_pooled_cells_that_one_event_reaches(x, y, n_columns, n_rows):
    layers = Layers()
    assert layers.counts() == [0, 0, 0]
    layers.volume.update_one(500, x, y, 1)
    seen = layers.steps()
    expected = np.outer(reached(y, min(y + 1, 33), 17), reached(x, min(x + 1, 33), 17))
    assert np.array_equal(seen[0], expected) and seen[0].sum() == n_rows * n_columns
    for cells in seen[1:]:
        assert cells.any(0).sum() <= 3 and cells.any(1).sum() <= 3


@pytest.mark.parametrize("landmark", ["center", "running", "line"])
def test_never_more_than_nine_cells_of_any_map(landmark):
    """Each event of a stream, wherever the transform puts it."""
    layers, most = Layers(transform="tnt", landmark=landmark), [0, 0, 0]
    for event in random_events(400, seed=1, duration_us=3900).tolist():
        layers.volume.update_one(*event)
        most = list(map(max, most, layers.counts()))
    assert most == [9, 9, 9]


def test_the_log_marks_at_least_what_comparing_all_cells_does():
    followed, compared = (Layers(transform="tnt") for _ in range(2))
    for event in random_events(200, seed=4, duration_us=3900).tolist():
        for layers in (followed, compared):
            layers.volume.update_one(*event)
        compared.network.layout[L.EPOCH] = 0
        for one, other in zip(followed.steps(), compared.steps(), strict=True):
            assert not (other & ~one).any()  # the log may mark a pixel more: the event's share there was zero
    n = followed.network.layout[L.TILE]
    assert followed.network.maps[:n].tobytes() == compared.network.maps[:n].tobytes()
