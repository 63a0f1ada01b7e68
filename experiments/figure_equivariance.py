"""Print and draw how far features are from moving along with optical flow, layer by layer.

    python -m experiments.figure_equivariance [--picture docs/images/equivariance.png]

Flow is added to the first saccade of the bundled 3, on a larger sensor. With F the features of a layer and T a
translation by whole pixels, the equivariance error is the smallest

    |F(L_v e) - T F(e)| / |F(e)|

over T. Layers are those of `digits`, computed at every pixel (poolings with a stride of 1), so that all of them can be
translated by single pixels.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from tnt_reference import event_volume, move_by_flow, tnt_volume

from async_tnt import load_model
from async_tnt.networks.torch_modules import torch_classifier
from async_tnt.sources import open_recording, sample_recordings

SIDE, WINDOW_US, T_MAX, BINS = 81, 105_000, 2.0, 9
AT: dict[str, Any] = dict(start_us=0, window_us=WINDOW_US, sensor=(SIDE, SIDE), grid=(SIDE, SIDE), bins=BINS)
FLOWS = (0, 4, 8, 12, 16)
"""In pixels per window, to the right: multiples of 2 t_max, of which `running` leaves a whole number of pixels."""
INPUTS: dict[str, dict[str, Any]] = {
    "raw": {},
    "TNT, center": {"landmark": "center"},
    "TNT, running": {"landmark": "running"},
    "TNT, line": {"landmark": "line"},
    "TNT, line, flow removed": {"landmark": "line", "remove_flow": True},
}
LAYERS = ("volume", "convolution 1", "pooling 1", "convolution 2", "pooling 2")


def volume_of(landmark: dict[str, Any], flow: float) -> torch.Tensor:
    """(1, B, H, W), float64."""
    events = open_recording(sample_recordings()[3]).read()
    events = events[(events["t"] > 0) & (events["t"] < WINDOW_US)]
    middle = (SIDE - 34) / 2
    t = torch.from_numpy(events["t"].astype(np.int64))
    place = torch.from_numpy(np.stack([events["x"] + middle, events["y"] + middle]))
    x, y = move_by_flow(t, place[0], place[1], (flow, 0.0), start_us=0, window_us=WINDOW_US)
    columns: dict[str, Any] = {"t": t, "x": x, "y": y, "p": torch.from_numpy(events["p"].astype(np.int64))}
    if not landmark:
        return event_volume(**columns, **AT, dtype=torch.float64)[None]
    return tnt_volume(**columns, **AT, t_max=T_MAX, **landmark, dtype=torch.float64)[None]


def features(volume: torch.Tensor, network: Any) -> list[torch.Tensor]:
    """Of each of `LAYERS`, at every pixel."""
    w = network.tensors
    first = F.conv2d(volume, w["conv1.weight"], w["conv1.bias"], padding=1).relu()
    pooled = F.avg_pool2d(first, 2, stride=1)
    second = F.conv2d(pooled, w["conv2.weight"], w["conv2.bias"], padding=2, dilation=2).relu()
    rows = (second[..., :-2, :] + second[..., 2:, :]) / 2  # what 2 x 2 averages are among every other place
    return [volume, first, pooled, second, (rows[..., :-2] + rows[..., 2:]) / 2]


def errors() -> dict[str, np.ndarray]:
    """Input -> (layers, flows): equivariance errors."""
    network: Any = torch_classifier(load_model("digits")).double().requires_grad_(False)
    found = {}
    for name, landmark in INPUTS.items():
        of_flow = [features(volume_of(landmark, flow), network) for flow in FLOWS]
        found[name] = np.array(
            [
                [_error(moved[k], of_flow[0][k], flow) for flow, moved in zip(FLOWS, of_flow, strict=True)]
                for k in range(len(LAYERS))
            ]
        )
    return found


def _error(moved: torch.Tensor, still: torch.Tensor, flow: int) -> float:
    """By the best translation of 0 to `flow` pixels; cells that rolling round the border reaches are left out."""
    inner = (..., slice(4, -4), slice(flow + 4, -4))
    size = (still - still[..., :1, :1])[inner].norm()  # without what an empty volume gives
    return min(float((moved - still.roll(by, -1))[inner].norm() / size) for by in range(flow + 1))


def draw(found: dict[str, np.ndarray], path: str) -> None:
    from async_tnt.views.figure_style import TEXT, axes_at, headline, new_figure, save, styled

    with styled():
        figure = new_figure(3.4)
        colours = ("#000000", "#56B4E9", "#0072B2", "#E69F00", "#D55E00")
        first: Any = None
        for k, (name, values) in enumerate(found.items()):
            axes = axes_at(figure, 0.65 + 1.96 * k, 0.85, 1.7, 1.75, sharey=first)
            first = first or axes
            for layer, row, colour in zip(LAYERS, values, colours, strict=True):
                axes.plot(FLOWS, row, marker="o", ms=3.5, color=colour, label=layer if k == 0 else None)
            axes.set_title(name, color=TEXT)
            axes.set_xticks(FLOWS)
            axes.grid(axis="y", color="#e4e4e4", lw=0.7)
            axes.tick_params(labelleft=k == 0)
        first.set_ylim(bottom=-0.03)
        first.set_ylabel("equivariance error")
        figure.text(0.5, 0.12, "flow (pixels per window)", ha="center")
        headline(figure, "How far each layer is from moving along with the flow")
        figure.legend(loc="lower center", ncols=len(LAYERS), labelcolor=TEXT, bbox_to_anchor=(0.5, -0.02))
        save(figure, Path(path), dpi=100)


def main() -> None:
    """Print the table, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", metavar="FILE", help="also draw the errors into this file")
    args = parser.parse_args()
    found = errors()
    print(f"| input | layer | {' | '.join(f'{flow} px' for flow in FLOWS)} |")
    print("| --- " * (2 + len(FLOWS)) + "|")
    for name, values in found.items():
        for layer, row in zip(LAYERS, values, strict=True):
            print(f"| {name} | {layer} | {' | '.join(f'{error:.2f}' for error in row)} |")
    if args.picture:
        draw(found, args.picture)


if __name__ == "__main__":
    main()
