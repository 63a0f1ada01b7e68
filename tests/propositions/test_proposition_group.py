"""Chapter 2: convolutions over a group are equivariant to it.

Convolutions over translations are equivariant to translations alone. C4 is the group of quarter
turns r of the image about its middle. It has two convolutions, from the image to a map for each
turn s, and from such maps to such maps:

    (f * phi)(s, x)     = (f * L_s phi)(x)
    (F * psi)(s, x)     = sum over turns h of (F(h) * L_s psi(s^-1 h))(x)

Numbers are float64. Images are odd squares with zeros around them, so that a turn moves whole
pixels.
"""

import pytest
import torch
import torch.nn.functional as F

TURNS = range(4)


def random(*shape):
    """Normally distributed numbers, the same for the same shape."""
    generator = torch.Generator().manual_seed(sum(shape))
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def turned(images, k=1):
    """k quarter turns of images or filters."""
    return images.rot90(k, (-2, -1))


def on_torus(images, filters, stride=1):
    """A convolution of images whose borders meet."""
    padded = F.pad(images, [filters.shape[-1] // 2] * 4, mode="circular")
    return F.conv2d(padded, filters, stride=stride)


def lifted(images, filters):
    """The convolution from images to a map for each turn: (N, C, H, W) -> (N, F, 4, H, W)."""
    return torch.stack([F.conv2d(images, turned(filters, s), padding="same") for s in TURNS], 2)


def group_convolution(maps, filters):
    """The convolution of maps with filters, each for four turns.

    (N, C, 4, H, W), (F, C, 4, k, k) -> (N, F, 4, H, W).
    """
    answers = []
    for s in TURNS:
        of_turn = turned(filters.roll(s, 2), s)
        terms = [F.conv2d(maps[:, :, h], of_turn[:, :, h], padding="same") for h in TURNS]
        answers.append(sum(terms))
    return torch.stack(answers, 2)


def turned_maps(maps):
    """Maps after a quarter turn of the image: each map turns, and becomes that of the next turn."""
    return turned(maps).roll(1, 2)


def assert_close(a, b):
    torch.testing.assert_close(a, b, rtol=0, atol=1e-12)


def test_a_convolution_is_equivariant_to_translation():
    images = random(2, 3, 17, 17)
    filters = random(5, 3, 3, 3)
    for by in ((1, 0), (0, -3), (8, 5)):
        found = on_torus(images.roll(by, (2, 3)), filters)
        assert_close(found, on_torus(images, filters).roll(by, (2, 3)))


@pytest.mark.parametrize(
    "layer",
    [
        lambda images: on_torus(images, random(5, 3, 3, 3), stride=2),
        lambda images: F.avg_pool2d(images, 2),
        lambda images: F.max_pool2d(images, 2),
    ],
    ids=["convolution", "average pooling", "maximum pooling"],
)
def test_with_a_stride_of_2_it_is_so_for_even_translations_alone(layer):
    images = random(2, 3, 16, 16)
    assert_close(layer(images.roll(6, 3)), layer(images).roll(3, 3))
    odd = layer(images.roll(5, 3))
    assert min((odd - layer(images).roll(by, 3)).norm() / odd.norm() for by in range(8)) > 0.5


def test_a_convolution_of_a_turned_image_is_one_with_filters_turned_back():
    """(L_r f) * phi = L_r (f * L_r^-1 phi), which is not L_r (f * phi)."""
    images = random(2, 3, 17, 17)
    filters = random(5, 3, 3, 3)
    found = F.conv2d(turned(images), filters, padding="same")
    assert_close(found, turned(F.conv2d(images, turned(filters, -1), padding="same")))
    assert (found - turned(F.conv2d(images, filters, padding="same"))).norm() > 0.5 * found.norm()


def test_convolutions_over_quarter_turns_are_equivariant_to_them():
    """Layer after layer, with ReLUs between them.

    The maximum over turns for a turned image is the turned maximum for the image.
    """
    images = random(2, 3, 17, 17)
    filters = random(5, 3, 3, 3)
    first = lifted(images, filters)
    first_of_turned = lifted(turned(images), filters)
    assert_close(first_of_turned, turned_maps(first))

    more_filters = random(4, 5, 4, 3, 3)
    second = group_convolution(first.relu(), more_filters)
    second_of_turned = group_convolution(first_of_turned.relu(), more_filters)
    assert_close(second_of_turned, turned_maps(second))
    assert_close(second_of_turned.amax(2), turned(second.amax(2)))
    # The maps alone, each of its own turn, are not equivariant.
    assert (second_of_turned - turned(second)).norm() > 0.5 * second.norm()
