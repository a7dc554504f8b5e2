"""Where the pixels of a latitude-longitude map lie: angles and solid angles of rows and columns.

Row 0 is the top. Pixel centres lie at theta = pi (y + 1/2) / H and phi = 2 pi (x + 1/2) / W; their
directions are (sin(theta) cos(phi), cos(theta), sin(theta) sin(phi)), so +y is up.
"""

from __future__ import annotations

import numpy as np

from .. import checks

MAX_SIDE = 2**31 - 1  # largest number of rows or columns


def row_angles(height: int) -> np.ndarray:
    """Polar angles theta of the rows' centres, (height,) float64, radians."""
    height = checks.whole("a height", height, 1, MAX_SIDE)
    return np.pi * (np.arange(height) + 0.5) / height


def column_angles(width: int) -> np.ndarray:
    """Azimuths phi of the columns' centres, (width,) float64, radians."""
    width = checks.whole("a width", width, 1, MAX_SIDE)
    return 2 * np.pi * (np.arange(width) + 0.5) / width


def solid_angles(height: int, width: int) -> np.ndarray:
    """Solid angle of one pixel in each row, (height,) float64, steradians; over the map they sum to 4 pi.

    The integral of sin(theta) over a row is 2 sin(pi / 2H) sin(theta), exactly proportional to sin(theta) at the row's
    centre.
    """
    height, width = checks.whole("a height", height, 1, MAX_SIDE), checks.whole("a width", width, 1, MAX_SIDE)
    return 2 * np.pi / width * 2 * np.sin(np.pi / (2 * height)) * np.sin(row_angles(height))


def directions(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) for angles theta and phi in radians, which are broadcast."""
    of_both = np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)
    return np.stack(np.broadcast_arrays(*of_both), axis=-1)


def sine_cosine(angle: np.ndarray) -> np.ndarray:
    # Tabulated on the host: sin and cos differ between devices in the last digits, but samples must not.
    return np.stack([np.sin(angle), np.cos(angle)], axis=1).astype(np.float32)
