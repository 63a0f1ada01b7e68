"""The weights of steps as the kernels read them, see `kernels.network.program`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from async_tnt.kernels.network.program import MIX
from async_tnt.kernels.network.tiles import REGISTERS
from async_tnt.kernels.target import LANES
from async_tnt.networks.layers.steps import Step


@dataclass(frozen=True)
class PackedWeights:
    """The weights of one step.

    Parameters
    ----------
    numbers : float32, flat.
    groups : how many groups of filters have blocks of their own.
    place_weights : how many numbers lie between the weights of one place and those of the next; 0
        if all places share the weights.
    """

    numbers: np.ndarray
    groups: int = 1
    place_weights: int = 0


def packed_weights(step: Step) -> PackedWeights:
    """The weights of a step, packed."""
    if step.own_weights:
        numbers = _weights_of_places(step)
        return PackedWeights(numbers.reshape(-1), place_weights=numbers.shape[1])
    if step.kind != MIX:
        taps = step.weights.reshape(1, -1, len(step.bias))
        return PackedWeights(_rows(taps, step)[0])
    per_group = len(step.bias) // step.groups
    blocks = [
        _blocks(step.weights[first : first + per_group], step, first)
        for first in range(0, len(step.bias), per_group)
    ]
    return PackedWeights(np.concatenate(blocks), groups=step.groups)


def _weights_of_places(step: Step) -> np.ndarray:
    """The packed weights of each place that is computed, (places, numbers)."""
    computed = step.weights[: step.rows, : step.columns]
    place_weights = computed.reshape(-1, *step.weights.shape[2:])
    if step.kind == MIX:
        return np.stack([_blocks(w, step) for w in place_weights])
    return _rows(place_weights, step)


def _rows(w: np.ndarray, step: Step) -> np.ndarray:
    """The packed weights of a step that computes channels one by one, (places, numbers).

    They are packed from weights (places, taps, C).
    """
    n_places, n_taps, channels = w.shape
    row_size = round_up(channels, LANES)
    packed = np.zeros((n_places, (n_taps + 2) * row_size + LANES), np.float32)
    rows = packed[:, :-LANES].reshape(n_places, -1, row_size)  # a view: it fills `packed`
    rows[:, :n_taps, :channels] = w
    rows[:, n_taps, :channels] = step.bias
    rows[:, n_taps + 1, :channels] = step.slopes
    packed[:, -LANES:] = _limits(step)
    return packed


def _blocks(w: np.ndarray, step: Step, first: int = 0) -> np.ndarray:
    """The blocks of filters (F, C) or (F, C, kernel_y, kernel_x), one after another.

    Each block has up to REGISTERS registers of filters.

    Parameters
    ----------
    w : some of the filters of the step.
    first : the index, among the step's filters, of the first filter in `w`.
    """
    # (K, F): a column holds the K weights of a filter, tap after tap, channel after channel
    columns = w.reshape(*w.shape[:2], -1).transpose(2, 1, 0).reshape(-1, len(w))
    blocks = []
    for f in range(0, len(w), REGISTERS * LANES):
        n_filters = min(len(w) - f, REGISTERS * LANES)
        filters = slice(first + f, first + f + n_filters)
        block = np.zeros((len(columns) + 2, round_up(n_filters, LANES)), np.float32)
        block[:-2, :n_filters] = columns[:, f : f + n_filters]
        block[-2, :n_filters] = step.bias[filters]
        block[-1, :n_filters] = step.slopes[filters]
        blocks.append(block.reshape(-1))
        blocks.append(_limits(step))
    return np.concatenate(blocks)


def _limits(step: Step) -> np.ndarray:
    """The two limits of the step's results, then zeros, (LANES,)."""
    return np.pad(np.array([step.low, step.high], np.float32), (0, LANES - 2))


def round_up(n: int, multiple: int) -> int:
    """The smallest multiple that is at least n."""
    return -(-n // multiple) * multiple


def aligned(n: int, dtype: type) -> np.ndarray:
    """An array of n zeros whose memory begins where a cache line begins.

    A register that lies across two cache lines is read half as fast.
    """
    n_bytes = 64  # the size of a cache line
    array: np.ndarray = np.zeros(n + n_bytes // np.dtype(dtype).itemsize, dtype)
    first = -array.ctypes.data % n_bytes // array.itemsize
    return array[first : first + n]


def shared_weights(parts: list[np.ndarray], shared: dict[str, np.ndarray]) -> np.ndarray:
    """The weights of all steps in one read-only array.

    Parameters
    ----------
    parts : the weights of each step.
    shared : a dictionary. If an earlier program of the same network left its array under "weights",
        that array is returned. Otherwise the new array is stored there.
    """
    if "weights" not in shared:
        weights = aligned(sum(part.size for part in parts), np.float32)
        np.concatenate(parts, out=weights)
        weights.flags.writeable = False
        shared["weights"] = weights
    return shared["weights"]
