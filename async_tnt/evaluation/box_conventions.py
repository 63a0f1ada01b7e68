"""Which boxes count in the scores of a data set, by a convention of its field.

Gen1 and 1Mpx are scored by Prophesee's toolbox and copies of it. They first leave out some boxes,
by the same rule in the tables and among the boxes that were found. A box counts if

    t > 500,000 us,  width >= side,  height >= side,  width^2 + height^2 >= diagonal^2

with a side of 10 pixels and a diagonal of 30 (Gen1), or 20 and 60 (1Mpx). Then times at which no
box of the table is left are left out as well, so what is found there is neither right nor wrong.
Gen1's class 0 is a car and class 1 a pedestrian.

Two details of these programs are not followed. They accept a box that is found up to 50 ms away
from a time of the table; here objects are found at exactly these times. And `psee_evaluator.py` of
the toolbox itself skips .1 s and has the least sides of the two sets exchanged. Its README, the
defaults of its filter and the other programs agree on the numbers above.

References
----------
- https://github.com/prophesee-ai/prophesee-automotive-dataset-toolbox, commit c09d34a, in `src`:
  `io/box_filtering.py` and `metrics/coco_eval.py`
- https://github.com/uzh-rpg/RVT, commit b80f568, `utils/evaluation/prophesee`; the same code is in
  https://github.com/uzh-rpg/ssms_event_cameras, commit 7c871b5
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from async_tnt.evaluation.object_tables import ObjectTable
from async_tnt.kernels.decisions.objects import HEIGHT, WIDTH


class Convention(NamedTuple):
    """Which boxes count, of those in a table and of those that were found. Others are left out."""

    skipped_us: int = -1
    """Boxes at this time, in microseconds, or before it do not count."""
    least_side_px: float = 0.0
    """The least width and height of a box. A point has sides of 0."""
    least_diagonal_px: float = 0.0
    """The least diagonal of a box."""

    def counts(self, t_us: np.ndarray, width: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Whether each box counts: bool, (N,). `t_us` may be one time for all."""
        is_large = np.minimum(width, height) >= self.least_side_px
        is_long = width**2 + height**2 >= self.least_diagonal_px**2
        counted: np.ndarray = (t_us > self.skipped_us) & is_large & is_long
        return counted

    def of_table(self, table: ObjectTable) -> ObjectTable:
        """The table without the rows that do not count. It may be empty."""
        counted = self.counts(table.t, table.size[:, 0], table.size[:, 1])
        return replace(
            table,
            t=table.t[counted],
            label=table.label[counted],
            middle=table.middle[counted],
            reach=table.reach[counted],
            size=table.size[counted],
        )

    def of_found(self, found: np.ndarray, t_us: int) -> np.ndarray:
        """The rows of found objects that count, in the same order.

        found : float64, (M, FOUND_SIZE), see `kernels.decisions.objects`.
        t_us : the time at which they were found.
        """
        counted = self.counts(np.array(t_us), found[:, WIDTH], found[:, HEIGHT])
        kept: np.ndarray = found[counted]
        return kept


ALL_BOXES = Convention()
"""All boxes and points count, at all times of a table."""

CONVENTIONS = {
    "all": ALL_BOXES,
    "gen1": Convention(500_000, 10.0, 30.0),
    "1mpx": Convention(500_000, 20.0, 60.0),
}
"""Name -> convention."""
