"""Print and draw how far features are from moving along with optical flow, layer by layer.

    python -m experiments.figure_equivariance [--picture docs/images/equivariance.png] [--json FILE]

Flow is added to the first saccade of the bundled 3, on a larger sensor. With F the features of a
layer of `digits` and T a translation by whole cells of the layer, the equivariance error is the
smallest

    |F(L_v e) - T F(e)| / |F(e)|

over T. The features of an empty volume are subtracted from F. A layer whose cells are 4 pixels
apart can move along by multiples of 4 pixels only. The features of dense layers have no places, so
nothing is translated there. Dense layers see the middle 34 x 34 cells, as on the network's own
sensor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import torch.nn.functional as F
from tnt_reference import event_volume, move_by_flow, tnt_volume

from async_tnt import load_model
from async_tnt.cli.bench import machine
from async_tnt.networks.models.torch_modules import torch_classifier
from async_tnt.sources import open_recording, sample_recordings
from async_tnt.views.figure_style import TEXT, axes_at, headline, new_figure
from experiments.scripts.options import exit_with, run_script, script_parser

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIDE = 82
"""Width and height of the grid, in pixels. It has room for a digit that moves."""

OWN_SIDE = 34
"""Width and height of the grid of `digits`."""

WINDOW_US = 105_000
"""Length of the window, in microseconds."""

T_MAX = 2.0
"""Scaled time at the end of the window."""

BINS = 9
"""Bins of the volume."""

MARGIN = (SIDE - OWN_SIDE) // 2
"""Pixels between the border of the grid and that of `digits`."""

REFERENCE: dict[str, Any] = dict(
    start_us=0, window_us=WINDOW_US, sensor=(SIDE, SIDE), grid=(SIDE, SIDE), bins=BINS
)
"""Arguments of the reference: window, sensor, grid and bins."""

FLOWS = (0, 1, 2, 3, 5, 8, 13, 16)
"""Flows to the right, in pixels per window. The first one must be 0. TNT about the centre turns
a flow v into a translation by v / t_max."""

INPUTS: dict[str, dict[str, Any]] = {
    "raw": {},
    "TNT, center": {"landmark": "center"},
    "TNT, running": {"landmark": "running"},
    "TNT, line": {"landmark": "line"},
    "TNT, line, flow removed": {"landmark": "line", "remove_flow": True},
}
"""Name of an input -> arguments of its transform in the reference; the raw volume has none."""

LAYERS = {
    "volume": 1,
    "convolution 1": 1,
    "pooling 1": 2,
    "convolution 2": 2,
    "pooling 2": 4,
    "dense 1": 0,
    "logits": 0,
}
"""Layer of `digits` -> pixels between its cells; 0 if its features have no places."""


def volume_of(landmark: dict[str, Any], flow: float) -> torch.Tensor:
    """The volume of an input with flow added: (1, B, H, W), float64."""
    events = open_recording(sample_recordings()[3]).read()
    events = events[(events["t"] > 0) & (events["t"] < WINDOW_US)]
    t = torch.from_numpy(events["t"].astype(np.int64))
    places = torch.from_numpy(np.stack([events["x"], events["y"]]).astype(np.float64)) + MARGIN
    x, y = move_by_flow(t, places[0], places[1], (flow, 0.0), start_us=0, window_us=WINDOW_US)
    columns: dict[str, Any] = {
        "t": t,
        "x": x,
        "y": y,
        "p": torch.from_numpy(events["p"].astype(np.int64)),
    }
    if not landmark:
        return event_volume(**columns, **REFERENCE, dtype=torch.float64)[None]
    return tnt_volume(**columns, **REFERENCE, t_max=T_MAX, **landmark, dtype=torch.float64)[None]


def features(volume: torch.Tensor, weights: dict[str, torch.Tensor]) -> list[torch.Tensor]:
    """The features of each layer, in the order of `LAYERS`."""
    maps = _maps(volume, weights)
    last_map = _maps(volume[..., MARGIN:-MARGIN, MARGIN:-MARGIN], weights)[-1].flatten(1)
    hidden = F.linear(last_map, weights["fc1.weight"], weights["fc1.bias"]).relu()
    return [*maps, hidden, F.linear(hidden, weights["fc2.weight"], weights["fc2.bias"])]


def _maps(volume: torch.Tensor, weights: dict[str, torch.Tensor]) -> list[torch.Tensor]:
    """The volume, and the features of the convolutions and poolings, in order."""
    first = F.conv2d(volume, weights["conv1.weight"], weights["conv1.bias"], padding=1).relu()
    pooled = F.avg_pool2d(first, 2)
    second = F.conv2d(pooled, weights["conv2.weight"], weights["conv2.bias"], padding=1).relu()
    return [volume, first, pooled, second, F.avg_pool2d(second, 2)]


def measure(quick: bool = False) -> dict[str, Any]:
    """The report, with the equivariance error of each input, layer and flow."""
    flows = FLOWS[:2] if quick else FLOWS
    tensors = torch_classifier(load_model("digits")).tensors
    weights = {name: tensor.detach().double() for name, tensor in tensors.items()}
    errors_by_input = {}
    for name, landmark in INPUTS.items():
        features_by_flow = [features(volume_of(landmark, flow), weights) for flow in flows]
        # the first flow is 0, and the first features are the volume itself
        features_at_rest = features_by_flow[0]
        empty_volume = torch.zeros_like(features_at_rest[0])
        empty = features(empty_volume, weights)
        errors: dict[str, list[float]] = {}
        for k, (layer, pixels) in enumerate(LAYERS.items()):
            errors[layer] = [
                _error(moved[k], features_at_rest[k], empty[k], pixels, flow)
                for flow, moved in zip(flows, features_by_flow, strict=True)
            ]
        errors_by_input[name] = errors
    return {"machine": machine(), "flows_px": flows, "errors": errors_by_input}


def _error(
    moved: torch.Tensor, still: torch.Tensor, empty: torch.Tensor, pixels: int, flow: int
) -> float:
    """The equivariance error at the best translation of 0 to `flow` pixels.

    A translation rolls cells round the border of the map. The cells that this may reach are left
    out, and so are the cells within 4 pixels of the border.

    pixels : distance between the cells of the layer, in pixels; 0 if nothing can be translated.
    """
    if not pixels:
        return float((moved - still).norm() / (still - empty).norm())
    most_cells = -(-flow // pixels)  # in cells, rounded up
    border = -(-4 // pixels)  # 4 pixels in cells, rounded up
    inner = (..., slice(border, -border), slice(most_cells + border, -border))
    size = (still - empty)[inner].norm()
    differences = [(moved - still.roll(n_cells, -1))[inner] for n_cells in range(most_cells + 1)]
    return min(float(difference.norm() / size) for difference in differences)


def draw(report: dict[str, Any]) -> Figure:
    """Draw a panel for each input, with a line for each layer."""
    figure = new_figure(3.4)
    colours = ("#000000", "#56B4E9", "#0072B2", "#E69F00", "#D55E00", "#009E73", "#CC79A7")
    first: Any = None
    for k, (name, errors_by_layer) in enumerate(report["errors"].items()):
        axes = axes_at(figure, 0.65 + 1.96 * k, 0.85, 1.7, 1.75, sharey=first)
        first = first or axes
        for (layer, errors), colour in zip(errors_by_layer.items(), colours, strict=True):
            axes.plot(
                report["flows_px"],
                errors,
                marker="o",
                ms=2.5,
                lw=1.2,
                color=colour,
                label=None if k else layer,
            )
        axes.set_title(name, color=TEXT)
        axes.set_xticks((0, 5, 10, 15))
        axes.grid(axis="y", color="#e4e4e4", lw=0.7)
        axes.tick_params(labelleft=k == 0)
    first.set_ylim(bottom=-0.03)
    first.set_ylabel("equivariance error")
    figure.text(0.5, 0.12, "flow (pixels per window)", ha="center")
    headline(figure, "How far each layer is from moving along with the flow")
    figure.legend(
        loc="lower center", ncols=len(LAYERS), labelcolor=TEXT, bbox_to_anchor=(0.5, -0.02)
    )
    return figure


def main(argv: list[str] | None = None) -> int:
    """Print the table, and draw it."""
    parser = script_parser("figure_equivariance", __doc__, "two flows", draws=True)
    return run_script(parser, argv, measure, "equivariance", draw)


if __name__ == "__main__":
    exit_with(main)
