"""The comparison of a network of another program with the layers that were read from it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from async_tnt.base.messages import one_line
from async_tnt.base.progress import progress

TOLERANCE = 1e-4
"""The largest difference in float32 that is accepted, as a share of a volume's largest number."""

EXACT_TOLERANCE = 1e-5
"""The largest difference in float64: weights are kept in float32, also those that were computed."""

LEAST_LOGIT = 0.01
"""The smallest size of logits that makes a difference."""

SMALLEST = 1e-9
"""A share of an output's largest number that counts for nothing, as numbers may cancel."""

ROUNDINGS = 4
"""How many times the error of rounding two programs may differ."""

LONG_S = 10.0
"""Seconds after which only the volumes of `FIRST` are compared."""

FIRST = (0, 1, 2)
"""The volumes that are compared in any case: any numbers, sparse counts, and an object's events."""

Function = Callable[[np.ndarray], Sequence[np.ndarray]]
"""Volume (C, H, W) -> the numbers of each output, without the axis of the batch."""


def expect_form(condition: bool, what: str) -> None:
    """Raise a NotImplementedError that `what` has no compiled form, unless `condition` holds."""
    if not condition:
        raise NotImplementedError(f"{what} has no compiled form")


def without_batch(numbers: np.ndarray, n_batch: int = 1) -> np.ndarray:
    """The numbers of one volume, if the first axis is that of a batch of equal volumes."""
    if numbers.shape[:1] != (n_batch,):
        return numbers
    first: np.ndarray = numbers[0]
    return first


def compare(
    original: Function,
    layers: Function,
    shape: tuple[int, ...],
    tolerance: float = TOLERANCE,
    exact: Function | None = None,
    *,
    is_raw: bool = False,
) -> None:
    """Compare a network with the layers that were read from it, on `volumes_to_compare`.

    Where passes are long, volumes other than the `FIRST` are left out after `LONG_S` seconds.

    Parameters
    ----------
    shape : shape of a volume, (C, H, W).
    tolerance : how much numbers may differ, as a share of the largest number of the same output for
        the same volume. A volume's largest number counts as at least 1 % of the largest number for
        any volume. Without `is_raw` it counts as at least `LEAST_LOGIT`, because smaller logits
        make no difference to a softmax.
    exact : the same layers as `layers`, in float64. If it is given, numbers may also differ by
        `ROUNDINGS` times the error that `layers` make by rounding, because such a network makes
        much of small differences.
    is_raw : whether the outputs are no logits. Then they must have the layers' shapes, and each
        channel of a map is compared by itself.

    Raises
    ------
    ValueError : the numbers of the network and of the layers differ by more than that; or the
        network fails on a volume.
    """
    volumes = list(volumes_to_compare(shape))
    numbers_of_volumes = []
    started_s = time.monotonic()
    with progress(len(volumes), "comparing the layers") as bar:
        for place, volume in enumerate(volumes):
            is_long = time.monotonic() - started_s > LONG_S
            if place not in FIRST and is_long:
                continue
            numbers_of_volumes.append(_numbers_of_both(original, layers, volume, exact, is_raw))
            bar.update()
    for numbers_of_output in zip(*numbers_of_volumes, strict=True):
        _compare_output(numbers_of_output, tolerance, 0.0 if is_raw else LEAST_LOGIT)


class _Numbers(NamedTuple):
    """What is compared of one output, for one volume: (channels, numbers of a channel) each."""

    expected: np.ndarray
    """The numbers of the network."""
    computed: np.ndarray
    """Those of its layers."""
    rounding: float
    """The largest error of the layers by rounding, as far as it is known."""


def _compare_output(numbers: Sequence[_Numbers], tolerance: float, least: float) -> None:
    """Compare the numbers of one output for all volumes, see `compare`."""
    of_channels = np.array([_largest_of_channels(one.expected) for one in numbers])
    of_all = float(of_channels.max(initial=0.0))
    for (expected, computed, rounding), largest in zip(numbers, of_channels, strict=True):
        counted = np.maximum(largest, of_channels.max(0) / 100)
        bounds = np.maximum(tolerance * np.maximum(counted, least), SMALLEST * of_all)
        bounds = np.maximum(bounds, ROUNDINGS * rounding)[:, np.newaxis]
        with np.errstate(invalid="ignore"):  # the difference of two infinities is no number
            differences = np.abs(computed - expected)
        are_same = (computed == expected) | (np.isnan(computed) & np.isnan(expected))
        if not ((differences <= bounds) | are_same).all():
            largest_difference = np.fmax.reduce(differences, axis=None)
            raise ValueError(
                f"its layers compute other numbers (by {largest_difference:.2g}, where the "
                f"largest is {largest.max():.2g})"
            )


def _largest_of_channels(numbers: np.ndarray) -> np.ndarray:
    """The largest absolute finite number of each row; 0 where no number is finite."""
    sizes = np.where(np.isfinite(numbers), np.abs(numbers), 0.0)
    largest: np.ndarray = sizes.max(axis=1, initial=0.0)
    return largest


def _numbers_of_both(
    original: Function,
    layers: Function,
    volume: np.ndarray,
    exact: Function | None,
    is_raw: bool,
) -> list[_Numbers]:
    """The numbers of each output for one volume."""
    try:
        expected = original(volume.copy())  # a copy, as the network may change it in place
    except Exception as error:  # a network may raise errors of any type
        raise ValueError(
            f"it fails on a volume of shape {volume.shape}: {one_line(error)}"
        ) from None
    computed = layers(volume)
    exact_numbers = computed if exact is None else exact(volume)
    found = []
    for numbers, own, without_rounding in zip(expected, computed, exact_numbers, strict=True):
        is_other = numbers.shape != own.shape if is_raw else numbers.size != own.size
        if is_other:
            raise ValueError(f"it gives numbers of shape {numbers.shape}, its layers {own.shape}")
        with np.errstate(invalid="ignore"):  # as above
            errors = own.reshape(-1) - without_rounding.reshape(-1)
        # the channels of a raw map are compared one by one, as a large one would hide others
        n_rows = len(own) if is_raw and own.ndim == 3 else 1
        rounding = _largest_finite(errors)
        found.append(_Numbers(numbers.reshape(n_rows, -1), own.reshape(n_rows, -1), rounding))
    return found


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
