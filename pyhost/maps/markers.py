"""Mark the pixels of samples on a map."""

from __future__ import annotations

import numpy as np

from .. import checks
from ..errors import LightdomeError

PIXELS_AT_ONCE = 2**22
BLUE, OUTLINE = (0, 0, 255), (255, 255, 255)  # in pictures: blue alone would not show on blue glass


def mark_picture(picture: np.ndarray, pixel: np.ndarray, size: int) -> None:
    """:func:`mark_pixels` in blue, with an outline of one white pixel, in a picture of 8-bit values."""
    # Two more pixels keep the size even or odd, and so the squares where they are.
    mark_pixels(picture, pixel, min(checks.whole("a marker's size", size, 1, 2**31 - 1) + 2, 2**31 - 1), OUTLINE)
    mark_pixels(picture, pixel, size, BLUE)


def mark_pixels(image: np.ndarray, pixel: np.ndarray, size: int, colour: tuple[float, float, float]) -> None:
    """Paint a ``size`` x ``size`` square around each pixel into ``image``, in place.

    - ``image``: (H, W, 3)
    - ``pixel``: (N, 2) integers (x, y)

    Squares wrap between the left and right edges, where the map meets itself, and are clipped at the poles. A square of
    even size extends one pixel further to the right and down. The time is proportional to the image plus N, whatever
    the size.

    Raises :class:`LightdomeError` for a size that is not from 1 to 2147483647, and for pixels outside the image.
    """
    checks.instance("the image", image, np.ndarray)
    checks.array("the image", image, ("H", "W", 3))
    if not image.flags.writeable:
        raise LightdomeError("the image must be writable, but this one is read-only; pass a copy")
    checks.array("the colour", colour, (3,))
    pixel = checks.array("pixel", pixel, ("N", 2))
    size = checks.whole("a marker's size", size, 1, 2**31 - 1)
    height, width = image.shape[:2]
    marked = np.zeros((height, width), bool)
    for begin in range(0, len(pixel), PIXELS_AT_ONCE):
        x, y = pixel[begin : begin + PIXELS_AT_ONCE].T
        if pixel.dtype.kind == "f" or min(x.min(), y.min()) < 0 or x.max() >= width or y.max() >= height:
            raise LightdomeError(f"pixel must hold whole numbers (x, y) inside the {width} x {height} image")
        marked[y, x] = True
    before, after = (size - 1) // 2, size // 2
    _spread(marked, before, after, wrap=True)
    _spread(marked.T, before, after, wrap=False)
    image[marked] = colour


def _spread(marked: np.ndarray, before: int, after: int, wrap: bool) -> None:
    """Also mark entries up to ``before`` places before a marked one in its row, and up to ``after`` places after it."""
    count, length = marked.shape
    before, after = min(before, length), min(after, length)
    entry = np.arange(length)
    step = max(1, PIXELS_AT_ONCE // length)
    for row in range(0, count, step):
        rows = marked[row : row + step]
        if wrap:
            rows = np.concatenate([rows[:, length - after :], rows, rows[:, :before]], axis=1)
            first, end = entry, entry + before + after + 1
        else:
            first, end = np.maximum(entry - after, 0), np.minimum(entry + before + 1, length)
        sums = np.zeros((len(rows), rows.shape[1] + 1), np.int32)
        np.cumsum(rows, axis=1, out=sums[:, 1:])
        marked[row : row + step] = sums[:, end] > sums[:, first]
