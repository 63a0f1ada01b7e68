"""No mask of a masked array is ignored, in events (see also `bad_events.py`) or in any other array."""

import numpy as np
import pytest
from decoding.bad_events import MASKED, SENSOR

from async_tnt import Model, load_model
from async_tnt.events import EventDecoder
from async_tnt.networks.compiled import CompiledClassifier
from async_tnt.representations.motion import move_by_flow
from async_tnt.simulation.scene import render
from async_tnt.simulation.simulator import simulate_events
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_masks import save_mask

MODEL = load_model("digits")


def model_of(weights):
    return Model(MODEL.config, MODEL.weights | {"fc2.bias": weights}, MODEL.classes)


@pytest.mark.parametrize(
    ("name", "take", "array"),
    [
        ("fc2.bias", model_of, MODEL.weights["fc2.bias"]),
        ("volume", CompiledClassifier(MODEL), np.zeros(MODEL.config.shape, np.float32)),
        ("mask", lambda mask: PixelFilter((34, 34), mask=mask), np.zeros((34, 34), bool)),
        ("mask", lambda mask: save_mask("never_written.npy", mask), np.zeros((34, 34), bool)),
        ("x", lambda x: move_by_flow([1, 2], x, [3, 4], (1, 1), start_us=0, window_us=10), np.array([3, 4])),
        ("log_frames", lambda frames: simulate_events(frames, [0, 1], 0.2, 0.2), np.ones((2, 3, 3))),
        ("image", lambda image: render(image, [0.0], [0.0]), np.ones((3, 3))),
    ],
)
def test_other_arrays(name, take, array):
    masked = np.ma.array(array, mask=array == array.flat[0])
    with pytest.raises(TypeError, match=rf"^`{name}` must not be a masked array, .*; pass `\.filled\(value\)`, or"):
        take(masked)


def test_a_masked_number():
    with pytest.raises(TypeError) as told:
        EventDecoder(SENSOR).decode((5, 1, np.ma.masked, 1))
    assert str(told.value) == MASKED.format("y")
