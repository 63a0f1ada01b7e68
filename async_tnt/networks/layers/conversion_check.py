"""Whether the layers that were read from a network of another program compute what the network
does."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from async_tnt.base.checks import one_line

TOLERANCE = 1e-4
Function = Callable[[np.ndarray], np.ndarray]
"""Volume (C, H, W) -> numbers."""


def expect_form(condition: bool, what: str) -> None:
    """Refuse what a network of another program does, and this package cannot, by its name."""
    if not condition:
        raise NotImplementedError(f"{what} has no compiled form")


def compare(
    original: Function, layers: Function, shape: tuple[int, ...], tolerance: float = TOLERANCE
) -> None:
    """Compare a network with the layers that were read from it, on all of `volumes_to_compare`.

    Raises
    ------
    ValueError : their numbers differ by more than `tolerance` of a volume's largest (or of 1 % of
        the largest for any volume, or of 0.01: smaller ones make no difference to a softmax); or
        the network fails on a volume.
    """
    pairs = []
    for volume in volumes_to_compare(shape):
        try:
            expected = original(volume.copy())  # which may be changed in place
        except Exception as error:  # of any type
            raise ValueError(f"it fails on a volume of shape {shape}: {one_line(error)}") from None
        found = layers(volume).reshape(-1)
        if expected.size != found.size:
            raise ValueError(f"it gives numbers of shape {expected.shape}, its layers {found.size}")
        pairs.append((expected.reshape(-1), found))
    largest = [
        float(np.abs(expected[np.isfinite(expected)]).max(initial=0.0)) for expected, _ in pairs
    ]
    for (expected, found), own in zip(pairs, largest, strict=True):
        bound = tolerance * max(own, max(largest) / 100, 0.01)
        if not np.allclose(found, expected, rtol=0.0, atol=bound, equal_nan=True):
            difference = np.abs(found - expected).max()
            raise ValueError(
                f"its layers compute other numbers (by {difference:.2g}, where the largest is "
                f"{own:.2g})"
            )


def volumes_to_compare(shape: tuple[int, ...]) -> Iterator[np.ndarray]:
    """Volumes (C, H, W), float32: normal numbers, sparse counts, these times 100, only negative
    numbers, zeros, and counts that are dense in one corner, as of an object."""
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(2, *shape)).astype(np.float32)
    counts = (rng.poisson(0.05, (2, *shape)) * rng.choice([-1, 1], (2, *shape))).astype(np.float32)
    yield from (*normal, *counts, 100 * counts[0], -np.abs(normal[0]), np.zeros(shape, np.float32))
    corner = np.zeros(shape, np.float32)
    corner[:, : 1 + shape[1] // 2, : 1 + shape[2] // 2] = 1
    yield 3 * rng.poisson(2.0, shape).astype(np.float32) * corner
