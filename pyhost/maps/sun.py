"""The sun of a map: one small source, much brighter than its surroundings, with a good share of the light.

Candidates come from light summed over cells (:class:`Cells`); one is then looked at pixel by pixel, by angles from its
centre alone, so that the map's seam and its poles are places like any other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .geometry import directions, row_angles

PATCH = np.radians(8.0)  # round a candidate: what is looked at pixel by pixel
SURROUNDINGS = np.radians(5.0)  # from a candidate to the edge of the patch: its background
MAX_RADIUS = np.radians(5.0)
MIN_CONTRAST = 3.0  # peak to background
MIN_DEPTH = 0.02  # of the peak above the background: less is no part of the source
MIN_COMPACTNESS = 0.8  # of the bright light in the patch
MIN_SHARE = 0.05  # of the map's flux
MAX_RIVAL = 0.5  # light of the next source to that of the sun
NOTHING = "nothing small stands out from its surroundings"
CELL_ROWS = 64
GROUP = np.radians(4.0)  # cells that are taken together
BRIGHTEST_CELLS = 64  # that are looked at


@dataclass(frozen=True)
class Sun:
    """A small source, above what surrounds it.

    - ``direction_xyz``: unit vector towards its centre of light; +y is up
    - ``azimuth_degrees``: from +x towards +z, 0 to 360, as columns of the map run
    - ``elevation_degrees``: from the horizon, 90 is straight up
    - ``angular_radius_degrees``: of the even disc with the same sum of L and the same sum of L^2
    - ``flux_rgb_radiance_sr``: the sum of L x solid angle: what a directional light in its place has
    - ``irradiance_rgb_radiance_sr``: of a surface that faces it; less than the flux by the cosines over its disc
    - ``flux_share``: of the map's flux, 0 to 1
    - ``is_clipped``: it holds pixels that are cut off, so that all its light is a lower bound
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
    """Which pixels are the sun: those of at least ``threshold`` luminance within ``reach`` radians of ``centre``.

    ``surroundings`` is the radiance next to them, RGB, representable in float32: what would be seen without the sun.
    """

    centre: np.ndarray
    reach: float
    threshold: float
    surroundings: np.ndarray

    def holds(self, direction: np.ndarray, luminance: np.ndarray) -> np.ndarray:
        """Which of the pixels with these directions, (..., 3), and luminances it holds."""
        return (luminance >= self.threshold) & (distance(direction, self.centre) <= self.reach)


@dataclass(frozen=True)
class Patch:
    """Pixels round a candidate: ``direction`` (N, 3), ``radiance`` (N, 3), ``solid_angle`` (N,), all float64."""

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
    """Angles between unit vectors (..., 3) and one, radians; exact for small ones too."""
    return 2 * np.arcsin(np.minimum(np.sqrt(((direction - centre) ** 2).sum(axis=-1)) / 2, 1))


def azimuth_elevation(vector: np.ndarray) -> tuple[float, float]:
    """Degrees: from +x towards +z, 0 to 360, and from the horizon, -90 to 90."""
    x, y, z = vector
    return float(np.degrees(np.arctan2(z, x)) % 360), float(np.degrees(np.arctan2(y, np.hypot(x, z))))


class Cells:
    """Sums over cells of about 2.8 degrees, of nearly the same solid angle everywhere.

    - ``flux`` (N, 3): of L x solid angle
    - ``second`` (N, 3): of L^2 / I x solid angle, which the variance of samples needs
    - ``vector`` (N, 3): of I x solid angle x direction
    - ``solid_angle`` (N,)
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
        """(N, 3), unit vectors: of the light in each cell, of its centre where there is none."""
        length = np.linalg.norm(self.vector, axis=1, keepdims=True)
        return np.where(length > 0, self.vector / np.where(length > 0, length, 1), self._centre)

    def brightest(self) -> np.ndarray:
        """A unit vector towards the 8 degrees with the most light."""
        direction, light = self.direction, luminance(self.flux)
        top = np.argsort(light)[-BRIGHTEST_CELLS:]
        near = direction[top] @ direction.T >= np.cos(GROUP)
        vector = self.vector[near[np.argmax(near @ light)]].sum(axis=0)
        return vector / np.linalg.norm(vector)

    def rival(self, sun: np.ndarray) -> float:
        """The most luminance x solid angle that any other 8 degrees have above what surrounds them."""
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
    """The source round ``start``, or why there is none; ``pixel`` is the angle that a pixel spans at most."""
    direction, intensity, solid_angle = patch.direction, patch.luminance, patch.solid_angle
    outside = distance(direction, start) > SURROUNDINGS
    if not outside.any():
        return "the pixels are too large to show one"
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
    reach = min(reach, PATCH - float(distance(centre, start)))  # what is outside has not been looked at
    # Pixels that it covers in part belong to it too.
    return Region(centre, reach, max(2 * float(luminance(surroundings)), math.ulp(0.0)), surroundings)


def _reach(apart: np.ndarray, bright: np.ndarray, solid_angle: np.ndarray, pixel: float) -> float:
    """How far the source goes: a pixel beyond the first ring of a pixel's width that is less than a quarter bright."""
    ring = np.rint(apart / pixel).astype(int)
    lit, whole = np.bincount(ring, solid_angle * bright), np.bincount(ring, solid_angle)
    dark = (whole > 0) & (lit < 0.25 * whole)
    return ((int(np.argmax(dark)) if dark.any() else len(dark)) + 1.5) * pixel


def _median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, total[-1] / 2)]])


def measure(patch: Patch, region: Region, total: float, is_clipped: bool) -> Sun | str:
    """The sun that a region is, in a map of the flux ``total``, or why it is none."""
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
    even = light.sum() ** 2 / (light @ intensity)  # the solid angle of an even disc
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
