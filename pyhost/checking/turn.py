"""How another program's image of the sphere is mirrored or turned, and with which convention that is right."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..maps.conventions import yaw_between
from ..maps.geometry import column_angles, directions, row_angles
from ..maps.rotation import rotation_matrix
from ..names import CONVENTIONS
from .causes import Irradiance

# How the normals of an image may be turned relative to the light; y is up, z towards the camera.
TURNS = {
    "": np.diag([1.0, 1, 1]),
    "mirrored left to right": np.diag([-1.0, 1, 1]),
    "mirrored front to back, as if phi ran the other way": np.diag([1.0, 1, -1]),
    "upside down": np.diag([1.0, -1, 1]),
    "turned by 180 degrees in the image": np.diag([-1.0, -1, 1]),
    "turned by 90 degrees in the image": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    "turned by 270 degrees in the image": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "x and y exchanged in the image": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
    "z taken for up": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "z taken for down": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "z taken for up, and mirrored": np.array([[-1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "z taken for down, and mirrored": np.array([[-1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
}


@dataclass(frozen=True)
class Orientation:
    """How normals are turned: by one of :data:`TURNS`, then by ``yaw`` degrees about +y."""

    turn: str
    yaw: float

    @property
    def matrix(self) -> np.ndarray:
        return rotation_matrix(-self.yaw) @ TURNS[self.turn]

    def told(self) -> str:
        """The orientation in words, with the conventions of maps that would make it right."""
        turns = {name: rotation_matrix(yaw_between(name, "lightdome")).T for name in CONVENTIONS}
        presets = [name for name, turn in turns.items() if np.abs(turn - self.matrix).max() < 1e-9]
        return f"{self}, which is right for a map with --convention {' or '.join(presets)}" if presets else str(self)

    def __str__(self) -> str:
        yaw = f"the map turned by {self.yaw:g} degrees about the vertical" if self.yaw else ""
        return " and ".join(part for part in (self.turn, yaw) if part)


ROWS, COLUMNS = 90, 180  # size of a table of directions


def table_of(irradiance: Irradiance) -> np.ndarray:
    """The irradiance for all directions, (90, 180, 3), as :func:`find_orientation` needs it."""
    towards = directions(row_angles(ROWS)[:, None], column_angles(COLUMNS)[None])
    return irradiance(towards.reshape(-1, 3)).reshape(ROWS, COLUMNS, 3)


def _looked_up(table: np.ndarray, vector: np.ndarray) -> np.ndarray:
    y = np.arccos(np.clip(vector[:, 1], -1, 1)) / np.pi * ROWS - 0.5
    x = np.arctan2(vector[:, 2], vector[:, 0]) / (2 * np.pi) * COLUMNS - 0.5
    y0, x0 = np.floor(y).astype(int), np.floor(x).astype(int)
    v, u = (y - y0)[:, None], (x - x0)[:, None]
    upper, lower = np.clip(y0, 0, ROWS - 1), np.clip(y0 + 1, 0, ROWS - 1)
    left, right = x0 % COLUMNS, (x0 + 1) % COLUMNS
    above = table[upper, left] * (1 - u) + table[upper, right] * u
    below = table[lower, left] * (1 - u) + table[lower, right] * u
    return above * (1 - v) + below * v


def find_orientation(table: np.ndarray, normal: np.ndarray, pixels: np.ndarray) -> Orientation:
    """The orientation that makes the irradiance in ``table`` most like ``pixels`` (P, 3), up to a factor."""
    few = slice(None, None, max(1, len(normal) // 200))
    normal, pixels = normal[few], pixels[few]
    size = float((pixels**2).sum())

    def unlike(orientation: Orientation) -> float:
        seen = _looked_up(table, normal @ orientation.matrix.T)
        return size - float((seen * pixels).sum() ** 2 / max((seen**2).sum(), 1e-300))

    best = min((Orientation(turn, yaw) for turn in TURNS for yaw in range(0, 360, 10)), key=unlike)
    finer = [Orientation(best.turn, (best.yaw + step / 2) % 360) for step in range(-20, 21)]
    best = min([best, *finer], key=unlike)
    # Quarter turns are the likeliest. If one can be described in several ways, prefer the one with the least yaw.
    quarters = [Orientation(turn, yaw) for yaw in (0, 90, 180, 270) for turn in TURNS]
    return next((near for near in quarters if np.abs(near.matrix - best.matrix).max() < math.radians(3)), best)
