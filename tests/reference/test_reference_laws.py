"""What holds for every stream: sums, derivatives, order, and that no input gives inf or NaN."""

import pytest
import torch
from tnt_reference import event_volume, fitted_flow, landmark, tnt_coordinates, tnt_volume

LANDMARKS = ("center", "running", "line", "window")
WINDOW = dict(start_us=1_000, window_us=5_000, sensor=(12, 9), grid=(8, 7))
VOLUME = dict(WINDOW, bins=5)


def stream(n=60, seed=0):
    """Random integer events, some at the window's ends and some outside it."""
    g = torch.Generator().manual_seed(seed)
    t = torch.randint(900, 6_100, (n,), generator=g)
    x, y = torch.randint(0, 12, (n,), generator=g), torch.randint(0, 9, (n,), generator=g)
    return t, x, y, torch.randint(0, 2, (n,), generator=g)


def smooth_stream(n=7, seed=1):
    """Real-valued events away from cell and border edges, where the volume has a derivative."""
    g = torch.Generator().manual_seed(seed)

    def uniform(low, high):
        return (torch.rand(n, generator=g, dtype=torch.float64) * (high - low) + low).requires_grad_()

    return uniform(3_000, 5_900), uniform(2, 9), uniform(2, 6), torch.randint(0, 2, (n,), generator=g)


@pytest.mark.parametrize("polarity", ["signed", "unsigned", "split"])
@pytest.mark.parametrize("name", ["raw", *LANDMARKS])
def test_volume_sums_to_the_kept_signs(name, polarity):
    t, x, y, p = stream(n=400)
    if name == "raw":
        kept = (t >= 1_000) & (t <= 6_000)
        volume = event_volume(t, x, y, p, **VOLUME, polarity=polarity, dtype=torch.float64)
    else:
        kept = tnt_coordinates(t, x, y, **WINDOW, landmark=name).kept
        volume = tnt_volume(t, x, y, p, **VOLUME, polarity=polarity, landmark=name, dtype=torch.float64)
    n_on, n_off = int((kept & (p == 1)).sum()), int((kept & (p == 0)).sum())
    assert min(n_on, n_off) > 20
    assert (~kept).sum() > 5
    if polarity == "split":
        assert volume.shape == (10, 7, 8)
        assert volume[:5].sum().item() == pytest.approx(n_on)
        assert volume[5:].sum().item() == pytest.approx(n_off)
    else:
        assert volume.shape == (5, 7, 8)
        assert volume.sum().item() == pytest.approx(n_on - n_off if polarity == "signed" else n_on + n_off)


def test_split_recombines_to_signed_and_unsigned():
    events = stream(n=300)
    signed, unsigned, split = (
        tnt_volume(*events, **VOLUME, polarity=name, dtype=torch.float64) for name in ("signed", "unsigned", "split")
    )
    assert split.abs().max() > 1
    torch.testing.assert_close(split[:5] - split[5:], signed, rtol=0, atol=1e-12)
    torch.testing.assert_close(split[:5] + split[5:], unsigned, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "options",
    [
        *({"landmark": name} for name in LANDMARKS),
        {"landmark": "line", "remove_flow": True},
        {"landmark": (3.0, 3.0), "polarity": "split"},
        {"polarity": "unsigned", "t_max": 2.0},
    ],
    ids=str,
)
def test_gradients_of_events(options):
    t, x, y, p = smooth_stream()

    def volume(t, x, y):
        return tnt_volume(t, x, y, p, **VOLUME, **options, dtype=torch.float64)

    assert volume(t, x, y).abs().sum() > 1
    assert torch.autograd.gradcheck(volume, (t, x, y))


def test_gradients_of_raw_events():
    t, x, y, p = smooth_stream()
    assert torch.autograd.gradcheck(lambda t, x, y: event_volume(t, x, y, p, **VOLUME, dtype=torch.float64), (t, x, y))


@pytest.mark.parametrize("n_rows", [0, 7], ids=["(2,)", "(7, 2)"])
def test_gradients_of_a_given_landmark(n_rows):
    t, x, y, p = (column.detach() for column in smooth_stream())
    point = torch.tensor([4.1, 2.9], dtype=torch.float64)
    point = (point.repeat(n_rows, 1) if n_rows else point).requires_grad_()

    def volume(point):
        return tnt_volume(t, x, y, p, **VOLUME, landmark=point, dtype=torch.float64)

    assert volume(point).abs().sum() > 1
    assert torch.autograd.gradcheck(volume, (point,))


def test_gradients_keep_the_sum_on_cell_edges_too():
    """On a whole coordinate k has a kink; whichever side is taken, moving an event must create no mass."""
    x = torch.tensor([4.0], dtype=torch.float64, requires_grad=True)
    volume = event_volume(
        [2_250], x, [4], [1], start_us=1_000, window_us=5_000, sensor=(9, 9), grid=(9, 9), bins=5, dtype=torch.float64
    )
    assert (volume != 0).sum() == 1  # on the edge in all three directions
    (gradient,) = torch.autograd.grad(volume.sum(), x)
    assert gradient.item() == 0


DEGENERATE = {
    "no events": ([], [], [], []),
    "one event": ([2_000], [3], [4], [1]),
    "one event at the start": ([1_000], [3], [4], [1]),
    "all at one timestamp": ([2_000] * 5, [3, 3, 4, 0, 11], [4, 4, 4, 0, 8], [1, 0, 1, 0, 1]),
    "all at the start": ([1_000] * 5, [3, 3, 4, 0, 11], [4, 4, 4, 0, 8], [1, 0, 1, 0, 1]),
    "all outside": ([0, 999, 6_001], [3, 3, 3], [4, 4, 4], [1, 1, 1]),
    "one microsecond after the start": ([1_001], [11], [8], [0]),
}


@pytest.mark.parametrize("case", DEGENERATE)
@pytest.mark.parametrize("name", [*LANDMARKS, (1.0, 2.0)], ids=str)
def test_degenerate_input_gives_finite_values_and_gradients(case, name):
    *where, p = DEGENERATE[case]
    t, x, y = (torch.tensor(column, dtype=torch.float64, requires_grad=True) for column in where)
    u, v, kept = tnt_coordinates(t, x, y, **WINDOW, landmark=name)
    assert u.isfinite().all() and v.isfinite().all() and len(kept) == len(t)
    for remove_flow in {False, name == "line"}:
        volume = tnt_volume(t, x, y, p, **VOLUME, landmark=name, remove_flow=remove_flow)
        assert volume.shape == (5, 7, 8) and volume.isfinite().all()
        gradients = torch.autograd.grad(
            (volume * volume).sum() + u.sum() + v.sum(), (t, x, y), retain_graph=True, allow_unused=True
        )
        assert all(gradient is None or gradient.isfinite().all() for gradient in gradients)


def test_events_at_the_start_are_in_bin_0_of_the_raw_volume_and_dropped_by_the_transform():
    events = DEGENERATE["all at the start"]
    assert event_volume(*events, **VOLUME)[0].sum() == 1  # 3 ON, 2 OFF
    assert event_volume(*events, **VOLUME)[1:].abs().sum() == 0
    for name in LANDMARKS:
        assert tnt_volume(*events, **VOLUME, landmark=name).abs().sum() == 0


def test_no_events_give_zeros_and_no_rows():
    nothing = ([], [], [])
    assert event_volume(*nothing, [], **VOLUME).abs().sum() == 0
    assert tnt_volume(*nothing, [], **VOLUME).abs().sum() == 0
    for name in LANDMARKS:
        assert landmark(name, *nothing, **WINDOW).shape == (0, 2)
    assert fitted_flow(*nothing, **WINDOW).shape == (0, 2)


def test_the_thesis_own_window_keeps_its_last_event_in_the_last_bin():
    t = [7_000, 7_500, 9_000]
    at = dict(start_us=t[0], window_us=t[-1] - t[0], sensor=(5, 5), grid=(5, 5))
    assert event_volume(t, [1, 2, 3], [1, 2, 3], [1, 1, 1], **at)[8, 3, 3] == 1


@pytest.mark.parametrize("name", ["center", "window"])
def test_order_matters_only_to_causal_landmarks(name):
    t, x, y, p = stream(n=100)
    backwards = tuple(column.flip(0) for column in (t, x, y, p))
    forwards = tnt_volume(t, x, y, p, **VOLUME, landmark=name, dtype=torch.float64)
    assert forwards.abs().sum() > 10
    torch.testing.assert_close(
        tnt_volume(*backwards, **VOLUME, landmark=name, dtype=torch.float64), forwards, rtol=0, atol=1e-12
    )


def test_only_the_cast_at_the_end_is_float32():
    events = stream(n=300)
    exact = tnt_volume(*events, **VOLUME, dtype=torch.float64)
    assert tnt_volume(*events, **VOLUME).dtype == torch.float32
    assert torch.equal(tnt_volume(*events, **VOLUME), exact.float())
    assert not torch.equal(exact.float().double(), exact)
