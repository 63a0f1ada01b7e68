"""The comparison of a network of another program with the layers that were read from it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from async_tnt.base.messages import one_line
from async_tnt.base.progress import progress

TOLERANCE = 1e-4
"""The largest difference that is accepted, as a share of a volume's largest number."""

LONG_S = 10.0
"""Seconds after which only the volumes of `FIRST` are compared."""

FIRST = (0, 1, 2)
"""The volumes that are compared in any case: any numbers, sparse counts, and an object's events."""

Function = Callable[[np.ndarray], Sequence[np.ndarray]]
"""Volume (C, H, W) -> the numbers of each output."""


def expect_form(condition: bool, what: str) -> None:
    """Raise a NotImplementedError that `what` has no compiled form, unless `condition` holds."""
    if not condition:
        raise NotImplementedError(f"{what} has no compiled form")


def compare(
    original: Function, layers: Function, shape: tuple[int, ...], tolerance: float = TOLERANCE
) -> None:
    """Compare a network with the layers that were read from it, on `volumes_to_compare`.

    Where passes are long, volumes other than the `FIRST` are left out after `LONG_S` seconds.

    Parameters
    ----------
    shape : shape of a volume, (C, H, W).
    tolerance : how much numbers may differ, as a share of the largest number of the same output for
        the same volume. A volume's largest number counts as at least 0.01, and as at least 1 % of
        the largest number for any volume, because smaller logits make no difference to a softmax.

    Raises
    ------
    ValueError : the numbers of the network and of the layers differ by more than `tolerance`; or
        the network fails on a volume.
    """
    volumes = list(volumes_to_compare(shape))
    pairs_of_volumes = []
    started_s = time.monotonic()
    with progress(len(volumes), "comparing the layers") as bar:
        for place, volume in enumerate(volumes):
            is_long = time.monotonic() - started_s > LONG_S
            if place not in FIRST and is_long:
                continue
            pairs_of_volumes.append(_numbers_of_both(original, layers, volume))
            bar.update()
    for pairs in zip(*pairs_of_volumes, strict=True):
        _compare_output(pairs, tolerance)


def _compare_output(pairs: Sequence[tuple[np.ndarray, np.ndarray]], tolerance: float) -> None:
    """Compare the numbers of one output, see `compare`.

    Parameters
    ----------
    pairs : for each volume, the numbers of the network and those of its layers.
    """
    largest = [_largest_finite(expected) for expected, _ in pairs]
    for (expected, computed), own_largest in zip(pairs, largest, strict=True):
        bound = tolerance * max(own_largest, max(largest) / 100, 0.01)
        if not np.allclose(computed, expected, rtol=0.0, atol=bound, equal_nan=True):
            difference = np.abs(computed - expected).max()
            raise ValueError(
                f"its layers compute other numbers (by {difference:.2g}, where the largest is "
                f"{own_largest:.2g})"
            )


def _numbers_of_both(
    original: Function, layers: Function, volume: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each output the numbers of the network, and those of its layers, of one length."""
    try:
        expected = original(volume.copy())  # a copy, as the network may change it in place
    except Exception as error:  # a network may raise errors of any type
        raise ValueError(
            f"it fails on a volume of shape {volume.shape}: {one_line(error)}"
        ) from None
    pairs = []
    for numbers, layer_numbers in zip(expected, layers(volume), strict=True):
        if numbers.size != layer_numbers.size:
            raise ValueError(
                f"it gives numbers of shape {numbers.shape}, its layers {layer_numbers.size}"
            )
        pairs.append((numbers.reshape(-1), layer_numbers.reshape(-1)))
    return pairs


def _largest_finite(numbers: np.ndarray) -> float:
    """The largest absolute value of the finite numbers; 0 if no number is finite."""
    finite = numbers[np.isfinite(numbers)]
    return float(np.abs(finite).max(initial=0.0))


def volumes_to_compare(shape: tuple[int, ...]) -> Iterator[np.ndarray]:
    """The volumes on which a network and its layers are compared, (C, H, W), float32.

    The first one holds normally distributed numbers, the second one sparse counts, and the third
    one counts that are dense in one corner, like the events of an object. Then follow further
    normally distributed numbers and sparse counts, sparse counts times 100, only negative numbers,
    and only zeros.
    """
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(2, *shape)).astype(np.float32)
    absolute_counts = rng.poisson(0.05, (2, *shape))
    counts = (absolute_counts * rng.choice([-1, 1], (2, *shape))).astype(np.float32)
    corner = np.zeros(shape, np.float32)
    corner[:, : 1 + shape[1] // 2, : 1 + shape[2] // 2] = 1
    yield normal[0]
    yield counts[0]
    yield 3 * rng.poisson(2.0, shape).astype(np.float32) * corner
    yield normal[1]
    yield counts[1]
    yield 100 * counts[0]
    yield -np.abs(normal[0])
    yield np.zeros(shape, np.float32)
