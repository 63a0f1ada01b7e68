"""Steps as the arrays that the kernels work on, see `kernels.program`, and volumes as they take
them."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from async_tnt.base.checks import plain_array
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.changes import MAX_ROW
from async_tnt.kernels.network.forward import forward
from async_tnt.kernels.network.sync_input import set_input
from async_tnt.kernels.simd import LANES
from async_tnt.networks.layers import graph
from async_tnt.networks.layers.operations import Layer
from async_tnt.networks.layers.steps import Map, Step, steps_of


class ProgramArrays(NamedTuple):
    """In the order in which the kernels take them."""

    program: np.ndarray
    weights: np.ndarray
    maps: np.ndarray
    places: np.ndarray


@dataclass(frozen=True)
class Program:
    """A network for the compiled interpreter; its input is zero, and nothing has been computed.

    arrays : ProgramArrays.
    steps : of each, in order, the name of the layer that it computes or belongs to.
    output_layout : where in `maps` the output begins, numbers from one of its rows, columns and
        channels to the next.
    output_changes : where in the program the records of the output's changes begin.
    lanes : as many filters lie side by side in `arrays.weights`.
    """

    arrays: ProgramArrays
    steps: list[str]
    output_layout: tuple[int, int, int, int]
    output_changes: list[int]
    lanes: int = LANES

    KERNELS = (set_input, forward)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if self.lanes != LANES:
            raise ValueError(
                "a network was pickled on a processor with other vector registers: load its model "
                "instead"
            )
        self.arrays.weights.flags.writeable = False  # which a pickle does not keep

    def __deepcopy__(self, memo: dict[int, Any]) -> Program:
        """A network of its own, with the same read-only weights."""
        memo[id(self.arrays.weights)] = self.arrays.weights
        return replace(self, arrays=copy.deepcopy(self.arrays, memo))

    def run(self, volume: np.ndarray) -> np.ndarray:
        """Compute the whole network: volume, as `VolumeInput` returns it -> the output's numbers, a
        view that begins with the first and may go on behind the last."""
        set_input(volume, self.arrays.program, self.arrays.maps)
        forward(*self.arrays)
        return self.arrays.maps[self.arrays.program[P.OUTPUT] :]


def make_program(
    layers: Sequence[Layer],
    shape: tuple[int, int, int],
    tensors: Mapping[str, np.ndarray],
    shared: dict[str, np.ndarray] | None = None,
) -> Program:
    """The program of a network whose layers have been checked, for volumes of this shape (C, H, W).

    shared : where programs of the same layers and shape share their packed weights; those of the
        first one enter it.
    """
    channels, height, width = shape
    volume = Map(channels, height, width)
    steps, output = steps_of(layers, volume, tensors)
    steps = _without_unused(steps, (volume, output))
    _frame(steps)
    maps = list(dict.fromkeys([volume, *(step.output for step in steps)]))

    program = np.zeros(P.FIRST_STEP + len(steps) * P.STEP_SIZE, np.int64)
    program[[P.N_STEPS, P.CHANNELS, P.HEIGHT, P.WIDTH, P.STALE]] = (
        len(steps),
        channels,
        height,
        width,
        1,
    )
    tables: list[int] = []
    places = _Arena()
    program[P.LIST] = places.take(max(part.rows * part.columns for part in maps) + 2)
    program[P.SCRATCH_WORDS] = n_words = max(_words(part.columns) for part in maps)
    before = max(_words(step.padding[1]) for step in steps)
    seen = max(
        _words(s.columns) * s.stride[1] + _words((s.kernel[1] - 1) * s.dilation[1]) + 2
        for s in steps
    )
    program[P.SCRATCH] = places.take(2 * (before + max(n_words, seen))) // 2 + before
    for record_at in (P.INPUT_CHANGED, P.INPUT_TOUCHED):
        program[record_at : record_at + 4] = _changes(height, width, places)
    numbers = _Arena()
    program[P.PLANES] = numbers.take(channels * height * width)
    firsts = {volume: numbers.take(_size(volume)) + _first(volume)}
    first_number = numbers.size
    firsts |= {part: numbers.take(_size(part)) + _first(part) for part in maps[1:]}
    # maps that are added have one frame, that of the widest padding
    if numbers.size > 2 * graph.MAX_NUMBERS:
        raise ValueError(
            f"the network's maps need {numbers.size:_} numbers, more than 2 * {graph.MAX_NUMBERS:_}"
        )
    behind = _up(numbers.size + LANES, LANES)  # a register may reach behind the last channel
    program[P.EMPTY] = behind - first_number
    program[[P.INPUT, P.INPUT_DY]] = firsts[volume], _pitch(volume)
    program[[P.OUTPUT, P.OUTPUT_DY]] = firsts[output], _pitch(output)

    records = {step: P.FIRST_STEP + k * P.STEP_SIZE for k, step in enumerate(steps)}
    weights: list[np.ndarray] = []
    n_weights = 0
    for step, at in records.items():
        record = program[at : at + P.STEP_SIZE]
        sources = [records[writer] + P.CHANGED for part in step.inputs for writer in part.writers]
        sources += [P.INPUT_CHANGED] * any(part is volume for part in step.inputs)
        runs, run_length = _runs(step, firsts)
        groups, place_weights, packed = _packed(step)
        source = step.inputs[0]
        record[P.KIND] = step.kind
        record[[P.N_SOURCES, P.SOURCES]] = len(sources), len(program) + len(tables)
        tables += sources
        record[[P.KERNEL_Y, P.KERNEL_X]] = step.kernel
        record[[P.STRIDE_Y, P.STRIDE_X]] = step.stride
        record[[P.PAD_Y, P.PAD_X]] = step.padding
        record[[P.DILATION_Y, P.DILATION_X]] = step.dilation
        record[[P.ROWS, P.COLUMNS]] = step.rows, step.columns
        for k in (P.CHANGED, P.TOUCHED):
            record[k : k + 4] = _changes(step.rows, step.columns, places)
        record[P.IN] = 0  # the distances below are from the beginning
        record[[P.IN_DY, P.IN_DX]] = (
            step.stride[0] * _pitch(source),
            step.stride[1] * source.channels,
        )
        record[P.OUT] = firsts[step.output] + step.channel
        record[[P.OUT_DY, P.OUT_DX]] = _pitch(step.output), step.output.channels
        record[P.OUT_CHANNELS] = len(step.bias) // groups
        record[[P.RUNS, P.N_RUNS, P.RUN_LENGTH]] = len(program) + len(tables), len(runs), run_length
        tables += runs
        record[[P.GROUPS, P.GROUP_CHANNELS]] = groups, source.channels // groups
        record[[P.APPLIED, P.BLOCK]] = step.applied, step.block
        record[[P.WEIGHTS, P.PLACE_WEIGHTS]] = n_weights, place_weights
        weights.append(packed)
        n_weights += packed.size
    values = aligned(behind + numbers.size - first_number, np.float32)
    for part in maps:
        if part.fill:
            values[firsts[part] - _first(part) :][: _size(part)] = part.fill
    arrays = ProgramArrays(
        np.concatenate([program, np.array(tables, np.int64)]),
        _shared_weights(weights, n_weights, {} if shared is None else shared),
        values,
        np.zeros(places.size, np.uint32),
    )
    layout = firsts[output], _pitch(output), output.channels, 1
    output_changes = [records[writer] + P.CHANGED for writer in output.writers]
    return Program(arrays, [step.name for step in steps], layout, output_changes)


def _shared_weights(parts: list[np.ndarray], n: int, shared: dict[str, np.ndarray]) -> np.ndarray:
    """The weights of all steps in one read-only array: that of an earlier program, if there is
    one."""
    if "weights" not in shared:
        weights = aligned(n, np.float32)
        np.concatenate(parts, out=weights)
        weights.flags.writeable = False
        shared["weights"] = weights
    return shared["weights"]


def aligned(n: int, dtype: type) -> np.ndarray:
    """Zeros that begin where a cache line does: registers across two lines are read half as
    fast."""
    array: np.ndarray = np.zeros(n + 64 // np.dtype(dtype).itemsize, dtype)
    first = -array.ctypes.data % 64 // array.itemsize
    return array[first : first + n]


class _Arena:
    """Places parts one after the other, each where a cache line begins."""

    def __init__(self) -> None:
        self.size = 0

    def take(self, n: int) -> int:
        first = self.size
        self.size += -(-n // 16) * 16
        return first


def _changes(rows: int, columns: int, places: _Arena) -> tuple[int, int, int, int]:
    """A record of changes, see `kernels.changes`: none."""
    return places.take(2 * rows * _words(columns)) // 2, MAX_ROW, -1, _words(columns)


def _words(columns: int) -> int:
    """uint64 that have a bit for each."""
    return -(-columns // 64)


def _without_unused(steps: list[Step], keep: Sequence[Map]) -> list[Step]:
    """The steps whose maps are read, or are to be kept. Last rows and columns that no step reads,
    as a pooling may drop them, are not computed."""
    needed: dict[Map, tuple[int, int]] = {}
    used = []
    for step in reversed(steps):
        if step.output not in keep:
            if step.output not in needed:
                continue
            step.rows, step.columns = needed[step.output]
        rows, columns = step.reads
        for part in step.inputs:
            before = needed.get(part, (0, 0))
            needed[part] = (
                min(max(before[0], rows, 1), part.rows),
                min(max(before[1], columns, 1), part.columns),
            )
        used.append(step)
    return used[::-1]


def _frame(steps: list[Step]) -> None:
    """Give each map the frame that its readers need; the maps that a step adds get the same one."""
    for step in steps:
        for part in step.inputs:
            rows, columns = step.reads
            _widen(part, (*step.padding, max(0, rows - part.rows), max(0, columns - part.columns)))
    while any(
        [
            _widen(part, other.frame)
            for step in steps
            for part in step.inputs
            for other in step.inputs
        ]
    ):
        pass


def _widen(part: Map, frame: Sequence[int]) -> bool:
    """Returns whether that changed anything."""
    before = part.frame
    top, left, bottom, right = map(max, before, frame)
    part.frame = top, left, bottom, right
    return part.frame != before


def _pitch(part: Map) -> int:
    """Numbers in a row."""
    _, left, _, right = part.frame
    return (left + part.columns + right) * part.channels


def _size(part: Map) -> int:
    top, _, bottom, _ = part.frame
    return (top + part.rows + bottom) * _pitch(part)


def _first(part: Map) -> int:
    """Where its place (0, 0) lies, behind the frame."""
    return part.frame[0] * _pitch(part) + part.frame[1] * part.channels


def _runs(step: Step, firsts: Mapping[Map, int]) -> tuple[list[int], int]:
    """Where in the maps the runs or taps of place (0, 0) begin, and how long a run is."""
    taps = []
    for part in step.inputs:
        origin = firsts[part] - step.padding[0] * _pitch(part) - step.padding[1] * part.channels
        taps += [
            origin + i * step.dilation[0] * _pitch(part) + j * step.dilation[1] * part.channels
            for i in range(step.kernel[0])
            for j in range(step.kernel[1])
        ]
    channels = step.inputs[0].channels
    if step.kind == P.MIX and step.groups == 1 and step.dilation[1] == 1:
        return taps[:: step.kernel[1]], step.kernel[1] * channels
    return taps, channels // step.groups


def _packed(step: Step) -> tuple[int, int, np.ndarray]:
    """Groups, numbers from one place's weights to the next one's, and the weights as
    `kernels.program` describes."""
    if step.own_weights:
        of_places = step.weights[: step.rows, : step.columns].reshape(-1, *step.weights.shape[2:])
        packed = (
            np.stack([_blocks(w, step) for w in of_places])
            if step.kind == P.MIX
            else _rows(of_places, step)
        )
        return 1, packed.shape[1], packed.reshape(-1)
    if step.kind != P.MIX:
        return 1, 0, _rows(step.weights.reshape(1, -1, len(step.bias)), step)[0]
    per_group = len(step.bias) // step.groups
    parts = [
        _blocks(step.weights[k : k + per_group], step, k)
        for k in range(0, len(step.bias), per_group)
    ]
    return step.groups, 0, np.concatenate(parts)


def _rows(w: np.ndarray, step: Step) -> np.ndarray:
    """(places, numbers): of a step that computes each channel by itself, from (places, taps, C)."""
    n_places, n_taps, channels = w.shape
    size = _up(channels, LANES)
    packed = np.zeros((n_places, (n_taps + 2) * size + LANES), np.float32)
    rows = packed[:, :-LANES].reshape(n_places, -1, size)  # a view
    rows[:, :n_taps, :channels] = w
    rows[:, n_taps, :channels], rows[:, n_taps + 1, :channels] = step.bias, step.slopes
    packed[:, -LANES:] = _limits(step)
    return packed


def _blocks(w: np.ndarray, step: Step, first: int = 0) -> np.ndarray:
    """Filters (F, C) or (F, C, kernel_y, kernel_x), the step's from `first` on, in blocks of one or
    two registers."""
    parts = []
    # (K, F): taps, then channels
    products = w.reshape(*w.shape[:2], -1).transpose(2, 1, 0).reshape(-1, len(w))
    for f in range(0, len(w), 2 * LANES):
        n = min(len(w) - f, 2 * LANES)
        size = _up(n, LANES)
        block = np.zeros((len(products) + 2, size), np.float32)
        block[:-2, :n] = products[:, f : f + n]
        block[-2, :n] = step.bias[first + f : first + f + n]
        block[-1, :n] = step.slopes[first + f : first + f + n]
        parts += [block.reshape(-1), _limits(step)]
    return np.concatenate(parts)


def _limits(step: Step) -> np.ndarray:
    return np.pad(np.array([step.low, step.high], np.float32), (0, LANES - 2))


def _up(n: int, step: int) -> int:
    return -(-n // step) * step


class VolumeInput:
    """Passes volumes to a kernel in one form, that of `TNTVolume.array`, so the kernel is compiled
    only once."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.shape = shape
        self._copy = np.zeros(shape, np.float32)

    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """float32, contiguous, read-only: the volume itself where it is so, else a copy, valid
        until the next call.

        Raises
        ------
        ValueError : another shape.
        """
        volume = plain_array("volume", volume)
        if volume.shape != self.shape:
            raise ValueError(f"`volume` must have shape {self.shape}, got {volume.shape}")
        if volume.dtype == np.float32 and volume.flags.c_contiguous and not volume.flags.writeable:
            return volume
        np.copyto(self._copy, volume)
        view = self._copy.view()
        view.flags.writeable = False
        return view
