"""Rendering: where pixels land, what luminance they get, and which polarity follows."""

import numpy as np
import pytest

from async_tnt.simulation.digits import simulate_digit
from async_tnt.simulation.scene import Scene, render, translate
from async_tnt.simulation.trajectories import ConstantVelocity

SHARP = Scene(contrast=4.0, gamma=1.0, blur_px=0.0)


def point(value=1.0):
    image = np.zeros((3, 4))
    image[1, 2] = value  # row 1, column 2
    return image


def shown(frames, scene=SHARP):
    """The image values that such log luminance shows: the inverse of the scene's formula."""
    return (1.0 - np.exp(frames)) / (1.0 - 1.0 / scene.contrast)


def test_whole_pixel_displacement_moves_column_along_x_and_row_along_y():
    frames = shown(render(point(), np.array([5.0]), np.array([7.0]), scene=SHARP, sensor=(20, 10)))
    assert frames.shape == (1, 10, 20)
    assert np.argwhere(frames[0] > 1e-12).tolist() == [[8, 7]]
    np.testing.assert_allclose(frames[0, 8, 7], 1.0)


def test_fraction_of_a_pixel_is_split_bilinearly():
    frame = shown(render(point(), np.array([5.25]), np.array([7.5]), scene=SHARP, sensor=(20, 12)))[0]
    np.testing.assert_allclose(frame[8:10, 7:9], [[0.375, 0.125], [0.375, 0.125]])
    np.testing.assert_allclose(frame.sum(), 1.0)


@pytest.mark.parametrize("far", [1e3, -1e3, 1e15, -1e15])
def test_image_off_the_sensor_leaves_the_ground(far):
    frames = render(point(), np.array([far, 0.0]), np.array([0.0, far]), scene=SHARP)
    np.testing.assert_array_equal(frames, 0.0)


def test_image_half_off_the_sensor_is_cut_without_wrapping():
    frame = shown(render(np.ones((3, 3)), np.array([-1.5]), np.array([8.0]), scene=SHARP, sensor=(10, 10)))[0]
    np.testing.assert_allclose(frame[8:], [[1, 0.5] + [0] * 8] * 2)
    np.testing.assert_allclose(frame[:8], 0.0)


def test_translate_equals_the_sum_over_the_image_that_defines_it():
    rng = np.random.default_rng(0)
    image = rng.random((4, 5))  # no ground around it: every border pixel counts
    dx, dy = rng.uniform(-6.0, 8.0, 60), rng.uniform(-6.0, 8.0, 60)
    dx[:5], dy[:5] = [0.0, 1.0, -1.0, 3.0, 4.0], [0.0, -1.0, 2.0, 3.0, -3.0]
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
    dark = render(point(), at, at, scene=SHARP)
    bright = render(point(), at, at, scene=Scene(contrast=4.0, gamma=1.0, blur_px=0.0, dark_on_bright=False))
    np.testing.assert_allclose([dark.max(), dark.min()], [0.0, -np.log(4.0)], atol=1e-12)
    np.testing.assert_allclose([bright.max(), bright.min()], [0.0, -np.log(4.0)], atol=1e-12)
    assert dark[0, 1, 2] == dark.min() and bright[0, 1, 2] == bright.max()


def test_gamma_is_applied_to_the_image():
    at = np.array([0.0])
    frame = shown(render(point(0.5), at, at, scene=Scene(contrast=4.0, gamma=2.0, blur_px=0.0)))[0]
    np.testing.assert_allclose(frame[1, 2], 0.25)


def test_blur_keeps_the_light_and_has_the_stated_width():
    scene = Scene(contrast=4.0, gamma=1.0, blur_px=1.5)
    frame = shown(render(point(), np.array([12.0]), np.array([12.0]), scene=scene), scene)[0]
    x = np.arange(34)
    np.testing.assert_allclose(frame.sum(), 1.0)
    np.testing.assert_allclose([frame.sum(0) @ x, frame.sum(1) @ x], [14.0, 13.0])
    assert abs(np.sqrt(frame.sum(0) @ (x - 14.0) ** 2) - 1.5) < 0.05  # cut off at 3.3 standard deviations


def test_uint8_images_reach_full_scale_at_255():
    at = np.array([2.0])
    np.testing.assert_array_equal(
        render((point() * 255).astype(np.uint8), at, at, scene=SHARP), render(point(), at, at, scene=SHARP)
    )


@pytest.mark.parametrize(("angle", "axis", "sign"), [(0, "x", 1), (180, "x", -1), (90, "y", 1), (270, "y", -1)])
@pytest.mark.parametrize("dark_on_bright", [True, False])
def test_on_events_trail_a_dark_digit_and_lead_a_bright_one(angle, axis, sign, dark_on_bright):
    image = np.zeros((28, 28))
    image[11:17, 11:17] = 1.0
    events = simulate_digit(
        image,
        np.random.default_rng(0),
        trajectory=ConstantVelocity.towards(angle, 50.0),
        scene=Scene(dark_on_bright=dark_on_bright),
    )
    on = events["p"] == 1
    offset = sign * (events[axis][on].mean() - events[axis][~on].mean())
    assert offset < -3 if dark_on_bright else offset > 3


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((np.zeros(5), [0.0], [0.0]), r"`image` must be 2-D and not empty, got shape \(5,\)"),
        (
            (np.zeros((2, 2), int), [0.0], [0.0]),
            r"`image` must be uint8 \(0-255\) or floating \(0-1\), got int64",
        ),
        ((np.full((2, 2), 1.5), [0.0], [0.0]), r"must lie in \[0, 1\], got 1\.5 to 1\.5"),
        ((np.full((2, 2), np.nan), [0.0], [0.0]), r"must lie in \[0, 1\]"),
        ((np.zeros((2, 2)), [0.0, 1.0], [0.0]), r"equally long, got shapes \(2,\) and \(1,\)"),
        ((np.zeros((2, 2)), [np.inf], [0.0]), "must be finite"),
    ],
)
def test_what_cannot_be_rendered_is_refused(arguments, complaint):
    with pytest.raises(ValueError, match=complaint):
        render(*arguments)


@pytest.mark.parametrize(
    ("setting", "complaint"),
    [
        ({"contrast": 1.0}, "`contrast` must be"),
        ({"gamma": 0.0}, "`gamma` must be"),
        ({"blur_px": -1.0}, "`blur_px` must be"),
    ],
)
def test_impossible_scenes_are_refused(setting, complaint):
    with pytest.raises(ValueError, match=complaint):
        Scene(**setting)
