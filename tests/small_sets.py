"""Small sets of pictures, for tests."""

from __future__ import annotations

import numpy as np


def write_pictures(folder, n=5, classes=("bar", "disc")):
    """`folder/<class>/<number>.png`: bright bars and discs, of several widths."""
    from PIL import Image

    y, x = np.mgrid[:20, :20]
    for k, name in enumerate(classes):
        (folder / name).mkdir(parents=True, exist_ok=True)
        for i in range(n):
            shape = abs(x - 10) < 2 + i % 3 if k == 0 else np.hypot(x - 10, y - 10) < 5 + i % 3
            values = np.where(shape & (abs(y - 10) < 8), 250 - 7 * i, 0).astype(np.uint8)
            Image.fromarray(values).save(folder / name / f"{name}{i:02}.png")
    return folder
