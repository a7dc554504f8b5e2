"""A set of directional lights.

Lights come from samples (:meth:`Lights.of`) or from :func:`lightdome.lighting.median_cut.median_cut`;
:func:`lightdome.lighting.shade.shade` renders with them, and :mod:`lightdome.lighting.light_files` writes them for
other programs. +y is up: a direction is (sin theta cos phi, cos theta, sin theta sin phi) of the map's angles.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import overload

import numpy as np

from .. import checks
from ..maps.pictures import show_directions
from ..maps.rotation import rotation_matrix
from ..sampling.samples import Samples


@dataclass(frozen=True, eq=False)
class Light:
    """One of :class:`Lights`: its ``direction`` and its ``flux``, both (3,)."""

    direction: np.ndarray
    flux: np.ndarray


@dataclass(frozen=True, eq=False)
class Lights:
    """N directional lights.

    - ``direction``: (N, 3) float32, unit vectors towards the lights
    - ``flux``: (N, 3) float64, RGB, in radiance x steradian

    A surface with normal n receives the irradiance sum of flux max(0, n . direction). The arrays are read-only.
    ``Lights(direction, flux)`` copies them and raises :class:`LightdomeError` for directions that are not unit
    vectors, and for fluxes that are negative or not finite.

    ``lights[3]`` is a :class:`Light`, and iteration yields them. ``lights[:5]``, or an array of indices or of booleans,
    gives Lights whose fluxes stay as they are. Lights are equal if all of their content is; they cannot be hashed.
    """

    direction: np.ndarray
    flux: np.ndarray

    def __post_init__(self) -> None:
        direction, flux = checks.lights(self.direction, self.flux, own=True)
        object.__setattr__(self, "direction", direction)
        object.__setattr__(self, "flux", flux)

    def __len__(self) -> int:
        return len(self.direction)

    @overload
    def __getitem__(self, index: int) -> Light: ...
    @overload
    def __getitem__(self, index: slice | np.ndarray) -> Lights: ...
    def __getitem__(self, index: int | slice | np.ndarray) -> Light | Lights:
        direction, flux = self.direction[index], self.flux[index]
        if not isinstance(index, slice | np.ndarray):
            return Light(direction, flux)
        return checks.made(Lights, direction=np.ascontiguousarray(direction), flux=np.ascontiguousarray(flux))

    def __iter__(self) -> Iterator[Light]:
        return map(Light, self.direction, self.flux)

    def __eq__(self, other: object) -> bool:
        return checks.same(self, other)

    def __repr__(self) -> str:
        flux = " ".join(f"{value:.4g}" for value in self.flux.sum(axis=0))
        return f"<Lights: {len(self)}, flux {flux} in all>"

    def _repr_png_(self) -> bytes:
        return show_directions(self.direction, self.flux)._repr_png_()

    @classmethod
    def of(cls, samples: Samples) -> Lights:
        """A set of samples as lights."""
        checks.instance("samples", samples, Samples)
        return checks.made(cls, direction=samples.direction, flux=samples.flux)

    def rotated(self, yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Lights:
        """The lights, turned as :meth:`lightdome.EnvironmentMap.rotated` turns a map; their fluxes do not change.

        For samples, rotate ``Lights.of(samples)``: their pixels are those of the map that they came from. Raises
        :class:`LightdomeError` for an angle that is not finite.
        """
        direction = self.direction @ rotation_matrix(yaw, pitch, roll).T
        return checks.made(Lights, direction=direction.astype(np.float32), flux=self.flux)
