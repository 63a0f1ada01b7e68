"""The steps of the compiled interpreter, before they are laid out in memory.

What each kind of step computes is described in `kernels.network.program`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from async_tnt.kernels.network.program import MIX, PICK, PRODUCT, SUM, TOTAL
from async_tnt.networks.layers.layer import Layer, Shape


@dataclass(eq=False)
class Map:
    """Numbers (rows, columns, channels), with a frame of further places around them.

    All numbers of the frame are `fill`. A vector is a map of one place.
    """

    channels: int
    rows: int
    columns: int
    fill: float = 0.0
    frame: tuple[int, int, int, int] = (0, 0, 0, 0)
    """How many places lie above the map, to its left, below it and to its right."""
    writers: list[Step] = field(default_factory=list)
    """The steps that compute the map's channels; none for the volume."""

    def like(self, fill: float = 0.0) -> Map:
        """A new map of the same size, which nothing computes yet."""
        return Map(self.channels, self.rows, self.columns, fill)

    @property
    def sides(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    @property
    def pitch(self) -> int:
        """How many numbers lie in memory from one row to the next."""
        _, left, _, right = self.frame
        return (left + self.columns + right) * self.channels

    @property
    def size(self) -> int:
        """How many numbers the map and its frame have in memory."""
        top, _, bottom, _ = self.frame
        return (top + self.rows + bottom) * self.pitch

    @property
    def origin(self) -> int:
        """How many numbers of the frame lie in memory before place (0, 0)."""
        top, left, _, _ = self.frame
        return top * self.pitch + left * self.channels


WITHOUT_ACTIVATION = (PICK, PRODUCT, TOTAL)
"""Kinds of steps whose results are neither scaled nor limited."""

OF_TWO = (PRODUCT, TOTAL)
"""Kinds of steps of two inputs, of which one may have one place, or one channel, for all."""


@dataclass(eq=False)
class Step:
    """A computation of a map, or of some channels of it, from other maps.

    Parameters
    ----------
    name : the layer that the step computes or belongs to.
    kind : MIX, MAXIMUM, FUNCTION or PICK, which have one input; SUM, whose inputs have one shape
        and are taps of one sum; PRODUCT or TOTAL, which have two inputs.
    weights : for a MIX, shape (F, C / groups, kernel_y, kernel_x), or (rows, columns, F, C) with
        `own_weights`. For a SUM, shape (taps, C), input by input and tap by tap, or (rows, columns,
        taps, C) with `own_weights`.
    bias : (F,) or (C,).
    own_weights : whether each place has weights of its own.
    function : the index of a FUNCTION's function in `kernels.network.functions.FUNCTIONS`.
    block : the side of the block that one place of a PICK's input becomes.
    picked : of a PICK: the channels of the input that it copies, for each place of a block in
        turn.
    channel : the first channel of the output that the step computes.

    Attributes
    ----------
    rows, columns : how much of the output is computed; all of it, at first.
    slopes : (F,) or (C,), the factors of negative results.
    low, high : the limits of the results.
    """

    name: str
    kind: int
    inputs: list[Map]
    output: Map
    weights: np.ndarray
    bias: np.ndarray
    kernel: tuple[int, int] = (1, 1)
    stride: tuple[int, int] = (1, 1)
    padding: tuple[int, int] = (0, 0)
    dilation: tuple[int, int] = (1, 1)
    groups: int = 1
    own_weights: bool = False
    function: int = 0
    block: int = 1
    picked: Sequence[int] = ()
    channel: int = 0
    rows: int = field(init=False)
    columns: int = field(init=False)
    slopes: np.ndarray = field(init=False)
    low: float = -np.inf
    high: float = np.inf

    def __post_init__(self) -> None:
        self.output.writers.append(self)
        self.rows = self.output.rows
        self.columns = self.output.columns
        self.slopes = np.ones(len(self.bias), np.float32)

    @property
    def is_activated(self) -> bool:
        """Whether the result is scaled where it is negative, or limited."""
        return bool((self.slopes != 1).any()) or self.low != -np.inf or self.high != np.inf

    def reads(self, input_map: Map) -> tuple[int, int]:
        """How many rows and columns of an input the step reads.

        They are counted from the first row and column of the map. The last rows and columns may lie
        in the frame.
        """
        if self.is_for_all_places(input_map):
            return 1, 1
        return self._reads(0, self.rows), self._reads(1, self.columns)

    def is_for_all_places(self, input_map: Map) -> bool:
        """Whether an input has one place, which counts for all places of the output."""
        can_be = self.kind in (PICK, *OF_TWO) and self.block == 1
        return can_be and input_map.sides == (1, 1) != self.output.sides

    def _reads(self, axis: int, n_outputs: int) -> int:
        """How many rows (axis 0) or columns (axis 1) of an input are read, see `reads`."""
        n_places = -(-n_outputs // self.block)  # rounded up
        last_begin = (n_places - 1) * self.stride[axis] - self.padding[axis]
        reach = (self.kernel[axis] - 1) * self.dilation[axis]
        return last_begin + reach + 1


class StepList:
    """The steps of a network so far. The rule of each operation adds the operation's steps.

    Parameters
    ----------
    shapes : layer -> the shape of its output.
    readers : layer -> how many layers read its output.
    tensors : name -> weights.

    Attributes
    ----------
    steps : in the order in which they are computed.
    name : the layer whose steps are added now.
    """

    def __init__(
        self,
        shapes: Mapping[str, Shape],
        readers: Mapping[str, int],
        tensors: Mapping[str, np.ndarray],
    ) -> None:
        self._shapes = shapes
        self._readers = readers
        self._tensors = tensors
        self.steps: list[Step] = []
        self.name = ""

    def output_of(self, layer: Layer) -> Map:
        """A new map of the shape of the layer's output, (C, H, W)."""
        channels, rows, columns = self._shapes[layer["name"]]
        return Map(channels, rows, columns)

    def tensor(self, layer: Layer, role: str) -> np.ndarray:
        """The weights that the layer has in this role."""
        return self._tensors[layer["weights"][role]]

    def tensor_or(self, layer: Layer, role: str, default: float, n: int) -> np.ndarray:
        """The layer's weights in this role; if it has none, `n` numbers with the default value."""
        if role in layer["weights"]:
            return self.tensor(layer, role)
        return np.full(n, default, np.float32)

    def add(
        self, kind: int, inputs: list[Map], output: Map, weights: Any, bias: Any, **options: Any
    ) -> Map:
        """Add a step, see `Step`; returns its output."""
        weights = np.asarray(weights, np.float32)
        bias = np.asarray(bias, np.float32)
        self.steps.append(Step(self.name, kind, inputs, output, weights, bias, **options))
        return output

    def copy(self, source: Map, output: Map, channel: int = 0) -> Map:
        """Add a step that copies `source` into `output`, from `channel` on; returns `output`."""
        ones = np.ones((1, source.channels))
        return self.add(SUM, [source], output, ones, np.zeros(source.channels), channel=channel)

    def step_to_fold_into(self, layer: Layer, source: Map, *, linear: bool = False) -> Step:
        """The step that can do the work of a layer of one input as part of its own work.

        The caller then changes this step. It is the step that computes the layer's input, if no
        other layer reads this input and the step has no activation yet. Otherwise a new step is
        added, which copies the input.

        Parameters
        ----------
        source : the map of the layer's input.
        linear : whether the layer scales and shifts results, which only a MIX or a SUM can do.
        """
        is_read_here_only = self._readers[layer["inputs"][0]] == 1
        if len(source.writers) == 1 and is_read_here_only:
            step = source.writers[0]
            if linear:
                has_right_kind = step.kind in (MIX, SUM)
            else:
                has_right_kind = step.kind not in WITHOUT_ACTIVATION
            if has_right_kind and not step.is_activated:
                return step
        return self.copy(source, source.like()).writers[0]

    def sum_of_places(self, source: Map, factor: float, bias: np.ndarray) -> Map:
        """Add a step that sums all places, times a factor; returns the map of the sum.

        Each row is summed first, then the sums of the rows are summed. So after a change in one
        row, only this row and the row sums have to be summed again.
        """
        channels = source.channels
        # a map of one row or one column has no row sums
        if 1 not in source.sides:
            row_sums = Map(channels, source.rows, 1)
            ones = np.ones((source.columns, channels))
            kernel = (1, source.columns)
            self.add(SUM, [source], row_sums, ones, np.zeros(channels), kernel=kernel)
            source = row_sums
        weights = np.full((source.rows * source.columns, channels), factor)
        return self.add(SUM, [source], Map(channels, 1, 1), weights, bias, kernel=source.sides)
