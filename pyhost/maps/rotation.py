"""Rotations of the world by yaw, pitch and roll, and when a latitude-longitude map follows by whole columns.

Angles are in degrees and follow the right-hand rule: seen from the tip of the axis, a positive angle turns
counter-clockwise. Roll about +z comes first, then pitch about +x, then yaw about +y; all three axes are fixed in the
world. Equivalently, yaw, pitch and roll follow each other in that order about axes that turn along.
"""

from __future__ import annotations

import math

import numpy as np

from .. import checks

COLUMN = 1e-6  # tolerance for a yaw by whole columns, in columns, because 360 / W is rounded


def rotation_matrix(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """R_y(yaw) R_x(pitch) R_z(roll), (3, 3) float64: light from the direction d comes from R d afterwards.

    Whole quarter turns are exact. To rotate directions (N, 3), write ``directions @ rotation_matrix(...).T``. Raises
    :class:`LightdomeError` for an angle that is not finite.
    """
    angles = {"yaw": yaw, "pitch": pitch, "roll": roll}
    (cy, sy), (cx, sx), (cz, sz) = (_cosine_sine(name, value) for name, value in angles.items())
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_y @ about_x @ about_z + 0.0  # no -0


def whole_columns(width: int, matrix: np.ndarray) -> int | None:
    """The columns, 0 to ``width`` - 1, by which a rotation moves a map to the right; None for any other rotation.

    Azimuth runs from +x to +z, a positive yaw from +z to +x, so a yaw of 360 / ``width`` moves the map one column left.
    """
    if matrix[1, 1] != 1:
        return None
    columns = -math.atan2(matrix[0, 2], matrix[0, 0]) / (2 * math.pi) * width
    whole = round(columns)
    return whole % width if abs(columns - whole) <= COLUMN else None


def _cosine_sine(name: str, degrees: object) -> tuple[float, float]:
    rest = math.remainder(checks.real(name, degrees, "a finite angle in degrees", -math.inf), 360)
    if rest % 90 == 0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(rest // 90) % 4]
    return math.cos(math.radians(rest)), math.sin(math.radians(rest))
