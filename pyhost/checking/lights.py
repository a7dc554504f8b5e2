"""Do a few directional lights stand for a map?

Their total flux must be the map's, and surfaces facing any direction must receive nearly the same irradiance from the
lights as from the map. How close so many lights can come is known for a median cut and for samples; either is right.

Sources: Debevec, A Median Cut Algorithm for Light Probe Sampling (2005); Pharr, Jakob, Humphreys, Physically Based
Rendering, 4th ed., 2.1 (variance).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .. import checks
from ..errors import LightdomeError
from ..evaluation.metrics import relative_rmse
from ..lighting.median_cut import median_cut
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import row_angles, solid_angles
from ..opencl.device import Device
from ..sampling.distribution import build_distribution
from .causes import Cause
from .laws import CHANGES
from .places import CAUSES_OF_PLACES, Turn, turns
from .samples import UNIT
from .tables import TableCheck, cause_named, colours_of, directions_of, read_table, unit

NORMALS = 400  # directions in which irradiance is compared
FINE = 2**14  # lights that replace the whole map
FLUX = 5e-3  # allowed relative error of the total flux
MORE = 3.0  # lights may have so many times the error of a median cut
CHANCE = 2.5  # samples may have so many times their expected error
OVERLAP = 30.0  # by which factor a cut line in both halves, or in neither, may change the flux

CAUSES_OF_LIGHTS = (
    *CAUSES_OF_PLACES,
    Cause(
        "flux normalised away",
        "the strengths of the lights are all 1, or their sum is 1, so the flux of the map is lost",
        "the brightness of the image is off by the total flux of the map",
        "where the light of a region is computed: its flux is the sum of radiance x solid angle",
    ),
    Cause(
        "cut line in both halves",
        "the row or column where a region is cut belongs to both halves, so its light counts twice",
        "somewhat too bright, more so with more lights",
        "where a region is cut in two: one half must end where the other begins",
    ),
    Cause(
        "cut line in neither half",
        "the row or column where a region is cut, or the last of the map, belongs to neither half: its light is lost",
        "somewhat too dark, more so with more lights",
        "where a region is cut in two: one half must end where the other begins",
    ),
    Cause(
        "solid angle missing",
        "the flux is the sum of radiance x sin(theta), without the factor 2 pi^2 / (W H) of the solid angle",
        "thousands of times too bright",
        "where the light of a region is computed",
    ),
    Cause(
        "pi missing",
        "the flux is off by a factor of pi",
        "3.14 times too bright or too dark",
        "where the light of a region is computed: the 1 / pi of the BRDF belongs to the surface, not to the light",
    ),
    Cause(
        "flux scaled",
        "the total flux is that of the map times a factor",
        "the image is too bright or too dark",
        "where the light of a region is computed",
    ),
    Cause(
        "wrong directions",
        "the total flux is right, but the light comes from other directions",
        "lamps are in the wrong places",
        "where the direction of a region is computed: the mean direction of its pixels, weighted by flux",
    ),
)


def read_lights(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """The directions and fluxes, (N, 3) each, in a CSV or NPZ file; see :mod:`lightdome.checking.tables`.

    Raises :class:`LightdomeError` for a file that cannot be read, or lacks either.
    """
    table = read_table(path)
    flux = colours_of(table)
    if flux is None:
        raise LightdomeError(f"{path}: no flux of lights: expected columns red, green, blue or an array flux (N, 3)")
    return directions_of(table, path), flux


def check_lights(device: Device, envmap: EnvironmentMap, direction: np.ndarray, flux: np.ndarray) -> TableCheck:
    """Compare lights with ``envmap``, for which they stand, and with a median cut into as many lights.

    - ``direction``: (N, 3), towards the lights
    - ``flux``: (N, 3), radiance x steradian

    Raises :class:`LightdomeError` for arrays of other shapes, for values that are not finite, and for a black map.
    """
    checks.instance("the device", device, Device)
    checks.instance("the map", envmap, EnvironmentMap)
    direction = checks.array("direction", direction, ("N", 3), np.float64)
    flux = checks.array("flux", flux, (len(direction), 3), np.float64)
    if len(direction) == 0:
        raise LightdomeError("there must be at least one light, got none")
    if not envmap.peak > 0:
        raise LightdomeError("the map is black: it has no lights")
    if not np.isfinite(flux).all():
        n = int(np.argmin(np.isfinite(flux).all(axis=1)))
        raise LightdomeError(f"flux must be finite, got {checks.told(flux[n].tolist())} (light {n})")
    return _Lights(device, envmap, direction, flux).result()


def _normals() -> np.ndarray:
    """Unit vectors spread evenly over the sphere, a spiral with the golden angle."""
    n = np.arange(NORMALS)
    y, phi = 1 - (2 * n + 1) / NORMALS, n * (math.pi * (3 - math.sqrt(5)))
    sine = np.sqrt(1 - y * y)
    return np.stack([sine * np.cos(phi), y, sine * np.sin(phi)], axis=1)


def _geometries(direction: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Names of mistakes in the angles, and the directions with each of them undone."""
    theta = np.arccos(np.clip(direction[:, 1], -1, 1))
    phi = np.arctan2(direction[:, 2], direction[:, 0]) % (2 * np.pi)
    for name, (t, f) in {
        "theta over half its range": (2 * theta, phi),
        "phi over half its range": (theta, 2 * phi),
        "x and y swapped": (phi / 2, 2 * theta),
    }.items():
        yield name, np.stack([np.sin(t) * np.cos(f), np.cos(t), np.sin(t) * np.sin(f)], axis=1)


class _Lights:
    def __init__(self, device: Device, envmap: EnvironmentMap, direction: np.ndarray, flux: np.ndarray) -> None:
        self.radiance = envmap.radiance.astype(np.float64)
        self.direction, self.off_unit = unit(direction)
        self.flux, self.count = flux, len(flux)
        strength = flux.mean(axis=1)
        self.drawn = np.ptp(strength) <= 1e-3 * strength.mean()  # lights made from samples are equally strong
        self.normal = _normals()
        distribution = build_distribution(device, envmap)
        whole = median_cut(distribution, FINE)
        cosine = np.maximum(0, self.normal @ whole.direction.astype(np.float64).T)
        self.exact = cosine @ whole.flux
        cut = median_cut(distribution, self.count)
        self.cut_error = self.error(cut.direction.astype(np.float64), cut.flux)
        self.close = MORE * self.cut_error + FLUX + 1e-3
        share = whole.flux.sum(axis=1) / whole.flux.sum()
        square = (cosine**2) @ (whole.flux**2 / np.where(share > 0, share, 1)[:, None])
        self.sample_error = math.sqrt((square - self.exact**2).mean() / (self.exact**2).mean() / self.count)
        area = solid_angles(envmap.height, envmap.width)[:, None, None]
        self.total = (self.radiance * area).sum(axis=(0, 1))
        self.area = float(area.max() / np.sin(row_angles(envmap.height)).max())

    def error(self, direction: np.ndarray, flux: np.ndarray) -> float:
        """The relative RMSE of the irradiance over all normals."""
        return relative_rmse(np.maximum(0, self.normal @ direction.T) @ flux, self.exact)

    def result(self) -> TableCheck:
        causes: list[tuple[Cause, str]] = []
        found = self.flux.sum(axis=0)
        factor = float(found.sum() / self.total.sum())
        scaled = self.flux if abs(factor - 1) < FLUX or not factor > 0 else self.flux / factor
        limit = max(self.close, CHANCE * self.sample_error) if self.drawn else self.close
        error = self.error(self.direction, scaled)
        swapped = error > limit and self.error(self.direction, scaled[:, ::-1]) < min(limit, error / 2)
        if swapped:
            scaled = scaled[:, ::-1]
            error = self.error(self.direction, scaled)
        turn, geometry, turned = self.orientation(scaled, error, limit)
        details: dict[str, object] = {
            "lights": self.count,
            "flux_rgb": found,
            "flux_of_the_map_rgb": self.total,
            "flux_factor": factor,
            "relative_rmse": self.error(self.direction, self.flux),
            "relative_rmse_of_the_shape": turned,
            "relative_rmse_of_a_median_cut": self.cut_error,
            "relative_rmse_expected_of_samples": self.sample_error,
        }

        def add(name: str, remark: str = "") -> None:
            causes.append((cause_named(name, CAUSES_OF_LIGHTS), remark))

        if self.off_unit > UNIT:
            add("directions not normalised", f"by up to {self.off_unit:.2g}")
        if geometry:
            add(geometry)
        if swapped:
            add("channels swapped")
        elif abs(factor - 1) >= FLUX:
            add(*self.flux_mistake(found, factor, self.drawn or (turned <= self.close and not geometry)))
        elif turned > limit:
            add("wrong directions", f"relative RMSE {turned:.1%}; that of a median cut is {self.cut_error:.1%}")
        agreement = (
            f"agrees: the relative RMSE of the irradiance is {turned:.2%}; for a median cut into as many lights it is"
            f" {self.cut_error:.2%}, for samples {self.sample_error:.2%}"
        )
        return TableCheck.of(causes, details, agreement, str(turn), turn.is_wrong)

    def orientation(self, flux: np.ndarray, error: float, limit: float) -> tuple[Turn, str, float]:
        """How the directions are turned, the mistake in their angles, and the remaining error."""
        own = Turn("", 0.0), "", error
        if error <= limit:
            return own
        tried = [(self.error(self.direction @ turn.matrix.T, flux), turn) for turn in turns()]
        # A convention within the limit is likelier than a turn of no convention that fits better.
        tried = [(e, turn) for e, turn in tried if turn.preset and e <= limit] or tried
        least = min(e for e, _ in tried)
        turned, turn = next((e, t) for e, t in tried if e <= least * 1.001)
        best = (turn, "", turned)
        for name, direction in _geometries(self.direction):
            without = self.error(direction, flux)
            if without < 0.7 * best[2] and best[2] > limit:
                best = Turn("", 0.0), name, without
        return best if best[2] <= limit and best[2] < 0.7 * error else own

    def flux_mistake(self, found: np.ndarray, factor: float, alike: bool) -> tuple[str, str]:
        """The cause of a wrong total flux, and a remark; ``alike`` says that nothing else is wrong."""
        remark = f"{factor:.4g} times that of the map"
        if self.drawn and any(abs(self.flux[0].mean() * n - 1) < 1e-3 for n in (1, self.count)):
            return "flux normalised away", remark
        if any(abs(total - 1) < 1e-3 for total in (found.sum(), found.mean(), self.flux.max())):
            return "flux normalised away", remark
        area = self.area
        sine = np.sin(row_angles(len(self.radiance)))[:, None, None]
        per_pixel = 4 * math.pi / self.radiance[..., 0].size

        def is_that_of(other: np.ndarray, *factors: float) -> bool:
            return any(np.abs(found - other * f).max() < FLUX / 2 * (other * f).max() for f in factors)

        if is_that_of(self.radiance.sum(axis=(0, 1)), 1, area, per_pixel):
            return "no sin(theta)", remark
        if is_that_of((self.radiance * sine**2).sum(axis=(0, 1)), 1, area, per_pixel):
            return "sin(theta) twice", remark
        if is_that_of(self.total, 1 / area):
            return "solid angle missing", remark
        for name, change in CHANGES.items():
            with np.errstate(over="ignore"):
                other = (change(self.radiance) * sine).sum(axis=(0, 1)) * area
            if is_that_of(other, 1):
                return name, remark
        if is_that_of(self.total, math.pi, 1 / math.pi):
            return "pi missing", remark
        scaled = alike and (self.drawn or is_that_of(self.total, factor))
        if scaled or not 1 / OVERLAP < factor < OVERLAP:
            return "flux scaled", remark
        return ("cut line in both halves" if factor > 1 else "cut line in neither half"), remark
