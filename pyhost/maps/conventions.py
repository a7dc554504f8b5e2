"""How programs lay a latitude-longitude map around the world: which axis is up, and where each column looks.

In every convention, row 0 looks up, and columns run to the right for someone inside the sphere who turns to the right.
Conventions differ in the names of the axes and in where the first column looks. A place in a map is (u, v): u runs from
0 at the left edge to 1 at the right edge, v from 0 at the top to 1 at the bottom. The centre of pixel (x, y) is at
((x + 1/2) / W, (y + 1/2) / H). Below are each convention's axes, its u, and where columns 0, W/4, W/2 and 3W/4 look:

- ``lightdome``: right-handed, +y up, u = atan2(z, x) / 2 pi; +x, +z, -x, -z
- ``pbrt``: left-handed, +z up, u = atan2(y, x) / 2 pi; +x, +y, -x, -y
- ``mitsuba``: right-handed, +y up, u = atan2(x, -z) / 2 pi; -z, +x, +z, -x
- ``cycles``: right-handed, +z up, u = 1/2 - atan2(y, x) / 2 pi; -x, +y, +x, -y
- ``gltf``: right-handed, +y up, u = 1/2 + atan2(z, x) / 2 pi; -x, -z, +x, +z
- ``skylibs``: right-handed, +y up, u = 1/2 + atan2(x, -z) / 2 pi; +z, -x, -z, +x

Lightdome's (x, y, z) is (x, z, y) in PBRT, (x, -z, y) in Blender, and (x, y, z) in the others; see :func:`to_axes`. Up
stays up, and what the program's camera shows is not mirrored. So a map goes from one convention to another by a yaw of
whole quarter turns.

PBRT's axes are left-handed. If a scene makes them right-handed with ``Scale -1 1 1`` before its camera, and does not
undo that for its light, the map comes out mirrored; :meth:`lightdome.EnvironmentMap.mirrored` compensates.

Sources are in :data:`PRESETS`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import checks
from ..errors import LightdomeError
from ..names import CONVENTIONS
from .geometry import directions


@dataclass(frozen=True)
class Convention:
    """A program's convention for maps.

    - ``axes``: the program's x, y and z in lightdome's axes, as the rows of a signed permutation
    - ``quarters``: how many quarters of its width lightdome's map moves to the right in the program's file
    - ``source``: where the program's code or documentation defines it
    """

    axes: tuple[tuple[int, int, int], ...]
    quarters: int
    source: str


X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
PRESETS = {
    "lightdome": Convention((X, Y, Z), 0, "lightdome.maps.geometry"),
    "pbrt": Convention(
        (X, Z, Y),
        0,
        "PBRT-v3, InfiniteAreaLight::Le: https://github.com/mmp/pbrt-v3/blob/master/src/lights/infinite.cpp",
    ),
    "mitsuba": Convention(
        (X, Y, Z),
        1,
        "Mitsuba 3, EnvironmentMapEmitter::eval:"
        " https://github.com/mitsuba-renderer/mitsuba3/blob/master/src/emitters/envmap.cpp",
    ),
    "cycles": Convention(
        (X, (0, 0, -1), Y),
        2,
        "Cycles, direction_to_equirectangular:"
        " https://projects.blender.org/blender/cycles/src/branch/main/src/kernel/camera/projection.h",
    ),
    "gltf": Convention(
        (X, Y, Z),
        2,
        "three.js, equirectUv:"
        " https://github.com/mrdoob/three.js/blob/dev/src/renderers/shaders/ShaderChunk/common.glsl.js",
    ),
    "skylibs": Convention(
        (X, Y, Z),
        3,
        "skylibs, world2latlong: https://github.com/soravux/skylibs/blob/master/envmap/projections.py",
    ),
}


def preset(name: object) -> Convention:
    """The convention with this name. Raises :class:`LightdomeError` for an unknown name."""
    return PRESETS[checks.choice("convention", name, CONVENTIONS)]


def yaw_between(from_: object, to: object) -> float:
    """The yaw in degrees that takes a map from one convention to another, both given by name."""
    return -90.0 * ((preset(to).quarters - preset(from_).quarters) % 4)


def to_axes(direction: np.ndarray, name: str, from_: str = "lightdome") -> np.ndarray:
    """Directions (..., 3) in the axes of the convention ``name``, from the axes of ``from_``.

    The result is exact, and floats keep their type. Raises :class:`LightdomeError` for an unknown convention, and for
    another shape.
    """
    matrix = np.array(preset(name).axes) @ np.transpose(preset(from_).axes)
    direction = checks.array("direction", direction)
    if direction.shape[-1:] != (3,):
        raise LightdomeError(f"direction must be an array of shape (..., 3), got shape {direction.shape}")
    if direction.dtype.kind != "f":
        direction = direction.astype(np.float64)
    source = np.abs(matrix).argmax(axis=1)
    return direction[..., source] * matrix[np.arange(3), source].astype(direction.dtype)


def to_uv(direction: np.ndarray, name: str = "lightdome") -> np.ndarray:
    """The places (u, v), (..., 2) float64, of directions (..., 3) in a map of the convention ``name``.

    Directions are in the axes of that convention, and their length does not matter. u is in [0, 1), v in [0, 1]. Raises
    :class:`LightdomeError` for an unknown convention.
    """
    x, y, z = np.moveaxis(to_axes(direction, "lightdome", name).astype(np.float64), -1, 0)
    u = np.arctan2(z, x) / (2 * np.pi) + preset(name).quarters / 4
    u = u - np.floor(u)
    u = np.where(u >= 1, 0, u)  # a u just below 0 rounds to 1; NaN stays
    return np.stack([u, np.arctan2(np.hypot(x, z), y) / np.pi], axis=-1)


def from_uv(u: np.ndarray, v: np.ndarray, name: str = "lightdome") -> np.ndarray:
    """The unit vectors (..., 3) float64, in the axes of ``name``, at places (u, v) in its map, which are broadcast.

    Raises :class:`LightdomeError` for an unknown convention.
    """
    u, v = checks.array("u", u, dtype=np.float64), checks.array("v", v, dtype=np.float64)
    phi = 2 * np.pi * (u - preset(name).quarters / 4)
    return to_axes(directions(np.pi * v, phi), name)
