"""Rendering: where pixels land, what luminance they get, and which events follow."""

import numpy as np
import pytest

from experiments.motions.scene import Scene, render, translate
from experiments.motions.trajectories import Saccade

SHARP = Scene(contrast=4.0, gamma=1.0, blur_px=0.0)
POINT = np.zeros((3, 4))
POINT[1, 2] = 1.0  # row 1, column 2


def shown(image, dx, dy, scene=SHARP, sensor=(34, 34)):
    """The image values that the log luminance shows: the inverse of the scene's formula."""
    frames = render(image, np.array([dx]), np.array([dy]), scene=scene, sensor=sensor)
    return (1.0 - np.exp(frames[0])) / (1.0 - 1.0 / scene.contrast)


def test_a_point_moves_along_x_and_y_and_is_split_bilinearly():
    whole = shown(POINT, 5.0, 7.0, sensor=(20, 10))
    assert whole.shape == (10, 20) and np.argwhere(whole > 1e-12).tolist() == [[8, 7]]
    between = shown(POINT, 5.25, 7.5, sensor=(20, 12))
    np.testing.assert_allclose(between[8:10, 7:9], [[0.375, 0.125], [0.375, 0.125]])
    np.testing.assert_allclose([whole.sum(), between.sum()], 1.0)


def test_translate_equals_the_sum_over_the_image_that_defines_it():
    rng = np.random.default_rng(0)
    image = rng.random((4, 5))  # no background around it: every border pixel counts
    dx = rng.uniform(-6.0, 8.0, 60)
    dy = rng.uniform(-6.0, 8.0, 60)
    dx[:5] = [0.0, 1.0, -1.0, 1e3, 4.0]
    dy[:5] = [0.0, -1.0, 2.0, 3.0, -1e15]
    frames = np.full((60, 7, 8), np.nan)
    translate(frames, image, dx, dy)

    def kernel(distance):
        return np.maximum(0.0, 1.0 - np.abs(distance))

    for frame, x0, y0 in zip(frames, dx, dy, strict=True):
        along_x = kernel(np.arange(8)[:, None] - x0 - np.arange(5))  # (8, 5)
        along_y = kernel(np.arange(7)[:, None] - y0 - np.arange(4))  # (7, 4)
        np.testing.assert_allclose(frame, along_y @ image @ along_x.T, atol=1e-12)


def test_log_luminance_spans_the_contrast_either_way():
    at = np.array([0.0])
    dark = render(POINT, at, at, scene=SHARP)
    bright = render(
        POINT, at, at, scene=Scene(contrast=4.0, gamma=1.0, blur_px=0.0, dark_on_bright=False)
    )
    np.testing.assert_allclose([dark.max(), dark.min()], [0.0, -np.log(4.0)], atol=1e-12)
    np.testing.assert_allclose([bright.max(), bright.min()], [0.0, -np.log(4.0)], atol=1e-12)
    assert dark[0, 1, 2] == dark.min() and bright[0, 1, 2] == bright.max()


def test_gamma_is_applied_to_the_image_and_uint8_reaches_full_scale_at_255():
    assert shown(POINT / 2, 0.0, 0.0, Scene(contrast=4.0, gamma=2.0, blur_px=0.0))[
        1, 2
    ] == pytest.approx(0.25)
    np.testing.assert_array_equal(
        shown((POINT * 255).astype(np.uint8), 2.0, 2.0), shown(POINT, 2.0, 2.0)
    )


def test_blur_keeps_the_light_and_has_the_stated_width():
    frame = shown(POINT, 12.0, 12.0, Scene(contrast=4.0, gamma=1.0, blur_px=1.5))
    x = np.arange(34)
    np.testing.assert_allclose([frame.sum(), frame.sum(0) @ x, frame.sum(1) @ x], [1.0, 14.0, 13.0])
    # cut off at 3.3 standard deviations
    assert abs(np.sqrt(frame.sum(0) @ (x - 14.0) ** 2) - 1.5) < 0.05


@pytest.mark.parametrize(
    ("image", "dx", "message"),
    [
        (
            np.zeros((2, 2), int),
            [0.0],
            r"`image` must be uint8 \(0-255\) or floating \(0-1\), got int64",
        ),
        (np.full((2, 2), 1.5), [0.0], r"must lie in \[0, 1\], got 1\.5 to 1\.5"),
        (np.zeros((2, 2)), [np.inf], "must be finite"),
    ],
)
def test_invalid_images_and_displacements_are_refused(image, dx, message):
    with pytest.raises(ValueError, match=message):
        render(image, dx, [0.0])
    with pytest.raises(ValueError, match="`contrast` must be"):
        Scene(contrast=1.0)


def test_saccade_by_hand():
    progress = Saccade(10_000, 40_000, 1.0, 0.0).progress(
        [0, 10_000, 20_000, 30_000, 50_000, 90_000]
    )
    # s(1/4), then halfway
    np.testing.assert_allclose(progress, [0, 0, 10 / 64 - 15 / 256 + 6 / 1024, 0.5, 1, 1])
