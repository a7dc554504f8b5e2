"""From one projection to another, by name, and which one a file is in.

What a file says comes first (``envmap = cube`` in OpenEXR), then the ratio of its sides, and where that leaves a doubt,
whether the pixels that a projection does not use are black. :func:`detected` has the table.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .. import checks
from ..errors import LightdomeError
from .projections import PROJECTIONS, Projection
from .resample import resample

if TYPE_CHECKING:
    from .envmap import EnvironmentMap

SMALLEST = 4  # the size from which the ratio of the sides says something
SQUARES = "a light probe is angular or mirror, a square that PBRT-v4 made octahedral"
OVERRIDE = "--projection NAME says otherwise"


def convert(
    radiance: np.ndarray | EnvironmentMap,
    from_: str = "latlong",
    to: str = "latlong",
    size: int | None = None,
    rotation: np.ndarray | None = None,
) -> np.ndarray:
    """The map ``radiance``, (H, W, 3) in the projection ``from_``, in the projection ``to``: (H', W', 3) float32.

    Projections are the names in :data:`lightdome.maps.projections.PROJECTIONS`, which says how each one lies. ``size``
    is the side of a square or of a cube's face, or the rows of a latitude-longitude map; by default there are about as
    many pixels as before. ``rotation`` (3, 3) leads from directions of the map to those of the result. Radiance keeps
    its unit; the flux, the sum of radiance times solid angle, is kept to 1e-6 (:mod:`lightdome.maps.resample`).

    Raises :class:`LightdomeError` for an unknown name, an image whose sides do not fit its projection, a size that is
    none, and values that are not finite.
    """
    source, target = (PROJECTIONS[checks.choice("projection", name, PROJECTIONS)] for name in (from_, to))
    values = radiance if isinstance(radiance, np.ndarray) else getattr(radiance, "radiance", radiance)
    values = checks.array("radiance", values, ("H", "W", 3))
    if size is not None:
        shape = target.shape(size)
    elif source is target:
        shape = values.shape[:2]
    else:
        shape = alike(source, values.shape[:2], target)
    return resample(values, source, target, shape, rotation)


def alike(source: Projection, shape: tuple[int, int], target: Projection) -> tuple[int, int]:
    """The shape (H, W) of ``target`` with about as many pixels as ``source`` has, of even size."""
    width, height = source.aspect
    pixels = source.coverage * shape[0] * shape[1] / (width * height)
    return target.shape(max(2, 2 * math.ceil(math.sqrt(pixels / target.coverage) / 2)))


def detected(radiance: np.ndarray, is_cube: bool = False) -> tuple[str, str | None]:
    """The projection of an image (H, W, 3), by name, and a remark for the user, None for the common 2:1.

    ``is_cube``: the file says that it is a cube map. Else: 1:6 and 6:1 are strips; 3:4 and 4:3 with black corners are
    crosses; 1:1 with black corners is an angular map; all else is latitude-longitude, with a remark where the sides
    would fit one of these.
    """
    if is_cube:
        return "cube-openexr", _remark("cube-openexr", "its header says envmap = cube")
    shape = radiance.shape[:2]
    for name in ("cube-strip", "cube-strip-horizontal"):
        if PROJECTIONS[name].fits(shape) and min(shape) >= SMALLEST:
            return name, _remark(name, f"its sides are {_ratio(name)}")
    for name in ("cube-cross", "cube-cross-horizontal", "angular"):
        if not (PROJECTIONS[name].fits(shape) and shape[0] >= 2 * SMALLEST):
            continue
        if _is_black_outside(radiance, name):
            or_else = " (or mirror)" if name == "angular" else ""
            return name, _remark(name + or_else, f"its sides are {_ratio(name)} and its corners black")
        if radiance.any():
            others = SQUARES if name == "angular" else f"a cross with these sides is {name}"
            why = f"its sides are {_ratio(name)} but its corners are not black"
            return "latlong", f"{_remark('latlong', why)}; {others}"
    return "latlong", None


def _remark(name: str, why: str) -> str:
    return f"note: the map is taken as {name}, since {why}; {OVERRIDE}"


def _ratio(name: str) -> str:
    return ":".join(map(str, PROJECTIONS[name].aspect))


def _is_black_outside(radiance: np.ndarray, name: str) -> bool:
    """Whether the pixels that a projection does not use are black, and others are not."""
    used = PROJECTIONS[name].used(radiance.shape[:2])
    grown = used.copy()  # what was resized may have a grey rim
    for axis in (0, 1):
        for step in (-1, 1):
            grown |= np.roll(used, step, axis)
    return not radiance[~grown].any() and bool(radiance[used].any())


def check_fits(name: str, shape: tuple[int, int], what: str) -> Projection:
    """The projection of this ``name``. Raises :class:`LightdomeError` where an image of ``shape`` cannot have it."""
    projection = PROJECTIONS[checks.choice("projection", name, PROJECTIONS)]
    if not projection.fits(shape):
        raise LightdomeError(
            f"{what}: {shape[1]} x {shape[0]} pixels are no {name} map, whose sides are {_ratio(name)}"
        )
    return projection
