"""Landmarks by hand, and the law each obeys on an object that moves at constant flow."""

import pytest
import torch
from tnt_reference import fitted_flow, landmark, tnt_coordinates, tnt_volume

SMALL = dict(start_us=100, window_us=8, sensor=(9, 5), grid=(5, 3))  # x_g = x/2, y_g = y/2; c = (2, 1)


def rows(name, t, x, y, **options):
    return landmark(name, t, x, y, **{**SMALL, **options}).tolist()


def test_center():
    assert rows("center", [101, 102], [0, 8], [4, 0]) == [[2.0, 1.0], [2.0, 1.0]]


def test_running_is_the_prefix_mean():
    assert rows("running", [101, 102, 103], [2, 4, 0], [1, 3, 2]) == [[1.0, 0.5], [1.5, 1.0], [1.0, 1.0]]


def test_window_is_the_mean_of_all():
    assert rows("window", [101, 102, 103], [2, 4, 0], [1, 3, 2]) == [[1.0, 1.0]] * 3


def test_line_is_the_ridge_intercept_of_the_prefix():
    t, x, y = [102, 106, 108], [2, 6, 7], [4, 0, 2]  # f = 0.25, 0.75, 1
    # 1 event:  C = 0: the event itself.
    # 2 events: mean_x 4, mean_f 1/2, C_xf = 2 (2/4) = 1, C_ff = 1/8: m = 8/9, l = 4 - 4/9 = 32/9.
    #           y: mean 2, C_yf = -1, m = -8/9, l = 2 + 4/9 = 22/9.
    # 3 events: mean_x 5, mean_f 2/3, df = -5/12, 1/12, 4/12; C_ff = 42/144 = 7/24;
    #           C_xf = (15 + 1 + 8)/12 = 2: m = 2/(31/24) = 48/31, l = 5 - 32/31 = 123/31.
    #           C_yf = (2 (-5) - 2 (1) + 0)/12 = -1: m = -24/31, l = 2 + 16/31 = 78/31.
    in_pixels = [[2, 4], [32 / 9, 22 / 9], [123 / 31, 78 / 31]]
    flow_in_pixels = [[0, 0], [8 / 9, -8 / 9], [48 / 31, -24 / 31]]
    assert torch.tensor(rows("line", t, x, y)) * 2 == pytest.approx(torch.tensor(in_pixels))
    assert fitted_flow(t, x, y, **SMALL) * 2 == pytest.approx(torch.tensor(flow_in_pixels))


def test_events_outside_the_window_take_no_part():
    t, x, y = [99, 101, 109, 102, 0], [8, 2, 8, 4, 8], [4, 1, 4, 3, 4]
    inside = [1, 3]
    for name in ("running", "line", "window"):
        every = landmark(name, t, x, y, **SMALL)
        alone = landmark(name, [101, 102], [2, 4], [1, 3], **SMALL)
        assert torch.equal(every[inside], alone)
        assert every[[0, 2, 4]].tolist() == [[2.0, 1.0]] * 3  # the centre: filled in, never read
    assert fitted_flow(t, x, y, **SMALL)[[0, 2, 4]].tolist() == [[0.0, 0.0]] * 3


def test_prefix_rows_do_not_depend_on_later_events():
    generator = torch.Generator().manual_seed(5)
    t = torch.randint(100, 109, (40,), generator=generator)
    x = torch.randint(0, 9, (40,), generator=generator)
    y = torch.randint(0, 5, (40,), generator=generator)
    for name in ("running", "line"):
        whole = landmark(name, t, x, y, **SMALL)
        for n in range(41):
            prefix = landmark(name, t[:n], x[:n], y[:n], **SMALL)
            torch.testing.assert_close(prefix, whole[:n], rtol=0, atol=1e-12)  # order of summation


def test_line_in_chunks_of_prefixes_equals_all_at_once(monkeypatch):
    generator = torch.Generator().manual_seed(6)
    t = torch.randint(100, 109, (50,), generator=generator)
    x = torch.randint(0, 9, (50,), generator=generator)
    y = torch.randint(0, 5, (50,), generator=generator)
    whole = landmark("line", t, x, y, **SMALL)
    for chunk_cells in (1, 50, 150, 2450):  # 1, 1, 3 and 49 prefixes at a time
        monkeypatch.setattr("tnt_reference.landmarks._CHUNK_CELLS", chunk_cells)
        torch.testing.assert_close(landmark("line", t, x, y, **SMALL), whole, rtol=0, atol=1e-12)


def test_line_is_accurate_for_a_late_burst():
    """1,000 events within 1,000 us of a 10-second window, at f = 0.9: C_ff is tiny, mean_f^2 is not."""
    t = torch.arange(9_000_000, 9_001_000)
    x = torch.arange(1000) % 34
    window_us, n = 10_000_000, 1000
    # In integers: df = (t - mean)/window, sum (t - mean)^2 = n (n^2 - 1)/12.
    c_ff = n * (n * n - 1) / 12 / window_us**2
    two_mean_x, two_mean_t = 2 * int(x.sum()) / n, 2 * 9_000_000 + 999
    c_xf = sum((2 * int(a) - two_mean_x) * (2 * int(b) - two_mean_t) for a, b in zip(x, t, strict=True))
    m = c_xf / 4 / window_us / (c_ff + 1)
    expected = two_mean_x / 2 - m * two_mean_t / 2 / window_us
    got = landmark("line", t, x, x, start_us=0, window_us=window_us, sensor=(34, 34), grid=(34, 34))
    assert got[-1, 0].item() == pytest.approx(expected, abs=1e-12)


# An object that moves at constant flow while events arrive evenly: event i at f_i = i/n, i = 0..n-1, so that
# the mean of f over events 0..i is exactly f_i/2. x is real-valued: no rounding to pixels hides the law.
N_EVENTS, T_MAX = 1300, 2.0
WIDE = dict(start_us=0, window_us=10 * N_EVENTS, sensor=(41, 41), grid=(41, 41), t_max=T_MAX)


def object_in_motion(flow):
    """The same 1,300 points of an object 6 px across; `flow` in grid pixels per window, along x."""
    generator = torch.Generator().manual_seed(7)
    shape = torch.rand(N_EVENTS, 2, generator=generator, dtype=torch.float64) * 6 + 12
    i = torch.arange(N_EVENTS)
    return dict(t=10 * i, x=shape[:, 0] + flow * i.double() / N_EVENTS, y=shape[:, 1])


def shifts(name, flow, **options):
    """How far the flow moved each event in the transformed grid; event 0 has tau = 0."""
    moving = tnt_coordinates(**object_in_motion(flow), **WIDE, landmark=name, **options)
    still = tnt_coordinates(**object_in_motion(0.0), **WIDE, landmark=name, **options)
    torch.testing.assert_close(moving.v, still.v, rtol=0, atol=1e-12)
    return (moving.u - still.u)[1:]


def assert_shifts(got, expected):
    torch.testing.assert_close(got, expected.expand_as(got), rtol=0, atol=1e-9)


I = torch.arange(1, N_EVENTS, dtype=torch.float64)  # noqa: E741
RIDGE = 1 + (I + 1) * ((I + 1) ** 2 - 1) / 12 / N_EVENTS**2  # C_ff + 1 over events 0..i


def test_any_fixed_point_turns_flow_into_a_translation_by_all_of_it():
    """Proposition 2 of the thesis, exactly; what `center` lacks is the object's own place."""
    for fixed in ("center", (15.0, 15.0)):
        assert_shifts(shifts(fixed, flow=8.0), torch.tensor(4.0, dtype=torch.float64))


def test_running_turns_flow_into_a_translation_by_half_of_it():
    """v = 8 px per window and t_max = 2: every event shifts by 8/(2 * 2) = 2 px, the first as the last."""
    assert_shifts(shifts("running", flow=8.0), torch.tensor(2.0, dtype=torch.float64))


def test_line_turns_flow_into_a_translation_by_all_of_it_up_to_its_ridge():
    """v/t_max (1 - 1/(2 (C_ff + 1))): of 4 px, 2.20 after a tenth of the window, 3.98 at its end."""
    got = shifts("line", flow=8.0)
    assert_shifts(got, 4 * (1 - 1 / (2 * RIDGE)))
    assert got[129].item() == pytest.approx(2.200, abs=0.001)
    assert got[649].item() == pytest.approx(3.863, abs=0.001)
    assert got[-1].item() == pytest.approx(3.982, abs=0.001)


def test_remove_flow_takes_the_translation_away_again():
    """What is left, v/(2 t_max (C_ff + 1)), is the ridge's doing: 0.018 px of 4 at the window's end."""
    got = shifts("line", flow=8.0, remove_flow=True)
    assert_shifts(got, 4 / (2 * RIDGE))
    assert got[-1].item() == pytest.approx(0.018, abs=0.001)


def test_window_centroid_leaves_no_translation():
    """v/t_max (1 - T/2t): -4 px at a quarter of the window, 0 at its middle, +2 at its end."""
    got = shifts("window", flow=8.0)
    assert_shifts(got, 4 * (1 - (N_EVENTS - 1) / (2 * I)))
    assert got[324].item() == pytest.approx(-4, abs=0.01)
    assert got[649].item() == pytest.approx(0, abs=0.01)
    assert got[-1].item() == pytest.approx(2, abs=0.01)


def test_volumes_of_a_moving_and_a_still_object_are_translates_under_running_but_not_under_window():
    p = torch.arange(N_EVENTS) % 3 > 0

    def volume(name, flow):
        return tnt_volume(**object_in_motion(flow), p=p, **WIDE, landmark=name, dtype=torch.float64)

    def differences(name):
        """Largest difference for each whole shift; columns that the border may cut are left out."""
        moving, still = volume(name, flow=8.0), volume(name, flow=0.0)
        assert still.abs().max() > 1
        inner = slice(6, 35)
        return {k: (moving.roll(-k, dims=2) - still)[..., inner].abs().max() / still.abs().max() for k in range(-5, 6)}

    assert differences("running")[2] < 1e-9
    assert min(differences("window").values()) > 0.3
