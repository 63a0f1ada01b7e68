"""What a convolution is equivariant to, and what it is not: translations, quarter turns, the group p4.

(L_t f)(x) = f(x - t) translates, L_r turns by quarter turns, f * phi is what networks call a convolution:
(f * phi)(x) = sum_a phi(a) f(x + a). An operator Phi is equivariant to L if Phi(L f) = L' Phi(f).
"""

import pytest
import torch
import torch.nn.functional as F

TURNS = (1, 2, 3)


def random(*shape, seed):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


IMAGE, FILTER = random(2, 15, 15, seed=0), random(3, 2, 3, 3, seed=1)


def turn(f, quarter_turns):
    """L_r: rotate rows and columns, the last two axes."""
    return torch.rot90(f, quarter_turns, dims=(-2, -1))


def difference(a, b):
    return (a - b).abs().max().item()


def test_convolution_is_equivariant_to_translation_away_from_the_border():
    """(L_t f) * phi = L_t (f * phi), stride 1 (Wang 2019; LeCun et al. 1998).

    In a 3 x 3 convolution padded with zeros the outermost pixels are not equivariant: they see the padding.
    """
    moved = torch.zeros_like(IMAGE)
    moved[:, :10, 3:] = IMAGE[:, 5:, :12]  # by (-5, 3)
    of_moved, of_still = (F.conv2d(image[None], FILTER, padding=1)[0] for image in (moved, IMAGE))
    got, expected = of_moved[:, :10, 3:], of_still[:, 5:, :12]  # where both sides lie in the image
    inner = (..., slice(1, -1), slice(1, -1))
    assert difference(got[inner], expected[inner]) < 1e-12 and difference(got, expected) > 1


def test_average_pooling_by_2_is_equivariant_to_even_translations_only():
    """P(L_2k f) = L_k P(f); but for a bar two pixels wide, P(L_1 f) is 1/2 away from every L_k P(f).

    The bar on columns 4 and 5 fills pooled column 2 (value 1); one pixel on it half fills two (1/2, 1/2).
    """
    f = random(1, 8, 16, seed=2)
    for k in TURNS:
        assert difference(F.avg_pool2d(f.roll(2 * k, -1), 2), F.avg_pool2d(f, 2).roll(k, -1)) == 0
    bar = torch.zeros(1, 8, 16)
    bar[..., 4:6] = 1
    pooled, of_moved = F.avg_pool2d(bar, 2), F.avg_pool2d(bar.roll(1, -1), 2)
    assert of_moved[0, 0].tolist() == [0, 0, 0.5, 0.5, 0, 0, 0, 0]
    assert min(difference(of_moved, pooled.roll(k, -1)) for k in range(8)) == 0.5


@pytest.mark.parametrize("r", TURNS)
def test_a_turned_image_needs_the_filter_turned_along(r):
    """(L_r f) * phi = L_r (f * L_r^-1 phi): Cohen and Welling 2016, arXiv:1602.07576; in Wang 2019.

    So (L_r f) * phi is not L_r (f * phi), unless the filter is symmetric under the turn.
    """
    got = F.conv2d(turn(IMAGE, r), FILTER)
    assert difference(got, turn(F.conv2d(IMAGE, turn(FILTER, -r)), r)) < 1e-12
    assert difference(got, turn(F.conv2d(IMAGE, FILTER), r)) > 1
    laplacian = torch.tensor([[0, 1, 0], [1, -4, 1], [0, 1, 0]], dtype=torch.float64).expand(1, 2, 3, 3)
    assert difference(F.conv2d(turn(IMAGE, r), laplacian), turn(F.conv2d(IMAGE, laplacian), r)) < 1e-12


def lift(f):
    """f (C, H, W) -> (4, D, H', W'), functions on p4:  F[r] = f * L_r phi."""
    return torch.stack([F.conv2d(f, turn(FILTER, r)) for r in range(4)])


@pytest.mark.parametrize("s", TURNS)
def test_lifting_to_p4_turns_the_maps_and_permutes_the_orientations(s):
    """lift(L_s f)[r] = L_s lift(f)[r - s] (Cohen and Welling 2016), so the maximum over p4 is invariant.

    Turning without permuting, or permuting without turning, misses by more than 1.
    """
    of_turned, of_f = lift(turn(IMAGE, s)), lift(IMAGE)
    assert difference(of_turned, turn(of_f, s).roll(s, dims=0)) < 1e-12
    assert difference(of_turned.amax((0, 2, 3)), of_f.amax((0, 2, 3))) < 1e-12
    assert min(difference(of_turned, other) for other in (turn(of_f, s), of_f.roll(s, dims=0))) > 1
