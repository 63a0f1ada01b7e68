"""What a convolution is equivariant to, and what it is not: translations, quarter turns, the group p4.

(L_t f)(x) = f(x - t) translates, L_r turns by quarter turns, f * phi is what networks call a convolution:
(f * phi)(x) = sum_a phi(a) f(x + a). An operator Phi is equivariant to L if Phi(L f) = L' Phi(f).
"""

import pytest
import torch
import torch.nn.functional as F

TURNS = (1, 2, 3)


def random(*shape, seed=0, dtype=torch.float64):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def turn(f, quarter_turns):
    """L_r: rotate rows and columns, the last two axes."""
    return torch.rot90(f, quarter_turns, dims=(-2, -1))


def difference(a, b):
    return (a - b).abs().max().item()


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-6), (torch.float64, 1e-12)], ids=str)
def test_convolution_is_equivariant_to_translation_away_from_the_border(dtype, tolerance):
    """(L_t f) * phi = L_t (f * phi), stride 1 (Wang 2019; LeCun et al. 1998). The tolerance is of the largest
    value.

    In a 3 x 3 convolution padded with zeros the outermost pixels are not equivariant: they see the padding.
    """
    f, phi = random(1, 2, 20, 24, dtype=dtype), random(3, 2, 3, 3, seed=1, dtype=dtype)
    t_y, t_x = -5, 3
    moved = torch.zeros_like(f)
    moved[..., : 20 + t_y, t_x:] = f[..., -t_y:, : 24 - t_x]
    of_moved, of_still = (F.conv2d(image, phi, padding=1) for image in (moved, f))
    expected = of_still[..., -t_y:, : 24 - t_x]  # L_t (f * phi), where both sides lie in the image
    got = of_moved[..., : 20 + t_y, t_x:]
    inner = (..., slice(1, -1), slice(1, -1))
    assert expected[inner].abs().max() > 5
    assert difference(got[inner], expected[inner]) <= tolerance * expected.abs().max()
    assert difference(got, expected) > 1


def test_average_pooling_by_2_is_equivariant_to_even_translations_only():
    """P(L_2k f) = L_k P(f); but for a bar two pixels wide, P(L_1 f) is 1/2 away from every L_k P(f).

    The bar on columns 4 and 5 fills pooled column 2 (value 1); one pixel on it half fills two (1/2, 1/2).
    """
    f = random(1, 1, 8, 16)
    for k in (1, 2, 3):
        assert difference(F.avg_pool2d(f.roll(2 * k, -1), 2), F.avg_pool2d(f, 2).roll(k, -1)) == 0
    bar = torch.zeros(1, 1, 8, 16, dtype=torch.float64)
    bar[..., 4:6] = 1
    pooled, of_moved = F.avg_pool2d(bar, 2), F.avg_pool2d(bar.roll(1, -1), 2)
    assert of_moved[0, 0, 0].tolist() == [0, 0, 0.5, 0.5, 0, 0, 0, 0]
    assert min(difference(of_moved, pooled.roll(k, -1)) for k in range(8)) == 0.5


@pytest.mark.parametrize("r", TURNS)
def test_a_turned_image_is_the_turned_convolution_with_the_filter_turned_back(r):
    """(L_r f) * phi = L_r (f * L_r^-1 phi): Cohen and Welling 2016, arXiv:1602.07576; in Wang 2019.

    With the filter not turned, or turned the wrong way, the two sides differ by more than 1.
    """
    f, phi = random(1, 2, 15, 15), random(3, 2, 3, 3, seed=1)
    got = F.conv2d(turn(f, r), phi)
    assert difference(got, turn(F.conv2d(f, turn(phi, -r)), r)) < 1e-12
    assert difference(got, turn(F.conv2d(f, phi), r)) > 1
    if r != 2:  # half a turn is its own inverse
        assert difference(got, turn(F.conv2d(f, turn(phi, r)), r)) > 1


def test_convolution_is_not_equivariant_to_rotation():
    """(L_r f) * phi != L_r (f * phi): d/dx of a vertical edge is 1, of the same edge turned into a horizontal one 0.

    With a filter that is itself symmetric under the turn, the two are equal.
    """
    edge = torch.zeros(1, 1, 9, 9, dtype=torch.float64)
    edge[..., 5:] = 1
    d_dx = torch.tensor([[[[0, 0, 0], [-1, 0, 1], [0, 0, 0]]]], dtype=torch.float64)
    of_turned, turned = F.conv2d(turn(edge, 1), d_dx), turn(F.conv2d(edge, d_dx), 1)
    assert of_turned.abs().max() == 0
    assert turned.max() == 1 and difference(of_turned, turned) == 1
    laplacian = torch.tensor([[[[0, 1, 0], [1, -4, 1], [0, 1, 0]]]], dtype=torch.float64)
    of_turned, turned = F.conv2d(turn(edge, 1), laplacian), turn(F.conv2d(edge, laplacian), 1)
    assert turned.abs().max() == 1 and difference(of_turned, turned) == 0


def lift(f, phi):
    """f (C, H, W), phi (D, C, 3, 3) -> (4, D, H', W'):  F[r] = f * L_r phi."""
    return torch.stack([F.conv2d(f[None], turn(phi, r))[0] for r in range(4)])


def group_convolution(f, psi):
    """f (4, C, H, W), psi (4, D, C, 3, 3) -> (4, D, H', W'):  F[r] = sum_q f[q] * L_r psi[q - r]."""
    return torch.stack([sum(F.conv2d(f[q][None], turn(psi[(q - r) % 4], r))[0] for q in range(4)) for r in range(4)])


def act(f, s):
    """L_s on functions on p4, (4, C, H, W): orientation r goes to r + s, and each map turns by s."""
    return turn(f, s).roll(s, dims=0)


@pytest.mark.parametrize("s", TURNS)
def test_lifting_to_p4_turns_the_maps_and_permutes_the_orientations(s):
    """lift(L_s f)[r] = L_s lift(f)[r - s] (Cohen and Welling 2016). Turning without permuting misses by more than 1."""
    f, phi = random(2, 13, 13), random(3, 2, 3, 3, seed=1)
    got, lifted = lift(turn(f, s), phi), lift(f, phi)
    assert difference(got, act(lifted, s)) < 1e-12
    assert difference(got, turn(lifted, s)) > 1
    assert difference(got, lifted.roll(s, dims=0)) > 1


@pytest.mark.parametrize("s", TURNS)
def test_group_convolutions_on_p4_stay_equivariant_layer_after_layer(s):
    """Phi(L_s f) = L_s Phi(f) for lift, ReLU, group convolution; and the maximum over p4 is invariant.

    A plain convolution over the four orientations as channels, with filters that are not shared over the
    group, in the place of the second layer, misses by more than 1.
    """
    f, phi, psi = random(2, 13, 13), random(3, 2, 3, 3, seed=1), random(4, 5, 3, 3, 3, seed=2)

    def network(f):
        return group_convolution(lift(f, phi).relu(), psi)

    def unshared(f):
        lifted = lift(f, phi).relu()
        return torch.stack([sum(F.conv2d(lifted[q][None], psi[(q - r) % 4])[0] for q in range(4)) for r in range(4)])

    of_turned, of_f = network(turn(f, s)), network(f)
    assert of_f.shape == (4, 5, 9, 9) and of_f.abs().max() > 10
    assert difference(of_turned, act(of_f, s)) < 1e-12
    assert difference(of_turned.amax((0, 2, 3)), of_f.amax((0, 2, 3))) < 1e-12
    assert difference(unshared(turn(f, s)), act(unshared(f), s)) > 1
