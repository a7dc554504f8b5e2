"""The projected sphere in the image: which pixels it covers, and the tiles that cover it.

Pixel (i, j) of an R x R image, i columns from the left and j rows from the top, has n_x = a / R and n_y = b / R with
the integers a = 2i + 1 - R and b = R - 2j - 1. It lies inside if a^2 + b^2 < R^2.
"""

from __future__ import annotations

import numpy as np

from . import checks
from .decisions import Decisions

MAX_RESOLUTION = 16384


def check_resolution(resolution: int) -> int:
    """The resolution of an image; raises :class:`LightdomeError` unless it is a whole number from 1 to 16384."""
    return checks.whole("the resolution", resolution, 1, MAX_RESOLUTION)


def disc_mask(resolution: int) -> np.ndarray:
    """Which pixels lie inside the projected sphere: (R, R) bool."""
    resolution = check_resolution(resolution)
    a = 2 * np.arange(resolution, dtype=np.int64) + 1 - resolution
    return a**2 + a[:, None] ** 2 < resolution**2


def disc_tiles(resolution: int, pixels: int, rows: int) -> np.ndarray:
    """First pixels (x, y) of the tiles that cover the disc, (T, 2) uint32; a tile is ``pixels`` wide, ``rows`` high.

    Each band of tiles starts where its widest row starts, so that few of its pixels lie outside.
    """
    half = 2 * np.arange(resolution, dtype=np.int64) + 1 - resolution
    # In row j, pixels with |a| <= reach are inside; a has the parity of R - 1. They run from `first` to its mirror
    # image.
    reach = np.sqrt(np.maximum(resolution**2 - half**2 - 1, 0)).astype(np.int64)
    y = np.arange(0, resolution, rows)
    first = np.minimum.reduceat((resolution - reach) // 2, y)
    count = -((2 * first - resolution) // pixels)
    band = np.repeat(np.arange(len(y)), count)
    tile = np.arange(len(band)) - np.repeat(np.cumsum(count) - count, count)
    return np.stack([first[band] + pixels * tile, y[band]], axis=1).astype(np.uint32)


def note_tiles(decisions: Decisions, tiles: np.ndarray, resolution: int, pixels: int, rows: int) -> None:
    """Note that tiles were skipped, if there are fewer ``tiles`` than cover the whole image."""
    if len(tiles) < -(-resolution // pixels) * -(-resolution // rows):
        decisions.skip("tiles outside the disc", "no pixel there shows the sphere")
