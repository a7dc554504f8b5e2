"""The sun of a map: one small source, much brighter than its surroundings, with a good share of the light.

Candidates come from the light summed over cells (:class:`Cells`). Each is then examined pixel by pixel, using only
angles from its centre, so that the map's seam and poles need no special treatment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .geometry import directions, row_angles

PATCH = np.radians(8.0)  # radius around a candidate that is examined pixel by pixel
SURROUNDINGS = np.radians(5.0)  # a candidate's background is between this angle and PATCH
MAX_RADIUS = np.radians(5.0)
MIN_CONTRAST = 3.0  # ratio of peak to background
MIN_DEPTH = 0.02  # share of the peak's height above the background; dimmer pixels are not part of the source
MIN_COMPACTNESS = 0.8  # share of the patch's bright light that the source must hold
MIN_SHARE = 0.05  # least share of the map's flux
MAX_RIVAL = 0.5  # largest ratio of the next source's light to the sun's
NOTHING = "nothing small stands out from its surroundings"
CELL_ROWS = 64
GROUP = np.radians(4.0)  # radius within which cells are taken together
BRIGHTEST_CELLS = 64  # brightest cells that are examined


@dataclass(frozen=True)
class Sun:
    """A small source, above its surroundings.

    - ``direction_xyz``: unit vector towards its centre of light; +y is up
    - ``azimuth_degrees``: from +x towards +z, 0 to 360, the way the map's columns run
    - ``elevation_degrees``: from the horizon; 90 is straight up
    - ``angular_radius_degrees``: of the uniform disc with the same sum of L and the same sum of L^2
    - ``flux_rgb_radiance_sr``: the sum of L x solid angle, the strength of a directional light in its place
    - ``irradiance_rgb_radiance_sr``: on a surface that faces it; less than the flux by the cosines over its disc
    - ``flux_share``: its share of the map's flux, 0 to 1
    - ``is_clipped``: whether it holds clipped pixels, so that all its light is a lower bound
    """

    direction_xyz: tuple[float, float, float]
    azimuth_degrees: float
    elevation_degrees: float
    angular_radius_degrees: float
    flux_rgb_radiance_sr: tuple[float, float, float]
    irradiance_rgb_radiance_sr: tuple[float, float, float]
    flux_share: float
    is_clipped: bool


@dataclass(frozen=True)
class Region:
    """The pixels of the sun: those of at least ``threshold`` luminance within ``reach`` radians of ``centre``.

    ``surroundings`` is the RGB radiance next to them, exact in float32: what would be visible without the sun.
    """

    centre: np.ndarray
    reach: float
    threshold: float
    surroundings: np.ndarray

    def holds(self, direction: np.ndarray, luminance: np.ndarray) -> np.ndarray:
        """Which pixels it holds, given their directions (..., 3) and luminances."""
        return (luminance >= self.threshold) & (distance(direction, self.centre) <= self.reach)


@dataclass(frozen=True)
class Patch:
    """Pixels around a candidate: ``direction`` (N, 3), ``radiance`` (N, 3), ``solid_angle`` (N,), all float64."""

    direction: np.ndarray
    radiance: np.ndarray
    solid_angle: np.ndarray

    @property
    def luminance(self) -> np.ndarray:
        """(N,)."""
        return luminance(self.radiance)


def luminance(radiance: np.ndarray) -> np.ndarray:
    """I = (R + G + B) / 3 of float64 radiance (..., 3)."""
    return (radiance[..., 0] + radiance[..., 1] + radiance[..., 2]) / 3


def distance(direction: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Angles between unit vectors (..., 3) and a unit vector, radians; exact for small angles too."""
    return 2 * np.arcsin(np.minimum(np.sqrt(((direction - centre) ** 2).sum(axis=-1)) / 2, 1))


def azimuth_elevation(vector: np.ndarray) -> tuple[float, float]:
    """(azimuth, elevation) in degrees: from +x towards +z, 0 to 360; from the horizon, -90 to 90."""
    x, y, z = vector
    return float(np.degrees(np.arctan2(z, x)) % 360), float(np.degrees(np.arctan2(y, np.hypot(x, z))))


class Cells:
    """Sums over cells of about 2.8 degrees, with nearly the same solid angle everywhere.

    - ``flux`` (N, 3): sum of L x solid angle
    - ``second`` (N, 3): sum of L^2 / I x solid angle, needed for the variance of samples
    - ``vector`` (N, 3): sum of I x solid angle x direction
    - ``solid_angle`` (N,): sum of solid angles
    """

    def __init__(self) -> None:
        theta = row_angles(CELL_ROWS)
        self._columns = np.rint(2 * CELL_ROWS * np.sin(theta)).astype(int)
        self._first = np.concatenate([[0], np.cumsum(self._columns)])
        phi = np.concatenate([2 * np.pi * (np.arange(n) + 0.5) / n for n in self._columns])
        self._centre = directions(np.repeat(theta, self._columns), phi)
        self.flux, self.second, self.vector = (np.zeros((len(phi), 3)) for _ in range(3))
        self.solid_angle = np.zeros(len(phi))

    def add(
        self,
        row: int,
        solid_angle: np.ndarray,
        theta: np.ndarray,
        phi: np.ndarray,
        radiance: np.ndarray,
        intensity: np.ndarray,
    ) -> None:
        """Add pixels that lie in one row of cells: radiance (n, W, 3), luminance (n, W), both float64."""
        column = np.arange(len(phi)) * self._columns[row] // len(phi)
        cells = slice(self._first[row], self._first[row + 1])

        def add(sums: np.ndarray, of_columns: np.ndarray) -> None:
            sums[cells] += np.bincount(column, of_columns, self._columns[row])

        per_intensity = solid_angle[:, None] / np.where(intensity > 0, intensity, 1)
        for c in range(3):
            channel = radiance[..., c]
            add(self.flux[:, c], solid_angle @ channel)
            add(self.second[:, c], np.einsum("nw,nw,nw->w", per_intensity, channel, channel))
        across = (solid_angle * np.sin(theta)) @ intensity
        add(self.vector[:, 0], across * np.cos(phi))
        add(self.vector[:, 1], (solid_angle * np.cos(theta)) @ intensity)
        add(self.vector[:, 2], across * np.sin(phi))
        add(self.solid_angle, np.full(len(phi), solid_angle.sum()))

    @property
    def direction(self) -> np.ndarray:
        """Unit vectors (N, 3) to the centre of light of each cell, or to the cell's centre if it has no light."""
        length = np.linalg.norm(self.vector, axis=1, keepdims=True)
        return np.where(length > 0, self.vector / np.where(length > 0, length, 1), self._centre)

    def brightest(self) -> np.ndarray:
        """A unit vector towards the centre of the 8-degree disc with the most light."""
        direction, light = self.direction, luminance(self.flux)
        top = np.argsort(light)[-BRIGHTEST_CELLS:]
        near = direction[top] @ direction.T >= np.cos(GROUP)
        vector = self.vector[near[np.argmax(near @ light)]].sum(axis=0)
        return vector / np.linalg.norm(vector)

    def rival(self, sun: np.ndarray) -> float:
        """The most luminance x solid angle that any other 8-degree disc has above its surroundings."""
        direction, light = self.direction, luminance(self.flux)
        away = distance(direction, sun) > PATCH + GROUP
        top = np.argsort(np.where(away, light, 0))[-BRIGHTEST_CELLS:]
        cosine = direction[top] @ direction.T
        near = cosine >= np.cos(GROUP)
        around = (cosine >= np.cos(3 * GROUP)) & ~near & away
        around_solid_angle = around @ self.solid_angle
        surroundings = (around @ light) / np.where(around_solid_angle > 0, around_solid_angle, 1)
        return float((near @ light - surroundings * (near @ self.solid_angle)).max())


def find_region(patch: Patch, start: np.ndarray, pixel: float) -> Region | str:
    """The source around ``start``, or why there is none; ``pixel`` is the largest angle that a pixel spans."""
    direction, intensity, solid_angle = patch.direction, patch.luminance, patch.solid_angle
    outside = distance(direction, start) > SURROUNDINGS
    if not outside.any():
        return "the pixels are too large to show a sun"
    background = _median(intensity[outside], solid_angle[outside])
    inside = np.flatnonzero(~outside)
    peak = inside[np.argmax(intensity[inside])] if inside.size else int(np.argmax(intensity))
    height = intensity[peak] - background
    if intensity[peak] < MIN_CONTRAST * background or height <= 0:
        return NOTHING
    threshold = background + max(MIN_DEPTH * height, background)
    bright = intensity >= threshold
    light = np.where(bright, (intensity - background) * solid_angle, 0)

    centre = direction[peak]
    for _ in range(10):
        apart = distance(direction, centre)
        reach = _reach(apart, bright, solid_angle, pixel)
        held = light * (apart <= reach)
        moved = held @ direction
        moved /= np.linalg.norm(moved)
        if distance(moved, centre) < 1e-9:
            break
        centre = moved
    if held.sum() < MIN_COMPACTNESS * light.sum():
        return "the brightest source is not compact"
    ring = (apart > reach) & (apart <= 1.5 * reach + 2 * pixel) & ~bright
    if not ring.any():
        ring = outside
    surroundings = (solid_angle[ring] @ patch.radiance[ring] / solid_angle[ring].sum()).astype(np.float32)
    surroundings = surroundings.astype(np.float64)
    reach = min(reach, PATCH - float(distance(centre, start)))  # pixels beyond PATCH have not been examined
    # Pixels that the source covers only in part belong to it too.
    return Region(centre, reach, max(2 * float(luminance(surroundings)), math.ulp(0.0)), surroundings)


def _reach(apart: np.ndarray, bright: np.ndarray, solid_angle: np.ndarray, pixel: float) -> float:
    """The source's radius: a pixel beyond the first ring, one pixel wide, that is less than a quarter bright."""
    ring = np.rint(apart / pixel).astype(int)
    lit, whole = np.bincount(ring, solid_angle * bright), np.bincount(ring, solid_angle)
    dark = (whole > 0) & (lit < 0.25 * whole)
    return ((int(np.argmax(dark)) if dark.any() else len(dark)) + 1.5) * pixel


def _median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, total[-1] / 2)]])


def measure(patch: Patch, region: Region, total: float, is_clipped: bool) -> Sun | str:
    """The sun in a region, in a map of the flux ``total``, or why the region is not a sun."""
    held = region.holds(patch.direction, patch.luminance)
    radiance = np.maximum(patch.radiance[held] - region.surroundings, 0)
    solid_angle, direction = patch.solid_angle[held], patch.direction[held]
    intensity = luminance(radiance)
    light = intensity * solid_angle
    if not light.any():
        return NOTHING
    flux = solid_angle @ radiance
    vector = light @ direction
    vector /= np.linalg.norm(vector)
    even = light.sum() ** 2 / (light @ intensity)  # the solid angle of the equivalent uniform disc
    radius = float(np.arccos(max(-1.0, 1 - even / (2 * np.pi))))
    if radius > MAX_RADIUS:
        return "the brightest source is more than 10 degrees wide"
    share = float(light.sum() / total)
    if share < MIN_SHARE and not is_clipped:
        return f"the brightest small source has {100 * share:.2g} % of the light"
    azimuth, elevation = azimuth_elevation(vector)
    return Sun(
        direction_xyz=tuple(vector.tolist()),
        azimuth_degrees=azimuth,
        elevation_degrees=elevation,
        angular_radius_degrees=float(np.degrees(radius)),
        flux_rgb_radiance_sr=tuple(flux.tolist()),
        irradiance_rgb_radiance_sr=tuple(((solid_angle * (direction @ vector)) @ radiance).tolist()),
        flux_share=share,
        is_clipped=is_clipped,
    )
