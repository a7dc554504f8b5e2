"""A set of directional lights, and files of them for other programs: PBRT and anything that reads a CSV.

Lights come from samples (:meth:`Lights.of`) or from :func:`lightdome.lighting.median_cut.median_cut`;
:func:`lightdome.lighting.shade.shade` renders with them. Directions are those of the project: +y is up,
(sin theta cos phi, cos theta, sin theta sin phi) for the map's angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import checks
from ..errors import LightdomeError
from ..files import replacing
from ..maps.rotation import rotation_matrix
from ..sampling.samples import Samples

CSV_HEADER = "x,y,z,red,green,blue"


@dataclass(frozen=True)
class Lights:
    """N directional lights.

    - ``direction``: (N, 3) float32, unit vectors towards the lights
    - ``flux``: (N, 3) float64, RGB, what each light stands for: radiance x steradian

    A surface with normal n receives the irradiance sum of flux max(0, n . direction). The arrays are read-only.
    ``Lights(direction, flux)`` copies them and raises :class:`LightdomeError` for directions that are no unit
    vectors, and for fluxes that are negative or not finite.
    """

    direction: np.ndarray
    flux: np.ndarray

    def __post_init__(self) -> None:
        direction, flux = checks.lights(self.direction, self.flux, own=True)
        object.__setattr__(self, "direction", direction)
        object.__setattr__(self, "flux", flux)

    def __len__(self) -> int:
        return len(self.direction)

    @classmethod
    def of(cls, samples: Samples) -> Lights:
        """The lights that a set of samples is."""
        checks.instance("samples", samples, Samples)
        return checks.made(cls, direction=samples.direction, flux=samples.flux)

    def rotated(self, yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Lights:
        """The lights after the world turned, as :meth:`lightdome.EnvironmentMap.rotated` has it; fluxes stay.

        For samples, rotate ``Lights.of(samples)``: their pixels are those of the map that they came from. Raises
        :class:`LightdomeError` for an angle that is not finite.
        """
        direction = self.direction @ rotation_matrix(yaw, pitch, roll).T
        return checks.made(Lights, direction=direction.astype(np.float32), flux=self.flux)


def write_csv(path: str | Path, lights: Lights) -> None:
    """Write one light a line as ``x,y,z,red,green,blue`` under a line of these names.

    x, y, z is the unit vector towards the light, red, green, blue its flux (radiance x steradian), each
    to the precision of a float32. Raises :class:`LightdomeError` if the file cannot be written.
    """
    path = checks.path(path)
    checks.instance("the lights", lights, Lights)
    rows = (",".join(f"{v:.9g}" for v in row) for row in _rows(lights))
    with replacing(path) as temporary:
        temporary.write_text("\n".join([CSV_HEADER, *rows]) + "\n", encoding="ascii")


def write_pbrt(path: str | Path, lights: Lights) -> None:
    """Write the lights as ``distant`` lights, a file that scenes of PBRT-v3 and PBRT-v4 include alike.

    ``Include "lights.pbrt"`` in the world block, outside any transformation if +y is up there. ``L``
    is the irradiance of a surface that faces the light, so it is the light's flux: both versions define it
    so, and version 4 sees the three numbers as an RGB in the scene's colour space. A light without flux is
    left out. Raises :class:`LightdomeError` if a flux is beyond float32 or the file cannot be written.

    Source: the file formats at https://pbrt.org/fileformat-v3 and https://pbrt.org/fileformat-v4.
    """
    path = checks.path(path)
    checks.instance("the lights", lights, Lights)
    if not (lights.flux <= np.finfo(np.float32).max).all():
        raise LightdomeError(
            "a light is stronger than the 3.4e38 that PBRT can hold; scale the map down and the image up"
        )
    lines = [
        "# lightdome: directional lights for PBRT-v3 and PBRT-v4; +y is up.",
        "# L is the irradiance of a surface that faces the light.",
    ]
    for row in _rows(lights):
        if row[3:].any():
            x, y, z, red, green, blue = (f"{v:.9g}" for v in row)
            lines.append(
                f'LightSource "distant" "point3 from" [{x} {y} {z}] "point3 to" [0 0 0] "rgb L" [{red} {green} {blue}]'
            )
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="ascii")


def _rows(lights: Lights) -> np.ndarray:
    # -0 is no direction that anyone wants to read.
    return np.concatenate([lights.direction.astype(np.float64), lights.flux], axis=1) + 0.0
