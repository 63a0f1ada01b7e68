"""The steps of the compiled interpreter that a network's layers become.

Batch norms are folded into the step before them, and activations become part of it. A dense layer
that reads a map becomes three steps: what each place adds, the sum of each row, and the sum of the
rows. A global average pooling becomes the last two of these steps.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from async_tnt.kernels.network.program import SUM
from async_tnt.networks.layers.graph import VOLUME, layer_shapes
from async_tnt.networks.layers.layer import Layer
from async_tnt.networks.layers.operations import OPERATIONS
from async_tnt.networks.layers.steps import Map, Step, StepList


def steps_of(
    layers: Sequence[Layer],
    volume: Map,
    tensors: Mapping[str, np.ndarray],
    outputs: Sequence[str] | None = None,
) -> tuple[list[Step], list[Map]]:
    """The steps of a network in order, and the maps of its outputs.

    The layers must have been checked. Steps whose results nothing reads are left out. Each map has
    the frame that its readers need. If an output is a `heatmap_centroid`, its map is the heatmap:
    the centroid itself is no step.

    Parameters
    ----------
    outputs : the layers that compute the outputs, by default the last one.
    """
    if outputs is None:
        outputs = (layers[-1]["name"],)
    steps, output_maps = _steps_of_all_layers(layers, volume, tensors, outputs)
    steps = _without_unused(steps, (volume, *output_maps))
    _give_frames(steps)
    return steps, output_maps


def _steps_of_all_layers(
    layers: Sequence[Layer],
    volume: Map,
    tensors: Mapping[str, np.ndarray],
    outputs: Sequence[str],
) -> tuple[list[Step], list[Map]]:
    """The steps of all layers, and the maps of the outputs."""
    tensor_shapes = {name: w.shape for name, w in tensors.items()}
    shapes = layer_shapes(layers, (volume.channels, *volume.sides), tensor_shapes, outputs)
    step_list = StepList(shapes, _count_readers(layers, outputs), tensors)
    maps = {VOLUME: volume}
    for layer in layers:
        step_list.name = layer["name"]
        inputs = [maps[name] for name in layer["inputs"]]
        maps[layer["name"]] = OPERATIONS[layer["op"]].steps(step_list, layer, inputs)
    output_maps = []
    for name in outputs:
        step_list.name = name
        is_copied = maps[name] is volume
        output_maps.append(step_list.copy(volume, volume.like()) if is_copied else maps[name])
    return step_list.steps, output_maps


def _count_readers(layers: Sequence[Layer], outputs: Sequence[str]) -> Counter[str]:
    """Layer -> how many layers read its output, directly or through a flatten.

    The caller counts as a reader of the network's outputs.
    """
    origins: dict[str, str] = {}  # flatten -> the layer whose numbers it has
    readers: Counter[str] = Counter()
    for layer in layers:
        sources = [origins.get(name, name) for name in layer["inputs"]]
        if layer["op"] == "flatten":
            origins[layer["name"]] = sources[0]
        else:
            readers.update(sources)
    readers.update(origins.get(name, name) for name in outputs)
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
        for input_map in step.inputs:
            rows, columns = step.reads(input_map)
            rows_before, columns_before = needed_sides.get(input_map, (1, 1))
            needed_sides[input_map] = (
                min(max(rows_before, rows), input_map.rows),
                min(max(columns_before, columns), input_map.columns),
            )
        used_steps_reversed.append(step)
    return used_steps_reversed[::-1]


def _give_frames(steps: list[Step]) -> None:
    """Give each map the frame that its readers need; the inputs of a SUM get the same frame."""
    for step in steps:
        for input_map in step.inputs:
            rows, columns = step.reads(input_map)
            below = max(0, rows - input_map.rows)
            right = max(0, columns - input_map.columns)
            _widen(input_map, (*step.padding, below, right))

    # A map may be an input of several steps. So a wider frame of one map may widen further frames.
    has_widened = True
    while has_widened:
        has_widened = False
        for step in steps:
            if step.kind != SUM:
                continue
            for input_map in step.inputs:
                for other_input in step.inputs:
                    has_widened |= _widen(input_map, other_input.frame)


def _widen(widened_map: Map, frame: Sequence[int]) -> bool:
    """Make a map's frame at least as wide as `frame`; returns whether that changed anything."""
    before = widened_map.frame
    top, left, bottom, right = map(max, before, frame)
    widened_map.frame = (top, left, bottom, right)
    return widened_map.frame != before
