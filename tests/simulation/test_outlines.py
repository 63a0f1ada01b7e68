"""The outlines of objects of pictures, which move with them."""

import numpy as np
import pytest

from async_tnt.simulation import picture_scene
from async_tnt.simulation.outlines import MOMENTS, POINTS, farthest_points, moved_points
from async_tnt.simulation.picture_scene import SceneSettings, record_picture
from async_tnt.simulation.pictures import Picture


def block(light=1.0):
    """A block of 12 x 24 places, a quarter of which is cut off."""
    cover = np.ones((12, 24), np.float32)
    cover[:6, :12] = 0.0
    return Picture(np.full((12, 24), light, np.float32) * cover, cover, 0.1)


def test_the_farthest_points_are_those_of_the_object():
    cover = np.zeros((20, 30))
    cover[5:9, 10:17] = 0.6
    cover[0, 0] = 0.4
    points = farthest_points(cover)
    assert points.shape == (POINTS, 2)
    assert points.min(axis=0).tolist() == [10, 5] and points.max(axis=0).tolist() == [16, 8]
    # of a disc they are on its border, each in its direction
    y, x = np.mgrid[:81, :81] - 40
    disc = farthest_points((np.hypot(x, y) < 40).astype(float)) - 40
    angles = 2 * np.pi * np.arange(POINTS) / POINTS
    ways = disc[:, 0] * np.cos(angles) + disc[:, 1] * np.sin(angles)
    np.testing.assert_allclose(ways, 39.5, atol=0.8)


def test_an_object_of_no_place_is_all_places():
    points = farthest_points(np.full((4, 6), 0.2))
    assert points.min(axis=0).tolist() == [0, 0] and points.max(axis=0).tolist() == [5, 3]


def test_points_turn_and_grow_about_the_centre_and_move_with_it():
    points = np.array([[12.0, 10.0], [10.0, 9.0]])
    shares = np.array([0.0, 0.5, 1.0])
    displacement = np.array([[0.0, 0.0], [4.0, 2.0], [4.0, 2.0]])
    turn = np.array([[0.0, 0.0], [0.0, 0.0], [np.pi / 2, np.log(2.0)]])
    moved = moved_points(points, np.array([10.0, 10.0]), shares, displacement, turn)
    assert moved.shape == (MOMENTS, 2, 2) and moved.dtype == np.float32
    np.testing.assert_allclose(moved[0], points)
    # from x to y, twice as far from the centre
    np.testing.assert_allclose(moved[-1], [[14, 16], [16, 12]], atol=1e-5)
    halfway = moved[MOMENTS // 2 - 1 : MOMENTS // 2 + 1, 0].mean(axis=0)
    np.testing.assert_allclose(halfway, [16, 12], atol=0.2)


@pytest.mark.parametrize("settings", [{}, {"follow": True}, {"cut_out": True}])
def test_events_lie_around_the_outline(settings, monkeypatch):
    """Where it is when they happen, or where they have moved until then."""
    monkeypatch.setattr(picture_scene, "TEXTURED", 0.0)  # a texture has events, too
    scene = SceneSettings((80, 80), 50_000, size=(0.3, 0.5), **settings)
    n_seen = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        events, outline = record_picture(block(), scene, rng)
        assert outline.shape == (MOMENTS, POINTS, 2)
        low = outline.min(axis=1)
        high = outline.max(axis=1)
        longer = (high - low).max(axis=1)
        assert (longer > 0.2 * 80).all() and (longer < 0.5 * 80 * 1.5).all()
        at = events["t"] / 50_000 * (MOMENTS - 1)
        k = np.clip(np.rint(at).astype(int), 0, MOMENTS - 1)
        places = np.stack([events["x"], events["y"]], axis=1)
        near = (places > low[k] - 5) & (places < high[k] + 5)
        is_near = near.all(axis=1)
        if len(events) > 2_000:
            n_seen += 1
            # the others are noise, or after-pulses
            assert is_near.mean() > 0.6
    assert n_seen > 5


def test_a_sensor_that_is_cut_out_shows_all_sizes_and_all_of_the_motion():
    scene = SceneSettings((200, 200), 50_000, size=(0.05, 0.4), cut_out=True)
    sides = []
    for seed in range(60):
        events, outline = record_picture(block(), scene, np.random.default_rng(seed))
        sides.append((outline.max(axis=1) - outline.min(axis=1)).max())
        assert (outline >= 0).all() and (outline <= 199).all()
        if len(events):
            middle = (outline.max(axis=(0, 1)) + outline.min(axis=(0, 1))) / 2
            np.testing.assert_allclose(middle, 100, atol=20)
    # as many small ones as large ones: log-uniform from 10 to 80 pixels
    assert 0.3 < np.mean(np.array(sides) < 28) < 0.7


def test_a_sensor_cannot_both_follow_and_be_cut_out():
    with pytest.raises(ValueError, match="may follow its object, or be cut out for it"):
        SceneSettings((80, 80), 50_000, follow=True, cut_out=True)
