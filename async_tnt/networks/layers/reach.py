"""How many multiplications one event makes a network do again, from the reach of its layers.

An event changes a pixel of the volume, or four where its place lies between pixels. A layer has to
compute again the places that see a change. Here nothing is computed, so a change may end earlier
than counted: at a ReLU, or at weights of zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from async_tnt.kernels.network.program import MIX, PRODUCT, SUM
from async_tnt.networks.layers.layer import Layer
from async_tnt.networks.layers.lowering import steps_of
from async_tnt.networks.layers.steps import Map, Step


class Work(NamedTuple):
    """Numbers of multiplications."""

    touched: int
    """Those of the places that one event reaches."""
    whole: int
    """Those of a whole pass."""

    @property
    def share(self) -> float:
        """The part of a whole pass that one event reaches; 0 if there are no multiplications."""
        return self.touched / self.whole if self.whole else 0.0


class _Touched(NamedTuple):
    """The places of a map that may change: those in these rows and in these columns."""

    rows: frozenset[int]
    columns: frozenset[int]

    @property
    def n(self) -> int:
        return len(self.rows) * len(self.columns)


NOTHING = _Touched(frozenset(), frozenset())


def work_of_one_event(
    layers: Sequence[Layer],
    shape: tuple[int, int, int],
    tensors: Mapping[str, np.ndarray],
    outputs: Sequence[str] | None,
    n_pixels: int,
) -> Work:
    """The multiplications that an event in the middle of the volume reaches.

    Parameters
    ----------
    shape : shape of the volumes, (C, H, W).
    tensors : name -> weights.
    outputs : see `steps_of`.
    n_pixels : how many pixels of the volume an event changes along each axis, 1 or 2.
    """
    volume = Map(*shape)
    steps, _ = steps_of(layers, volume, tensors, outputs)
    first_row = (volume.rows - n_pixels) // 2
    first_column = (volume.columns - n_pixels) // 2
    rows = frozenset(range(first_row, first_row + n_pixels))
    columns = frozenset(range(first_column, first_column + n_pixels))
    touched: dict[Map, _Touched] = {volume: _Touched(rows, columns)}
    n_touched = 0
    n_whole = 0
    for step in steps:
        places = _reached(step, touched)
        before = touched.get(step.output, NOTHING)
        touched[step.output] = _Touched(before.rows | places.rows, before.columns | places.columns)
        products = _products(step)
        n_touched += products * places.n
        n_whole += products * step.rows * step.columns
    return Work(n_touched, n_whole)


def _reached(step: Step, touched: Mapping[Map, _Touched]) -> _Touched:
    """The places of a step that see a change."""
    rows: set[int] = set()
    columns: set[int] = set()
    for source in step.inputs:
        changed = touched.get(source, NOTHING)
        if not changed.n:
            continue
        if step.is_for_all_places(source):
            return _Touched(frozenset(range(step.rows)), frozenset(range(step.columns)))
        rows |= _through(step, 0, changed.rows, step.rows)
        columns |= _through(step, 1, changed.columns, step.columns)
    return _Touched(frozenset(rows), frozenset(columns))


def _through(step: Step, axis: int, changed: frozenset[int], n: int) -> set[int]:
    """The rows, or columns, of a step that see changed ones of its input."""
    if step.block > 1:
        spread = {step.block * place + k for place in changed for k in range(step.block)}
        return {place for place in spread if place < n}
    seen = set()
    for place in changed:
        for tap in range(step.kernel[axis]):
            # place = output * stride - padding + tap * dilation
            at = place + step.padding[axis] - tap * step.dilation[axis]
            output, rest = divmod(at, step.stride[axis])
            if rest == 0 and 0 <= output < n:
                seen.add(output)
    return seen


def _products(step: Step) -> int:
    """The number of multiplications at each place. A plain sum or mean has none."""
    if step.kind == MIX:
        n_inputs = step.weights.shape[-1] if step.own_weights else step.weights[0].size
        return len(step.bias) * int(n_inputs)
    if step.kind == SUM:
        is_plain = not step.own_weights and bool((step.weights == step.weights.flat[0]).all())
        return 0 if is_plain else int(step.weights.shape[-2]) * len(step.bias)
    return len(step.bias) if step.kind == PRODUCT else 0
