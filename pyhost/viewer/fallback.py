"""Draws the pictures for a page without WebGL."""

from __future__ import annotations

import numpy as np

from ..lighting.lights import Lights
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import column_angles, directions, row_angles
from ..maps.images import tone_map
from ..maps.markers import mark_pixels
from ..maps.pictures import Picture
from ..maps.rotation import rotation_matrix
from .messages import Setting

WIDTH = 768  # of the map's picture, in pixels
MARK, BLUE = 5, (0, 114, 178)  # size of a mark, in pixels, and its colour
# Colours for a difference of -1, 0 and +1, as in the page's shader.
TOO_DARK, RIGHT, TOO_BRIGHT = (np.array(c) for c in ((0.0, 0.447, 0.698), (0.93, 0.93, 0.93), (0.835, 0.369, 0.0)))


def pictures_of(
    envmap: EnvironmentMap,
    exposures: tuple[float, float],
    setting: Setting,
    image: np.ndarray,
    exact: np.ndarray,
    lights: Lights | None,
) -> dict[str, np.ndarray]:
    """PNG files, as uint8 arrays: the turned map with its marks, the image, the exact image and their difference."""
    assert setting.pictures is not None
    exposure, gamma, percent = setting.pictures
    most = percent / 100 * float(exact.max())
    made = {
        "map": _map(envmap, exposures[0] * exposure, gamma, setting.angles, lights),
        "image": tone_map(np.maximum(image, 0), exposures[1] * exposure, gamma),
        "reference": tone_map(exact, exposures[1] * exposure, gamma),
        "difference": false_colour((image - exact).mean(axis=2) / (most if most > 0 else 1)),
    }
    return {name: np.frombuffer(Picture(pixels)._repr_png_(), np.uint8) for name, pixels in made.items()}


def false_colour(difference: np.ndarray) -> np.ndarray:
    """Blue where an image is too dark, orange where it is too bright; full colour at -1 and 1 and beyond; uint8."""
    share = np.clip(difference, -1, 1)[..., None]
    colour = RIGHT + np.abs(share) * (np.where(share < 0, TOO_DARK, TOO_BRIGHT) - RIGHT)
    return np.rint(255 * colour).astype(np.uint8)


def _map(
    envmap: EnvironmentMap, exposure: float, gamma: float, angles: tuple[float, float, float], lights: Lights | None
) -> np.ndarray:
    """The map after the turn R: its pixel in direction d shows what was in direction R^-1 d."""
    width = min(WIDTH, envmap.width)
    height = max(1, width * envmap.height // envmap.width)
    before = directions(row_angles(height)[:, None], column_angles(width)) @ rotation_matrix(*angles)
    picture = tone_map(envmap.radiance[place_of(before, envmap.height, envmap.width)], exposure, gamma)
    if lights is not None:
        row, column = place_of(lights.rotated(*angles).direction, height, width)
        mark_pixels(picture, np.stack([column, row], axis=1), MARK, BLUE)
    return picture


def place_of(direction: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """The rows and columns of a map's pixels that directions (..., 3) fall into."""
    x, y, z = np.moveaxis(direction, -1, 0)
    row = np.arctan2(np.hypot(x, z), y) * (height / np.pi)
    column = np.arctan2(z, x) * (width / (2 * np.pi)) % width
    return np.minimum(row.astype(np.int64), height - 1), np.minimum(column.astype(np.int64), width - 1)
