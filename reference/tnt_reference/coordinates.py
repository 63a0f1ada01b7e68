"""Where an event lies: in the grid, in time, in the window. One function per equation.

Everything is float64, and on the CPU every function performs exactly the operations of its
equation, in that order. The streaming kernels perform the same operations, so both agree on whether
an event lies inside the border.
"""

from __future__ import annotations

import torch


def to_grid(points: torch.Tensor, sensor: tuple[int, int], grid: tuple[int, int]) -> torch.Tensor:
    """Sensor pixels to grid pixels, corner to corner:  x_g = (x (W - 1)) / (Ws - 1).

    points : (..., 2), (x, y). The map has no offset, so it takes displacements and flows as well.

    A side of one pixel has one place, 0, on the sensor and on the grid.

    Raises
    ------
    ValueError : only one of the two has a side of one pixel.
    """
    for name, sensor_side, grid_side in zip(("width", "height"), sensor, grid, strict=True):
        if (sensor_side == 1) != (grid_side == 1):
            raise ValueError(
                f"`sensor` and `grid` must both have a {name} of 1 pixel or both more, got "
                f"{tuple(sensor)} and {tuple(grid)}"
            )
    grid_span = torch.tensor(grid, dtype=torch.float64, device=points.device) - 1  # (2,)
    sensor_span = torch.tensor(sensor, dtype=torch.float64, device=points.device) - 1  # (2,)
    return (points.double() * grid_span) / sensor_span.clamp(min=1)


def image_centre(grid: tuple[int, int], device: torch.device | None = None) -> torch.Tensor:
    """c = ((W - 1)/2, (H - 1)/2), shape (2,)."""
    return (torch.tensor(grid, dtype=torch.float64, device=device) - 1) / 2


def bin_position(dt: torch.Tensor, window_us: int, bins: int) -> torch.Tensor:
    """b_i = ((B - 1) dt_i) / window_us: 0 at the window's start, B - 1 at its end."""
    return ((bins - 1) * dt) / window_us


def tnt_time(dt: torch.Tensor, window_us: int, t_max: float) -> torch.Tensor:
    """tau_i = (t_max dt_i) / window_us: 0 at the window's start, t_max at its end."""
    return (t_max * dt) / window_us


def window_fraction(dt: torch.Tensor, window_us: int) -> torch.Tensor:
    """f_i = dt_i / window_us: 0 at the window's start, 1 at its end."""
    return dt / window_us
