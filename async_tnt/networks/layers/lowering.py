"""The steps of the compiled interpreter that a network's layers become.

Batch norms are folded into the step before them, and activations become part of it. A dense layer
that reads a map becomes three steps: what each place adds, the sum of each row, and the sum of the
rows. A global average pooling becomes the last two of these steps.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from async_tnt.networks.layers.graph import VOLUME, layer_shapes
from async_tnt.networks.layers.layer import Layer
from async_tnt.networks.layers.operations import OPERATIONS
from async_tnt.networks.layers.steps import Map, Step, StepList


def steps_of(
    layers: Sequence[Layer], volume: Map, tensors: Mapping[str, np.ndarray]
) -> tuple[list[Step], Map]:
    """The steps of a network in order, and the map of the network's output.

    The layers must have been checked. Steps whose results nothing reads are left out. Each map has
    the frame that its readers need. If the last layer is a `heatmap_centroid`, the output is its
    heatmap: the centroid itself is no step.
    """
    steps, output = _steps_of_all_layers(layers, volume, tensors)
    steps = _without_unused(steps, (volume, output))
    _give_frames(steps)
    return steps, output


def _steps_of_all_layers(
    layers: Sequence[Layer], volume: Map, tensors: Mapping[str, np.ndarray]
) -> tuple[list[Step], Map]:
    """The steps of all layers, and the map of the last layer's output."""
    tensor_shapes = {name: w.shape for name, w in tensors.items()}
    shapes = layer_shapes(layers, (volume.channels, *volume.sides), tensor_shapes)
    step_list = StepList(shapes, _count_readers(layers), tensors)
    maps = {VOLUME: volume}
    for layer in layers:
        step_list.name = layer["name"]
        inputs = [maps[name] for name in layer["inputs"]]
        maps[layer["name"]] = OPERATIONS[layer["op"]].steps(step_list, layer, inputs)
    output = maps[layers[-1]["name"]]
    if output is volume:
        output = step_list.copy(volume, volume.like())
    return step_list.steps, output


def _count_readers(layers: Sequence[Layer]) -> Counter[str]:
    """Layer -> how many layers read its output, directly or through a flatten.

    The caller counts as a reader of the network's output.
    """
    origins: dict[str, str] = {}  # flatten -> the layer whose numbers it has
    readers: Counter[str] = Counter()
    for layer in layers:
        sources = [origins.get(name, name) for name in layer["inputs"]]
        if layer["op"] == "flatten":
            origins[layer["name"]] = sources[0]
        else:
            readers.update(sources)
    output: str = layers[-1]["name"]
    readers[origins.get(output, output)] += 1
    for name, origin in origins.items():
        readers[name] = readers[origin]
    return readers


def _without_unused(steps: list[Step], keep: Sequence[Map]) -> list[Step]:
    """The steps whose maps are read by a later step or are in `keep`.

    A pooling may leave the last rows and columns of its input unread. If no other step reads these
    rows and columns, they are not computed.
    """
    # map -> how many of its rows and columns are read
    needed_sides: dict[Map, tuple[int, int]] = {}
    used_steps_reversed = []
    # from the last step to the first, so that all readers of a map come before its writers
    for step in reversed(steps):
        if step.output not in keep:
            if step.output not in needed_sides:
                continue
            step.rows, step.columns = needed_sides[step.output]
        rows, columns = step.reads
        for input_map in step.inputs:
            rows_before, columns_before = needed_sides.get(input_map, (1, 1))
            needed_sides[input_map] = (
                min(max(rows_before, rows), input_map.rows),
                min(max(columns_before, columns), input_map.columns),
            )
        used_steps_reversed.append(step)
    return used_steps_reversed[::-1]


def _give_frames(steps: list[Step]) -> None:
    """Give each map the frame that its readers need; the inputs of a step get the same frame."""
    for step in steps:
        rows, columns = step.reads
        for input_map in step.inputs:
            below = max(0, rows - input_map.rows)
            right = max(0, columns - input_map.columns)
            _widen(input_map, (*step.padding, below, right))

    # A map may be an input of several steps. So a wider frame of one map may widen further frames.
    has_widened = True
    while has_widened:
        has_widened = False
        for step in steps:
            for input_map in step.inputs:
                for other_input in step.inputs:
                    has_widened |= _widen(input_map, other_input.frame)


def _widen(widened_map: Map, frame: Sequence[int]) -> bool:
    """Make a map's frame at least as wide as `frame`; returns whether that changed anything."""
    before = widened_map.frame
    top, left, bottom, right = map(max, before, frame)
    widened_map.frame = (top, left, bottom, right)
    return widened_map.frame != before
