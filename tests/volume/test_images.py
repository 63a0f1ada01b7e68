"""Images of counts and times, by hand. Against the reference: test_volume_equals_reference.py."""

import numpy as np

from async_tnt import TNTConfig, TNTVolume


def image_of(events, **settings):
    volume = TNTVolume(TNTConfig(sensor=(3, 2), window_us=40, transform="none", polarity="split", **settings))
    volume.open(10)
    volume.update(events)
    return volume.array


def test_the_images_of_a_configuration_by_hand():
    events = ([10, 20, 40, 30], [0, 2, 2, 2], [1, 0, 0, 1], [1, 0, 0, 1])  # t, x, y, p; one comes late
    settings = {"grid": (3, 2)}
    on, off = image_of(events, representation="count", **settings)
    assert on.tolist() == [[0, 0, 0], [1, 0, 1]] and off.tolist() == [[0, 0, 2], [0, 0, 0]]
    n_on, t_on, n_off, t_off = image_of(events, representation="count_time", **settings)
    assert np.array_equal(n_on, on) and np.array_equal(n_off, off)
    assert t_on.tolist() == [[0, 0, 0], [0, 0, 0.5]] and t_off.tolist() == [[0, 0, 0.75], [0, 0, 0]]
    assert image_of(events, representation="mean_time", **settings)[1].tolist() == [[0, 0, 0.5], [0, 0, 0]]
    on, off = image_of(events, representation="time_surface", **settings)  # ages: 1, half and a quarter of the window
    newest_on, newest_off = np.exp([-2.0, -1.0]), np.exp(-0.5)
    np.testing.assert_allclose(on, [[0, 0, 0], [newest_on[0], 0, newest_on[1]]], rtol=1e-6)
    np.testing.assert_allclose(off, [[0, 0, newest_off], [0, 0, 0]], rtol=1e-6)


def test_on_a_larger_grid_an_event_is_shared_by_the_cells_around_it():
    """A sensor of 3 pixels on a grid of 4: pixel 1 lies half way between columns 1 and 2."""
    events = ([20, 30], [1, 0], [0, 0], [1, 1])
    settings = {"grid": (4, 2)}
    n_on, t_on, *_ = image_of(events, representation="count_time", **settings)
    assert n_on[0].tolist() == [1, 0.5, 0.5, 0] and t_on[0].tolist() == [0.5, 0.25, 0.25, 0]
    assert image_of(events, representation="mean_time", **settings)[0, 0].tolist() == [0.5, 0.25, 0.25, 0]
