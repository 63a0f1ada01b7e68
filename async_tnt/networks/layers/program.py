"""A network as the arrays that the kernels work on, see `kernels.network.program`."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from async_tnt.base.checks import ParameterValueError, plain_array
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.changes import MAX_ROW
from async_tnt.kernels.network.forward import forward
from async_tnt.kernels.network.sync_input import set_input
from async_tnt.kernels.target import LANES
from async_tnt.networks.layers import graph
from async_tnt.networks.layers.layer import Layer, Shape
from async_tnt.networks.layers.lowering import steps_of
from async_tnt.networks.layers.packing import (
    aligned,
    packed_weights,
    round_up,
    shared_weights,
)
from async_tnt.networks.layers.steps import OF_TWO, Map, Step


class ProgramArrays(NamedTuple):
    """The arrays of a program, in the order in which the kernels take them."""

    program: np.ndarray
    weights: np.ndarray
    maps: np.ndarray
    places: np.ndarray


class ProgramOutput(NamedTuple):
    """Where an output of a network lies."""

    layout: tuple[int, int, int, int]
    """Where in `maps` it begins, and the strides of its rows, columns and channels, in numbers."""
    changes: tuple[int, ...]
    """Where in the program the records of its changes begin."""


@dataclass(frozen=True)
class Program:
    """A network for the compiled interpreter.

    A new program has an input of zeros, and has computed nothing yet.

    Parameters
    ----------
    arrays : what the kernels read and write.
    steps : for each step, in order, the name of the layer that it computes or belongs to.
    outputs : where the outputs lie.
    lanes : how many filters lie side by side in `arrays.weights`.
    """

    arrays: ProgramArrays
    steps: list[str]
    outputs: tuple[ProgramOutput, ...]
    lanes: int = LANES

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if self.lanes != LANES:
            raise ValueError(
                "a network was pickled on a processor with other vector registers: load its model "
                "instead"
            )
        # a pickle does not keep the flag that makes an array read-only
        self.arrays.weights.flags.writeable = False

    def __deepcopy__(self, memo: dict[int, Any]) -> Program:
        """A program with maps of its own, which shares the read-only weights."""
        memo[id(self.arrays.weights)] = self.arrays.weights
        return replace(self, arrays=copy.deepcopy(self.arrays, memo))

    def prepare(self) -> None:
        """Compile the kernels of `run`, so that no call of `run` waits for the compiler."""
        prepare(set_input, forward)

    def run(self, volume: np.ndarray) -> np.ndarray:
        """Compute the whole network.

        Parameters
        ----------
        volume : a volume as `VolumeInput` returns it.

        Returns
        -------
        A view of `maps` that begins with the first output's first number. It may be longer than
        the output.
        """
        set_input.call(volume, self.arrays.program, self.arrays.maps)
        forward.call(*self.arrays)
        return self.arrays.maps[self.arrays.program[P.OUTPUT] :]

    def view(self, output: int, shape: Shape) -> np.ndarray:
        """An output, (C, H, W) or (N,), as a view of `maps`. The next call of a kernel changes it.

        Parameters
        ----------
        output : its number, from 0 on.
        """
        first, row, column, channel = self.outputs[output].layout
        strides = (channel, row, column)[: len(shape)]
        n_bytes = np.dtype(np.float32).itemsize
        view = np.ndarray(
            shape,
            np.float32,
            self.arrays.maps,
            n_bytes * first,
            tuple(n_bytes * stride for stride in strides),
        )
        view.flags.writeable = False
        return view


def make_program(
    layers: Sequence[Layer],
    shape: tuple[int, int, int],
    tensors: Mapping[str, np.ndarray],
    shared: dict[str, np.ndarray] | None = None,
    outputs: Sequence[str] | None = None,
) -> Program:
    """The program of a network whose layers have been checked.

    Parameters
    ----------
    shape : shape of the volumes, (C, H, W).
    tensors : name -> weights.
    shared : a dictionary through which programs of the same layers and shape share their packed
        weights. The first program stores its packed weights there.
    outputs : the layers that compute the outputs, by default the last one.
    """
    channels, height, width = shape
    volume = Map(channels, height, width)
    steps, output_maps = steps_of(layers, volume, tensors, outputs)
    layout = _lay_out(steps, volume)

    writer = _ProgramWriter(steps, layout)
    writer.write_header(output_maps[0])
    for step in steps:
        writer.write_step(step)
    writer.write_list()

    arrays = ProgramArrays(
        np.concatenate([writer.program, np.array(writer.tables, np.int64)]),
        shared_weights(writer.weights, {} if shared is None else shared),
        layout.empty_maps(),
        np.zeros(writer.places.size, np.uint32),
    )
    program_outputs = []
    for output in output_maps:
        place = (layout.firsts[output], output.pitch, output.channels, 1)
        changes = tuple(writer.records[step] + P.CHANGED for step in output.writers)
        program_outputs.append(ProgramOutput(place, changes))
    return Program(arrays, steps=[step.name for step in steps], outputs=tuple(program_outputs))


# -- where maps lie --------------------------------------------------------------------------------


class _Arena:
    """Reserves parts of an array one after another, each where a cache line begins."""

    def __init__(self) -> None:
        self.size = 0

    def take(self, n: int) -> int:
        first = self.size
        self.size += round_up(n, 16)  # 16 numbers of 4 bytes fill a cache line
        return first


@dataclass(frozen=True)
class _MapsLayout:
    """Where the maps of a network lie in the array `maps`.

    Parameters
    ----------
    volume : the network's input.
    planes : where the volume lies as (C, H, W), as a kernel receives it.
    firsts : map -> where the map's place (0, 0) begins. The first key is the volume.
    empty : how many numbers lie from a step's map to the same map of an empty window.
    size : how many numbers the array has.
    """

    volume: Map
    planes: int
    firsts: dict[Map, int]
    empty: int
    size: int

    def empty_maps(self) -> np.ndarray:
        """A new array `maps`. Each map and its frame hold the map's `fill`, which is mostly 0."""
        values = aligned(self.size, np.float32)
        for layer_map, first in self.firsts.items():
            if layer_map.fill:
                begin = first - layer_map.origin
                values[begin : begin + layer_map.size] = layer_map.fill
        return values


def _lay_out(steps: Sequence[Step], volume: Map) -> _MapsLayout:
    """The layout of the volume and of all maps that steps compute.

    Maps that are added to each other have the same frame, which is as wide as the widest of their
    paddings. So they may need more memory than `layer_shapes` counted.

    Raises
    ------
    ValueError : the maps need more memory than is allowed.
    """
    numbers = _Arena()
    planes = numbers.take(volume.channels * volume.rows * volume.columns)
    firsts = {volume: numbers.take(volume.size) + volume.origin}
    n_input = numbers.size
    for step in steps:
        output = step.output
        if output not in firsts:
            firsts[output] = numbers.take(output.size) + output.origin
    if numbers.size > 2 * graph.MAX_NUMBERS:
        raise ValueError(
            f"the network's maps need {numbers.size:_} numbers, more than 2 * {graph.MAX_NUMBERS:_}"
        )
    # a register that holds the last channels may reach behind the end of the maps
    behind = round_up(numbers.size + LANES, LANES)
    n_computed = numbers.size - n_input
    return _MapsLayout(volume, planes, firsts, empty=behind - n_input, size=behind + n_computed)


# -- header and records ----------------------------------------------------------------------------


class _ProgramWriter:
    """Writes the numbers of a program.

    Attributes
    ----------
    program : the header, and a record for each step.
    tables : the lists of numbers behind the records of the steps.
    weights : the packed weights of each step.
    places : the layout of the array `places`.
    records : step -> where its record begins.
    """

    def __init__(self, steps: Sequence[Step], layout: _MapsLayout) -> None:
        self._steps = steps
        self._layout = layout
        self.program = np.zeros(P.FIRST_STEP + len(steps) * P.STEP_SIZE, np.int64)
        self.tables: list[int] = []
        self.weights: list[np.ndarray] = []
        self.places = _Arena()
        self.records = {step: P.FIRST_STEP + k * P.STEP_SIZE for k, step in enumerate(steps)}
        self._n_weights = 0
        self._most_inputs = 0

    def write_header(self, output: Map) -> None:
        program = self.program
        layout = self._layout
        volume = layout.volume
        program[P.N_STEPS] = len(self._steps)
        program[P.CHANNELS] = volume.channels
        program[P.HEIGHT] = volume.rows
        program[P.WIDTH] = volume.columns
        program[P.STALE] = 1
        program[P.PLANES] = layout.planes
        program[P.EMPTY] = layout.empty
        program[P.INPUT] = layout.firsts[volume]
        program[P.INPUT_DY] = volume.pitch
        program[P.OUTPUT] = layout.firsts[output]
        program[P.OUTPUT_DY] = output.pitch

        most_places = max(layer_map.rows * layer_map.columns for layer_map in layout.firsts)
        program[P.LIST] = self.places.take(most_places + 2)
        self._write_scratch()
        self._write_changes(program, P.INPUT_CHANGED, volume.rows, volume.columns)
        self._write_changes(program, P.INPUT_TOUCHED, volume.rows, volume.columns)

    def _write_scratch(self) -> None:
        """Reserve memory for one row of bits of any map.

        Zeros lie before and behind the row, for the windows of steps that reach beyond the map.
        """
        n_words = max(_words(layer_map.columns) for layer_map in self._layout.firsts)
        n_before = max(_words(step.padding[1]) for step in self._steps)
        n_seen = max(_words_seen(step) for step in self._steps)
        # `places` is counted in uint32 numbers, of which two make a uint64 word
        first = self.places.take(2 * (n_before + max(n_words, n_seen))) // 2
        self.program[P.SCRATCH] = first + n_before
        self.program[P.SCRATCH_WORDS] = n_words

    def _write_changes(self, record: np.ndarray, at: int, rows: int, columns: int) -> None:
        """Write the record of a map without changes, see `kernels.network.changes`."""
        n_words = _words(columns)
        first = self.places.take(2 * rows * n_words) // 2  # in uint64 words
        # from row MAX_ROW to row -1: no row has changed
        record[at : at + 4] = first, MAX_ROW, -1, n_words

    def write_step(self, step: Step) -> None:
        at = self.records[step]
        record = self.program[at : at + P.STEP_SIZE]
        record[P.KIND] = step.kind
        record[P.APPLIED] = step.function
        record[P.BLOCK] = step.block
        self._write_window(record, step)
        self._write_places(record, step)
        self._write_inputs(record, step)
        self._write_output(record, step)
        self._write_weights(record, step)

    def _write_window(self, record: np.ndarray, step: Step) -> None:
        record[[P.KERNEL_Y, P.KERNEL_X]] = step.kernel
        record[[P.STRIDE_Y, P.STRIDE_X]] = step.stride
        record[[P.PAD_Y, P.PAD_X]] = step.padding
        record[[P.DILATION_Y, P.DILATION_X]] = step.dilation

    def _write_places(self, record: np.ndarray, step: Step) -> None:
        """Write how many places the step computes, and that no place has changed."""
        record[P.ROWS] = step.rows
        record[P.COLUMNS] = step.columns
        self._write_changes(record, P.CHANGED, step.rows, step.columns)
        self._write_changes(record, P.TOUCHED, step.rows, step.columns)

    def _write_inputs(self, record: np.ndarray, step: Step) -> None:
        """Write where the changes of the step's inputs are recorded, and where the inputs lie."""
        # those whose places count for all come first
        inputs = sorted(dict.fromkeys(step.inputs), key=step.is_for_all_places, reverse=True)
        sources = [source for input_map in inputs for source in self._changes_of(input_map)]
        record[P.N_SOURCES] = len(sources)
        record[P.SOURCES] = self._add_table(sources)
        whole = [one for one in inputs if step.is_for_all_places(one)]
        record[P.N_WHOLE] = sum(len(self._changes_of(one)) for one in whole)

        source = step.inputs[0]
        runs, run_length = _runs(step, self._layout.firsts)
        table = runs
        if step.kind == P.PICK:
            table = [*runs, *step.picked]
        if step.kind in OF_TWO:
            table = [number for one in step.inputs for number in self._table_of_input(step, one)]
        if step.kind == P.MIX:
            distances = [run + k for run in runs for k in range(run_length)]
            table = [distance | i << 32 for i, distance in enumerate(distances)]
            self._most_inputs = max(self._most_inputs, len(table))
        record[P.IN] = 0  # the table holds distances from the beginning of `maps`
        if not step.is_for_all_places(source):
            record[P.IN_DY] = step.stride[0] * source.pitch
            record[P.IN_DX] = step.stride[1] * source.channels
        record[P.N_RUNS] = len(runs)
        record[P.RUN_LENGTH] = run_length
        record[P.RUNS] = self._add_table(table)

    def _changes_of(self, input_map: Map) -> list[int]:
        """Where in the program the records of a map's changes begin."""
        if input_map is self._layout.volume:
            return [P.INPUT_CHANGED]
        return [self.records[writer] + P.CHANGED for writer in input_map.writers]

    def _table_of_input(self, step: Step, source: Map) -> tuple[int, int, int, int]:
        """Where an input of a PRODUCT or TOTAL begins; strides of its rows, columns, channels."""
        first = self._layout.firsts[source]
        by_channel = 0 if source.channels == 1 else 1
        if step.is_for_all_places(source):
            return first, 0, 0, by_channel
        return first, source.pitch, source.channels, by_channel

    def _write_output(self, record: np.ndarray, step: Step) -> None:
        record[P.OUT] = self._layout.firsts[step.output] + step.channel
        record[P.OUT_DY] = step.output.pitch
        record[P.OUT_DX] = step.output.channels

    def _write_weights(self, record: np.ndarray, step: Step) -> None:
        packed = packed_weights(step)
        record[P.OUT_CHANNELS] = len(step.bias) // packed.groups
        record[P.GROUPS] = packed.groups
        record[P.GROUP_CHANNELS] = step.inputs[0].channels // packed.groups
        record[P.WEIGHTS] = self._n_weights
        record[P.PLACE_WEIGHTS] = packed.place_weights
        if step.kind == P.MIX and not np.isfinite(step.weights).all():
            record[P.TILES_UNLISTED] = P.ALWAYS  # 0 times such a weight is nan
        self.weights.append(packed.numbers)
        self._n_weights += packed.numbers.size

    def write_list(self) -> None:
        """Reserve memory for the list of a tile's inputs, behind all tables.

        The instructions read and write eight numbers at once, which may reach behind a list's end.
        """
        self.program[P.LISTED] = self._add_table([0] * (self._most_inputs + 8))

    def _add_table(self, numbers: list[int]) -> int:
        """Write numbers behind the records; returns where they begin in the whole program."""
        first = len(self.program) + len(self.tables)
        self.tables += numbers
        return first


def _words(columns: int) -> int:
    """How many uint64 words have a bit for each column."""
    return -(-columns // 64)


def _words_seen(step: Step) -> int:
    """How many words of an input's row a step may read for one row of its output.

    Two words are added, because 64 columns and the 64 columns behind them may begin within a word.
    """
    kernel_words = _words((step.kernel[1] - 1) * step.dilation[1])
    return _words(step.columns) * step.stride[1] + kernel_words + 2


def _runs(step: Step, firsts: Mapping[Map, int]) -> tuple[list[int], int]:
    """Where in `maps` the runs of place (0, 0) begin, and how many numbers a run has.

    A run is a tap, or a whole row of taps, see `kernels.network.program`.
    """
    taps = []
    for input_map in step.inputs:
        row_distance = step.dilation[0] * input_map.pitch
        column_distance = step.dilation[1] * input_map.channels
        above, before = step.padding
        origin = firsts[input_map] - above * input_map.pitch - before * input_map.channels
        for i in range(step.kernel[0]):
            for j in range(step.kernel[1]):
                taps.append(origin + i * row_distance + j * column_distance)
    channels = step.inputs[0].channels
    # a MIX can read a whole row of its kernel at once if the row's numbers lie side by side
    if step.kind == P.MIX and step.groups == 1 and step.dilation[1] == 1:
        return taps[:: step.kernel[1]], step.kernel[1] * channels
    return taps, channels // step.groups


# -- volumes ---------------------------------------------------------------------------------------


class VolumeInput:
    """Brings volumes into one form, that of `TNTVolume.array`: float32, contiguous, read-only.

    So a kernel is compiled for this form only.
    """

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.shape = shape
        self._copy = np.zeros(shape, np.float32)

    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """The volume as float32, contiguous and read-only.

        A volume that already has this form is returned itself. Otherwise a copy is returned,
        which is valid until the next call.

        Raises
        ------
        ValueError : the volume has another shape.
        """
        volume = plain_array("volume", volume)
        if volume.shape != self.shape:
            raise ParameterValueError("volume", f"must have shape {self.shape}", volume.shape)
        if volume.dtype == np.float32 and volume.flags.c_contiguous and not volume.flags.writeable:
            return volume
        np.copyto(self._copy, volume)
        view = self._copy.view()
        view.flags.writeable = False
        return view
