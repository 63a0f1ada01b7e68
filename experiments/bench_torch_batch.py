"""Batch processing in torch, as fast as we can make it: a window's volume from all its events, then the network.

The reference in `tnt_reference` is written for reading, this one for timing: float32, no masks, one `scatter_add_` for
all eight neighbours. It must give the same volume (a test compares it with the reference).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from async_tnt.config import TNTConfig
from async_tnt.networks.model import Model
from async_tnt.networks.torch_modules import torch_classifier, torch_regressor

BORDER_TOLERANCE = 1e-5  # pixels, the rounding of float32 at these sizes; see `tnt_reference`

Columns = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


def as_tensors(events: np.ndarray, start_us: int) -> Columns:
    """Time since `start_us`, x, y (float32) and sign (float32, -1 or +1) of structured events, shape (N,)."""
    dt = torch.from_numpy((events["t"] - start_us).astype(np.float32))
    x, y, p = (torch.from_numpy(events[name].astype(np.float32)) for name in "xyp")
    return dt, x, y, 2 * p - 1


class TorchBatch:
    """A model's volume and logits from a whole window's events.

    Parameters
    ----------
    config : TNTConfig; every landmark, transform and polarity.
    model : of this configuration; None for volumes alone.
    """

    def __init__(self, config: TNTConfig, model: Model | None = None) -> None:
        self.config = config
        width, height = config.grid
        plane = width * height
        self._corners = torch.tensor(
            [b * plane + y * width + x for b in (0, min(1, config.bins - 1)) for y in (0, 1) for x in (0, 1)]
        )[:, None]  # (8, 1); a single bin has no later neighbour, and gets nothing as one
        self._on_grid = [(width - 1) / (config.sensor[0] - 1), (height - 1) / (config.sensor[1] - 1)]
        self._centre = [(width - 1) / 2, (height - 1) / 2]
        self.network = None if model is None else torch_classifier(model)
        self._regressor = None if model is None else torch_regressor(model)

    def logits(self, volume: torch.Tensor) -> torch.Tensor:
        """(C, H, W) -> (n_classes,)."""
        assert self.network is not None
        result: torch.Tensor = self.network(volume[None])[0]
        return result

    def volume(self, dt: torch.Tensor, x: torch.Tensor, y: torch.Tensor, sign: torch.Tensor) -> torch.Tensor:
        """float32 (C, H, W) of one window's events, as `as_tensors` makes them."""
        config = self.config
        u, v = x * self._on_grid[0], y * self._on_grid[1]
        keep = None
        if config.transform == "tnt":
            landmark = self._centre
            if self._regressor is not None:
                landmark = self._regressor(self._volume(dt, u, v, sign, None)[None])[0].float()
            (u, v), keep = self._transform(dt, u, v, landmark)
        return self._volume(dt, u, v, sign, keep)

    def _volume(
        self, dt: torch.Tensor, u: torch.Tensor, v: torch.Tensor, sign: torch.Tensor, keep: torch.Tensor | None
    ) -> torch.Tensor:
        """The volume of events at u, v; of those at the indices `keep`, where given."""
        config = self.config
        if config.polarity != "signed":
            on, sign = sign > 0, torch.ones_like(sign)
        if keep is not None:
            dt, u, v, sign = dt[keep], u[keep], v[keep], sign[keep]
        b = dt * ((config.bins - 1) / config.window_us)
        if config.polarity != "split":
            return self._splat(b, v, u, sign)
        on = on if keep is None else on[keep]
        return torch.cat([self._splat(b[side], v[side], u[side], sign[side]) for side in (on, ~on)])

    def _transform(self, dt: torch.Tensor, u: torch.Tensor, v: torch.Tensor, landmark: Any) -> Any:
        config = self.config
        tau = dt * (config.t_max / config.window_us)
        moved = []
        keep = tau > 0
        for side, (z, centre) in enumerate(zip((u, v), self._centre, strict=True)):
            last = config.grid[side] - 1
            offset = self._offset(dt, z, landmark[side]) / tau + centre
            clamped = offset.clamp(0, last)
            keep &= (offset - clamped).abs_() <= BORDER_TOLERANCE  # False for the nan of 0 / 0
            moved.append(clamped)
        return moved, keep.nonzero()[:, 0]  # indices, computed once, are four times faster than four masks

    def _offset(self, dt: torch.Tensor, z: torch.Tensor, fixed: Any) -> torch.Tensor:
        """One coordinate, relative to the landmark (and flow); `fixed` is that of `center` and `regressor`."""
        landmark = self.config.landmark
        if landmark in ("center", "regressor"):
            return z - fixed
        if landmark == "window":
            return z - z.mean()
        n = torch.arange(1, len(z) + 1, dtype=torch.float64 if landmark == "line" else torch.float32)
        if landmark == "running":
            return z - z.cumsum(0, dtype=torch.float64).div_(n).float()
        # running line by prefix sums: float64 because of cancellation
        z, f = z.double(), dt.double() / self.config.window_us
        mean_z, mean_f = z.cumsum(0) / n, f.cumsum(0) / n
        c_zf = (z * f).cumsum(0) - n * mean_z * mean_f
        c_ff = (f * f).cumsum(0) - n * mean_f * mean_f
        slope = c_zf / (c_ff + 1)
        offset = z - (mean_z - slope * mean_f)
        if self.config.remove_flow:
            offset -= slope * f
        return offset.float()

    def _splat(self, b: torch.Tensor, v: torch.Tensor, u: torch.Tensor, sign: torch.Tensor) -> torch.Tensor:
        """V[b, y, x] += s k(b - b_i) k(y - v_i) k(x - u_i), all eight cells of all events in one operation."""
        bins, (width, height) = self.config.bins, self.config.grid
        # The lower corner stays one short of the last cell, so that the upper one is in the volume: an event
        # at u = W - 1 gives all of its weight to the upper. Saves the masks and a padded copy.
        b0 = b.floor().clamp_(max=max(bins - 2, 0))
        v0 = v.floor().clamp_(max=height - 2)
        u0 = u.floor().clamp_(max=width - 2)
        corner = b0.long() * (height * width) + v0.long() * width + u0.long()  # (M,)
        fb, fv, fu = b - b0, v - v0, u - u0
        late = sign * fb
        shares = torch.stack([sign - late, late])  # (2, M)
        rows = torch.stack([1 - fv, fv])  # (2, M)
        columns = torch.stack([1 - fu, fu])  # (2, M)
        weights = shares[:, None, None] * rows[None, :, None] * columns[None, None]  # (2, 2, 2, M)
        volume = torch.zeros(bins * height * width)
        volume.scatter_add_(0, (corner + self._corners).reshape(-1), weights.reshape(-1))
        return volume.view(bins, height, width)
