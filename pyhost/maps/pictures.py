"""Pictures for a notebook: maps and images, tone mapped, and directions on an unlit map."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from .. import checks
from .images import auto_exposure, tone_map, write_image
from .markers import mark_picture

WIDTH = 1024  # largest width of a picture; of a wider image it shows every second pixel, or every third, ...
OF_DIRECTIONS = (256, 512)  # height and width
MARK = 5  # side of a marker
GREY = 40


class Picture:
    """8-bit ``pixels`` (H, W, 3), which a notebook shows when they are the value of a cell."""

    def __init__(self, pixels: np.ndarray) -> None:
        self.pixels = pixels

    def __repr__(self) -> str:
        height, width = self.pixels.shape[:2]
        return f"<Picture: {width} x {height}>"

    def _repr_png_(self) -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "picture.png"
            write_image(path, self.pixels)
            return path.read_bytes()


def show(
    image: np.ndarray, pixel: np.ndarray | None = None, exposure: float | None = None, gamma: float = 2.2
) -> Picture:
    """An image for a notebook: radiance (H, W, 3), tone-mapped as by :func:`tone_map`, or 8-bit values unchanged.

    ``pixel``, (N, 2) as in :class:`Samples`, are marked in blue with a white outline. The default exposure is that of
    :func:`auto_exposure`. An image wider than 1024 pixels is shown smaller. Raises :class:`LightdomeError` for other
    shapes, and for pixels outside the image.
    """
    image = checks.array("an image", image, ("H", "W", 3))
    step = max(1, -(-image.shape[1] // WIDTH))
    image = image[::step, ::step]
    if image.dtype != np.uint8:
        image = tone_map(image, auto_exposure(image) if exposure is None else exposure, gamma)
    if pixel is not None:
        image = image.copy()
        mark_picture(image, checks.array("pixel", pixel, ("N", 2)) // step, MARK)
    return Picture(image)


def show_directions(direction: np.ndarray, light: np.ndarray) -> Picture:
    """Directions (N, 3) as squares on a grey map, in the hue of their ``light`` (N, 3), whatever its brightness."""
    height, width = OF_DIRECTIONS
    x, y, z = direction.astype(np.float64).T
    row = np.minimum(np.arctan2(np.hypot(x, z), y) * (height / np.pi), height - 1).astype(np.int64)
    column = (np.arctan2(z, x) * (width / (2 * np.pi)) % width).astype(np.int64)
    brightest = light.max(axis=1, keepdims=True)
    colour = np.divide(light, brightest, out=np.zeros(light.shape), where=brightest > 0)
    shown = np.rint(255 * colour ** (1 / 2.2))
    pixels = np.full((height, width, 3), GREY, np.uint8)
    for down in range(-(MARK // 2), MARK // 2 + 1):
        for across in range(-(MARK // 2), MARK // 2 + 1):
            pixels[np.clip(row + down, 0, height - 1), (column + across) % width] = shown
    return Picture(pixels)
