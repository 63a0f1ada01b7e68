"""The logit of a taught class, from all readings at once.

A reading is u = (x, s): components of a network's features, and the logarithm of the sum of the
exponentials of its logits.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch


def taught_row(
    taught: torch.Tensor,
    others: Sequence[torch.Tensor],
    *,
    margin: float,
    share: float = 0.3,
    ridge: float = 0.03,
) -> torch.Tensor:
    """The row r of a taught class: its logit is r . (x, 1).

    It minimizes the following sum over classes c, with y = 1 in the taught class and y = -1 in each
    other class. The taught class has the weight w = `share`, and all others have equal parts of the
    rest. The weight a is `ridge` times the mean of w x^2 over components.

        sum_c w_c mean_c (r . (x, 1) - s - margin y)^2 + a ||r_x||^2

    It is solved as a least-squares problem with a line for each reading and each component.

    Parameters
    ----------
    taught : readings of the class, (N, p + 1).
    others : readings of each other class, (N_c, p + 1).
    margin, share, ridge : see above.

    Returns
    -------
    float64, (p + 1,).
    """
    p = taught.shape[1] - 1
    lines = []
    targets = []
    for readings, weight, y in [
        (taught, share, 1.0),
        *((other, (1 - share) / len(others), -1.0) for other in others),
    ]:
        u = readings.double()
        root = (weight / len(u)) ** 0.5
        ones = torch.ones(len(u), 1, dtype=torch.float64)
        lines.append(root * torch.cat([u[:, :p], ones], dim=1))
        targets.append(root * (u[:, p] + margin * y))
    spread = torch.cat(lines)[:, :p].square().sum() / p
    # the square of any float32 but 0 is larger, and smaller numbers have too few bits to divide
    says_something = spread > 1e-200
    a = ridge * spread if says_something else torch.ones(())
    lines.append(torch.cat([a.sqrt() * torch.eye(p), torch.zeros(p, 1)], dim=1).double())
    targets.append(torch.zeros(p, dtype=torch.float64))
    column = torch.cat(targets)[:, None]
    solution: torch.Tensor = torch.linalg.lstsq(torch.cat(lines), column, driver="gelsd").solution
    return solution[:, 0]
