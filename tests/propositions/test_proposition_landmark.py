"""Translation: a landmark that moves along takes it away altogether.

Proposition 3 of Wang 2019, arXiv:1911.12801.

    TNT(e + a, l + a) = TNT(e, l)        since u_i = (x_i + a - (l + a)) / tau_i + c

For it, a landmark l(e) that events define must be equivariant: l(e + a) = l(e) + a. Centroids and
fitted lines are. So is the centroid of a heatmap that a convolution draws, as far as the heatmap
has nothing outside the object.
"""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made import nasty_streams, opened
from tnt_reference import LandmarkRegressor, event_volume, tnt_coordinates, tnt_volume

from async_tnt import TNTConfig
from async_tnt.kernels.volume import state as S

WINDOW_US = 800
SENSOR = (34, 34)


def cells(volume):
    """The sums themselves, float64: rounded to float32, they would be equal too easily."""
    return volume._buffer[S.CELLS : volume._ints[S.LOG]]


def shifted(events, a):
    """A copy of the events, moved by (x, y)."""
    moved = events.copy()
    moved["x"] += a[0]
    moved["y"] += a[1]
    return moved


@given(st.data())
def test_proposition_3_in_the_stream_to_the_last_bit(data):
    """The landmarks are `running` and `line`, and translations are by whole pixels.

    n x - S_x, of which all else is made, is the same integer for x + a. It is so on a grid of
    another size than the sensor's as well.
    """
    config = TNTConfig(
        window_us=WINDOW_US,
        grid=data.draw(st.sampled_from([(34, 34), (20, 27)])),
        landmark=data.draw(st.sampled_from(["running", "line"])),
        t_max=data.draw(st.sampled_from([1.0, 2.0, 8.0])),
        polarity=data.draw(st.sampled_from(["signed", "unsigned", "split"])),
    )
    if config.landmark == "line":
        config = config.replace(remove_flow=data.draw(st.booleans()))
    events = data.draw(nasty_streams((20, 14), WINDOW_US, 0))
    a = data.draw(st.integers(0, 14)), data.draw(st.integers(0, 20))
    here = opened(config, events)
    there = opened(config, shifted(events, a))
    assert cells(there).tobytes() == cells(here).tobytes()
    assert there.array.tobytes() == here.array.tobytes()
    assert there.counts == here.counts
    if len(events):
        step = np.multiply(a, np.subtract(config.grid, 1) / np.subtract(SENSOR, 1))
        assert np.subtract(there.landmark, here.landmark) == pytest.approx(step, abs=1e-12)


# -- fractions of a pixel: the reference -----------------------------------------------------------

AT = dict(start_us=0, window_us=WINDOW_US, sensor=(57, 57), grid=(57, 57))


def real_valued(n=500):
    """Events of an object about 10 px across, anywhere between pixels; (t, x, y, p)."""
    g = torch.Generator().manual_seed(1)
    t = torch.randint(100, WINDOW_US + 1, (n,), generator=g).sort().values
    x, y = torch.rand(2, n, generator=g, dtype=torch.float64) * 10 + 12
    return t, x, y, torch.randint(0, 2, (n,), generator=g)


@pytest.mark.parametrize(
    "landmark", ["running", "line", "window", "line, flow removed", "a point", "a point an event"]
)
def test_proposition_3_for_any_translation(landmark):
    """Coordinates and volumes are the same to 1e-12.

    A given landmark is translated with the stream. The others move by themselves.
    """
    a = (1 / 3, 21.7)
    t, x, y, p = real_valued()
    if landmark.startswith("a point"):
        here = torch.tensor([16.2, 17.0], dtype=torch.float64)
        if landmark == "a point an event":
            here = torch.stack([x.roll(3) + 0.7, y.flip(0)], 1)
        there = here + torch.tensor(a, dtype=torch.float64)
    else:
        here = landmark.removesuffix(", flow removed")
        there = here
    options = dict(AT, t_max=2.0, remove_flow=landmark == "line, flow removed")
    columns = (t, x, y)
    moved_columns = (t, x + a[0], y + a[1])

    one = tnt_coordinates(*columns, **options, landmark=here)
    other = tnt_coordinates(*moved_columns, **options, landmark=there)
    assert one.kept.sum() > 300
    assert torch.equal(one.kept, other.kept)
    assert (other.u - one.u).abs().max() < 1e-12
    assert (other.v - one.v).abs().max() < 1e-12

    options["dtype"] = torch.float64
    volume = tnt_volume(*columns, p, **options, landmark=here)
    moved_volume = tnt_volume(*moved_columns, p, **options, landmark=there)
    assert volume.abs().max() > 1
    assert (moved_volume - volume).abs().max() < 1e-12


def test_the_softmax_of_the_regressor_follows_as_far_as_its_mass_lies_on_the_object():
    """In `LandmarkRegressor`, h = exp(...) > 0 everywhere: empty cells hold mass, which stays.

    With its starting weights, the regressor does not follow a translation by 16 px at all. With
    small ones it follows by a part. Where the object's cells outweigh the 57 x 57 others, it
    follows by all of it, to 1e-6 px.
    """
    torch.manual_seed(0)
    network = LandmarkRegressor(9, (57, 57), n_filters=4).double().requires_grad_(False)
    for convolution in (network.conv1, network.conv2, network.conv3):
        convolution.bias.zero_()
        convolution.weight.abs_()
    t, x, y, p = real_valued()
    volumes = [
        event_volume(t, x + a, y, p, **AT, polarity="unsigned", dtype=torch.float64)
        for a in (0, 16)
    ]
    follows = []
    for weight in (0.0, 0.05, 10.0):
        network.heatmap.weight.fill_(weight)
        here = network(volumes[0])
        there = network(volumes[1])
        follows.append((there - here)[0].item() / 16)
    assert follows[0] == 0
    assert 0.05 < follows[1] < 0.95
    assert follows[2] == pytest.approx(1, abs=1e-6 / 16)
