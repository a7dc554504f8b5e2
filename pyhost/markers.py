"""Show where samples fell on a map."""

from __future__ import annotations

import numpy as np


def mark_pixels(image: np.ndarray, pixel: np.ndarray, size: int, colour: tuple[float, float, float]) -> None:
    """Paint a ``size`` x ``size`` square round each pixel into ``image``, in place.

    - ``image``: (H, W, 3)
    - ``pixel``: (N, 2) integers (x, y)

    Squares wrap from the left edge to the right one, where the map meets itself, and are clipped at the
    poles. A square of even size reaches one pixel further to the right and down.
    """
    height, width = image.shape[:2]
    offset = np.arange(size) - (size - 1) // 2
    marked = np.zeros((height, width), bool)
    x, y = pixel[:, 0], pixel[:, 1]
    for dy in offset:
        rows = y + dy
        inside = (rows >= 0) & (rows < height)
        for dx in offset:
            marked[rows[inside], (x[inside] + dx) % width] = True
    image[marked] = colour
