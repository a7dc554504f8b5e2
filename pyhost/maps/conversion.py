"""Convert a map from one projection to another, by name, and detect the projection of a file.

What the file says comes first (``envmap = cube`` in OpenEXR), then the ratio of its sides. Where that is ambiguous, it
matters whether the pixels that a projection does not use are black; :func:`detected` lists the cases.
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

SMALLEST = 4  # the size from which the ratio of the sides is meaningful
SQUARES = "a light probe is angular or mirror; a square made by PBRT-v4 is octahedral"
OVERRIDE = "use --projection NAME to override"


def convert(
    radiance: np.ndarray | EnvironmentMap,
    from_: str = "latlong",
    to: str = "latlong",
    size: int | None = None,
    rotation: np.ndarray | None = None,
) -> np.ndarray:
    """The map ``radiance``, (H, W, 3) in the projection ``from_``, resampled to the projection ``to``, as float32.

    Projections are the names in :data:`lightdome.maps.projections.PROJECTIONS`, which defines the layout of each.
    ``size`` is the side of a square or of a cube's face, or the number of rows of a latitude-longitude map; by default
    the result has about as many pixels as ``radiance``. ``rotation`` (3, 3) takes directions of the map to directions
    of the result. Radiance keeps its unit; the flux, the sum of radiance times solid angle, is kept to within 1e-6
    (:mod:`lightdome.maps.resample`).

    Raises :class:`LightdomeError` for an unknown name, an image whose sides do not fit its projection, an invalid size,
    and values that are not finite.
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
    """The shape (H, W) of even size in ``target`` with about as many pixels as ``source`` uses."""
    width, height = source.aspect
    pixels = source.coverage * shape[0] * shape[1] / (width * height)
    return target.shape(max(2, 2 * math.ceil(math.sqrt(pixels / target.coverage) / 2)))


def detected(radiance: np.ndarray, is_cube: bool = False) -> tuple[str, str | None]:
    """The projection of an image (H, W, 3), by name, and a remark for the user, which is None for the common 2:1.

    ``is_cube`` means that the file says that it is a cube map. Otherwise, 1:6 and 6:1 are strips; 3:4 and 4:3 with
    black corners are crosses; 1:1 with black corners is an angular map; and everything else is latitude-longitude, with
    a remark if the sides would fit one of these.
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
    """Whether the pixels that a projection does not use are black, and some of the others are not."""
    used = PROJECTIONS[name].used(radiance.shape[:2])
    grown = used.copy()  # a resized image may have a grey rim
    for axis in (0, 1):
        for step in (-1, 1):
            grown |= np.roll(used, step, axis)
    return not radiance[~grown].any() and bool(radiance[used].any())


def check_fits(name: str, shape: tuple[int, int], what: str) -> Projection:
    """The projection ``name``. Raises :class:`LightdomeError` if an image of ``shape`` cannot have it."""
    projection = PROJECTIONS[checks.choice("projection", name, PROJECTIONS)]
    if not projection.fits(shape):
        raise LightdomeError(
            f"{what}: expected the sides of a {name} map, {_ratio(name)}, got {shape[1]} x {shape[0]} pixels"
        )
    return projection
