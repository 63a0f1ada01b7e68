"""What a model was trained with, by its record, against what it is given."""

import hashlib

import numpy as np
import pytest

from async_tnt.sources.pixel_selection import PixelSelection, difference

MASK = np.zeros((48, 60), bool)
MASK[3, 4] = True
OTHER = ~MASK
SHA = hashlib.sha256(MASK.tobytes()).hexdigest()
ROI = (10, 4, 40, 40)


def record_of(selection, camera=(60, 48)):
    return {"data": {"pixels": {**selection.record, "camera": list(camera)}}}


SELECTIONS = [
    PixelSelection(ROI, True),
    PixelSelection(ROI),
    PixelSelection((0, 0, 40, 40), True),
    PixelSelection(ROI, True, MASK),
    PixelSelection(ROI, True, OTHER),
    PixelSelection(mask=MASK),
    PixelSelection(ROI, True, sensor=(70, 48)),
]


@pytest.mark.parametrize("trained", SELECTIONS[:-1])
def test_the_same_selection_is_silent_and_every_other_one_is_reported(trained):
    for given in [*SELECTIONS, PixelSelection()]:
        assert (difference(record_of(trained), given) == "") == (given == trained)
    assert difference(record_of(trained), PixelSelection(trained.roi, trained.crop, trained.mask, (60, 48))) == ""


def test_the_message_names_both_selections():
    trained = record_of(PixelSelection(ROI, True, MASK))
    was = f"trained with --roi 10,4,40,40 --crop --mask of 1 pixels ({SHA[:16]})"
    assert difference(trained, PixelSelection()) == f"{was}, but now it is all pixels"
    corner = difference(trained, PixelSelection((0, 0, 40, 40), True, MASK))
    assert corner == f"{was}, but now it is --roi 0,0,40,40 --crop --mask of 1 pixels ({SHA[:16]})"
    camera = difference(record_of(PixelSelection(ROI, True)), PixelSelection(ROI, True, sensor=(70, 48)))
    roi = "--roi 10,4,40,40 --crop of a"
    assert camera == f"trained with {roi} 60x48 camera, but now it is {roi} 70x48 camera"


@pytest.mark.parametrize(
    "record",
    [
        {},
        {"data": None},
        {"data": "N-MNIST"},
        {"data": {}},
        {"data": {"pixels": None}},
        {"data": {"pixels": {}}},
        {"data": {"pixels": {"roi": 5, "camera": "60x48"}}},
    ],
)
def test_a_record_that_knows_of_no_selection_says_nothing(record):
    assert difference(record, PixelSelection()) == ""
    if "pixels" not in (record.get("data") or {}):
        assert difference(record, SELECTIONS[3]) == ""
