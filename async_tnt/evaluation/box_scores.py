"""COCO's mean average precision of boxes that a map model finds, by pycocotools (extra `boxes`).

References
----------
- Lin et al. 2014, Microsoft COCO: common objects in context, arXiv:1405.0312; the scores are those
  of https://cocodataset.org/#detection-eval.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from async_tnt.base.extras import needs_extra
from async_tnt.evaluation.object_tables import ObjectTable
from async_tnt.kernels.decisions.objects import CLASS, HEIGHT, PROBABILITY, WIDTH, X, Y

SCORES = ("map", "map_50", "map_75", "map_small", "map_medium", "map_large")
"""COCO's first six numbers: over overlaps of .5 to .95, of .5 and of .75 alone, and over the areas
of boxes, below 32 x 32 pixels, up to 96 x 96, and above."""


@dataclass
class FoundBoxes:
    """The boxes of tables, and those that a model has found, at many moments.

    Each moment is what COCO calls an image. One without boxes of the table is an image, too: what
    is found there is wrong. Boxes that do not count, see `Convention`, must not be added.
    """

    _n_moments: int = 0
    _present: list[dict[str, Any]] = field(default_factory=list)
    _found: list[dict[str, Any]] = field(default_factory=list)

    def add(self, table: ObjectTable, rows: slice, found: np.ndarray) -> None:
        """Add a moment.

        Parameters
        ----------
        table, rows : a table, and its rows at this moment. Rows with a width and a height are
            boxes; the others are left out.
        found : float64, (M, FOUND_SIZE), see `kernels.decisions.objects`.
        """
        moment = self._n_moments
        self._n_moments += 1
        size = table.size[rows]
        corner = table.middle[rows] - size / 2
        for k in np.flatnonzero((size > 0).all(axis=1)):
            self._present.append(
                {
                    "id": len(self._present) + 1,
                    "image_id": moment,
                    "category_id": int(table.label[rows][k]),
                    "bbox": [*corner[k].tolist(), *size[k].tolist()],
                    "area": float(size[k].prod()),
                    "iscrowd": 0,
                }
            )
        for found_object in found:
            width, height = found_object[[WIDTH, HEIGHT]].tolist()
            left = float(found_object[X]) - width / 2
            top = float(found_object[Y]) - height / 2
            self._found.append(
                {
                    "image_id": moment,
                    "category_id": int(found_object[CLASS]),
                    "bbox": [left, top, width, height],
                    "score": float(found_object[PROBABILITY]),
                }
            )

    @property
    def n_present(self) -> int:
        """How many boxes the tables have."""
        return len(self._present)

    def scores(self, classes: Sequence[str]) -> dict[str, float | None]:
        """COCO's `SCORES`; None where the tables have no box of these areas.

        Raises
        ------
        ImportError : pycocotools is not installed.
        """
        with needs_extra("boxes", "COCO's scores of boxes need pycocotools"):
            from pycocotools.coco import COCO
            from pycocotools.cocoeval import COCOeval
        if not self._present:
            return dict.fromkeys(SCORES)
        if not self._found:
            return dict.fromkeys(SCORES, 0.0)
        with contextlib.redirect_stdout(io.StringIO()):  # it prints what it does
            present = COCO()
            present.dataset = {
                "info": {},
                "images": [{"id": moment} for moment in range(self._n_moments)],
                "categories": [{"id": k, "name": name} for k, name in enumerate(classes)],
                "annotations": self._present,
            }
            present.createIndex()
            evaluation = COCOeval(present, present.loadRes(self._found), "bbox")
            evaluation.evaluate()
            evaluation.accumulate()
            evaluation.summarize()
        numbers = evaluation.stats[: len(SCORES)].tolist()
        # -1 stands for no box
        return {
            name: None if number < 0 else round(float(number), 5)
            for name, number in zip(SCORES, numbers, strict=True)
        }
