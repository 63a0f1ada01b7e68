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
        where all places share the weights.
    """

    numbers: np.ndarray
    groups: int = 1
    place_weights: int = 0


def packed_weights(step: Step) -> PackedWeights:
    """The weights of a step, packed."""
    if step.own_weights:
        of_places = _weights_of_places(step)
        return PackedWeights(of_places.reshape(-1), place_weights=of_places.shape[1])
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
    of_places = computed.reshape(-1, *step.weights.shape[2:])
    if step.kind == MIX:
        return np.stack([_blocks(w, step) for w in of_places])
    return _rows(of_places, step)


def _rows(w: np.ndarray, step: Step) -> np.ndarray:
    """The packed weights of a step that computes channels one by one, (places, numbers).

    They are packed from weights (places, taps, C).
    """
    n_places, n_taps, channels = w.shape
    size = round_up(channels, LANES)
    packed = np.zeros((n_places, (n_taps + 2) * size + LANES), np.float32)
    rows = packed[:, :-LANES].reshape(n_places, -1, size)  # a view: it fills `packed`
    rows[:, :n_taps, :channels] = w
    rows[:, n_taps, :channels] = step.bias
    rows[:, n_taps + 1, :channels] = step.slopes
    packed[:, -LANES:] = _limits(step)
    return packed


def _blocks(w: np.ndarray, step: Step, first: int = 0) -> np.ndarray:
    """Filters (F, C) or (F, C, kernel_y, kernel_x) in blocks of up to REGISTERS registers.

    Parameters
    ----------
    w : some of the filters of the step.
    first : the index, among the step's filters, of the first filter in `w`.
    """
    # (K, F): the K weights of a filter, tap after tap, and channel after channel in each tap
    products = w.reshape(*w.shape[:2], -1).transpose(2, 1, 0).reshape(-1, len(w))
    parts = []
    for f in range(0, len(w), REGISTERS * LANES):
        n = min(len(w) - f, REGISTERS * LANES)
        of_step = slice(first + f, first + f + n)
        block = np.zeros((len(products) + 2, round_up(n, LANES)), np.float32)
        block[:-2, :n] = products[:, f : f + n]
        block[-2, :n] = step.bias[of_step]
        block[-1, :n] = step.slopes[of_step]
        parts.append(block.reshape(-1))
        parts.append(_limits(step))
    return np.concatenate(parts)


def _limits(step: Step) -> np.ndarray:
    """The limits of the step's results, then zeros, (LANES,)."""
    return np.pad(np.array([step.low, step.high], np.float32), (0, LANES - 2))


def round_up(n: int, multiple: int) -> int:
    """The smallest multiple that is at least n."""
    return -(-n // multiple) * multiple


def aligned(n: int, dtype: type) -> np.ndarray:
    """n zeros that begin where a cache line begins.

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
