"""Do a few directional lights stand for a map?

Their total flux must be the map's, and the irradiance that they cause on surfaces of all directions like the map's. How
alike it can be with so many lights is known of median cut, and of samples: either is right.

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
from .tables import TableCheck, cause_named, colours_of, directions_of, read_table, unit, verdict_of

NORMALS = 400
FINE = 2**14  # lights that stand for the whole map
FLUX = 5e-3  # relative
MORE = 3.0  # times the error of a median cut, up to which lights agree
CHANCE = 2.5  # times the expected error of samples

CAUSES_OF_LIGHTS = (
    *CAUSES_OF_PLACES,
    Cause(
        "flux normalised away",
        "the lights have strengths of 1, or strengths whose sum is 1: the flux of the map is lost",
        "the image has another brightness, by the map's total flux",
        "where a region's light is made: its flux is the sum of radiance x solid angle",
    ),
    Cause(
        "cut line in both halves",
        "the row or column where a region is cut belongs to both halves, so that its light counts twice",
        "somewhat too bright, the more so the more lights there are",
        "where a region is cut in two: one half ends where the other begins",
    ),
    Cause(
        "cut line in neither half",
        "the row or column where a region is cut, or the map's last one, belongs to no half: its light is lost",
        "somewhat too dark, the more so the more lights there are",
        "where a region is cut in two: one half ends where the other begins",
    ),
    Cause(
        "solid angle missing",
        "the flux is the sum of radiance x sin(theta), without the 2 pi^2 / (W H) of a pixel's solid angle",
        "thousands of times too bright",
        "where a region's light is made",
    ),
    Cause(
        "pi missing",
        "the flux is off by a factor of pi",
        "3.14 times too bright or too dark",
        "where a region's light is made, or pi of the BRDF is divided out of it: it belongs to the surface",
    ),
    Cause(
        "flux scaled",
        "the total flux is that of the map times a factor",
        "the image is too bright or too dark",
        "where a region's light is made",
    ),
    Cause(
        "directions of no known lights",
        "the total flux is right, but the light comes from elsewhere",
        "lamps are at wrong places",
        "where a region's direction is made: the mean of its pixels' directions, weighted by their flux",
    ),
)


def read_lights(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Directions and fluxes, (N, 3) each, of a CSV or NPZ file; see :mod:`lightdome.checking.tables`.

    Raises :class:`LightdomeError` for a file that cannot be read, or lacks one of the two.
    """
    table = read_table(path)
    flux = colours_of(table)
    if flux is None:
        raise LightdomeError(f"{path}: it needs the lights' flux, as columns red, green, blue or an array flux (N, 3)")
    return directions_of(table, path), flux


def check_lights(device: Device, envmap: EnvironmentMap, direction: np.ndarray, flux: np.ndarray) -> TableCheck:
    """Compare lights of ``envmap`` with the map, and with a median cut of as many lights.

    - ``direction``: (N, 3), towards the lights
    - ``flux``: (N, 3), radiance x steradian

    Raises :class:`LightdomeError` for arrays of other shapes, values that are not finite, and for a black map.
    """
    checks.instance("the device", device, Device)
    checks.instance("the map", envmap, EnvironmentMap)
    direction = checks.array("direction", direction, ("N", 3), np.float64)
    flux = checks.array("flux", flux, (len(direction), 3), np.float64)
    if len(direction) == 0:
        raise LightdomeError("there must be at least one light, got none")
    if not envmap.peak > 0:
        raise LightdomeError("the map is black: it has no lights, and there is nothing to check")
    if not np.isfinite(flux).all():
        n = int(np.argmin(np.isfinite(flux).all(axis=1)))
        raise LightdomeError(f"flux must be finite, got {checks.told(flux[n].tolist())} (light {n})")
    return _Lights(device, envmap, direction, flux).result()


def _normals() -> np.ndarray:
    """Unit vectors that cover the sphere evenly, by the golden ratio."""
    n = np.arange(NORMALS)
    y, phi = 1 - (2 * n + 1) / NORMALS, n * (math.pi * (3 - math.sqrt(5)))
    sine = np.sqrt(1 - y * y)
    return np.stack([sine * np.cos(phi), y, sine * np.sin(phi)], axis=1)


def _geometries(direction: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """The directions as they would be without a known mistake."""
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
        """Relative RMSE of the irradiance over all directions of the normal."""
        return relative_rmse(np.maximum(0, self.normal @ direction.T) @ flux, self.exact)

    def result(self) -> TableCheck:
        causes: list[tuple[Cause, str]] = []
        found = self.flux.sum(axis=0)
        factor = float(found.sum() / self.total.sum())
        scaled = self.flux if abs(factor - 1) < FLUX or not factor > 0 else self.flux / factor
        light = self.flux.mean(axis=1)
        drawn = np.ptp(light) <= 1e-3 * light.mean()  # lights of samples have equal strengths
        limit = max(self.close, CHANCE * self.sample_error) if drawn else self.close
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

        def add(name: str, more: str = "") -> None:
            causes.append((cause_named(name, CAUSES_OF_LIGHTS), more))

        if self.off_unit > UNIT:
            add("directions not normalised", f"one is off by {self.off_unit:.2g}")
        if geometry:
            add(geometry)
        if swapped:
            add("channels swapped")
        elif abs(factor - 1) >= FLUX:
            add(*self.flux_mistake(found, factor, drawn or (turned <= self.close and not geometry)))
        elif turned > limit:
            add(
                "directions of no known lights", f"relative RMSE {turned:.1%}, a median cut leaves {self.cut_error:.1%}"
            )
        orientation = str(turn)
        wrongly_turned = bool(orientation) and turn.preset is None
        if causes or wrongly_turned:
            cause = causes[0][0] if causes else None
            verdict = verdict_of(causes, orientation if wrongly_turned else "")
            return TableCheck(False, verdict, cause, orientation, details)
        verdict = f"agrees: relative RMSE of the irradiance {turned:.2%}, a median cut of so many leaves"
        verdict += f" {self.cut_error:.2%}, samples {self.sample_error:.2%}"
        return TableCheck(True, verdict + (f"; {orientation}" if orientation else ""), None, orientation, details)

    def orientation(self, flux: np.ndarray, error: float, limit: float) -> tuple[Turn, str, float]:
        """The turn of the directions, a mistake in their angles, and the error that is left."""
        own = Turn("", 0.0), "", error
        if error <= limit:
            return own
        tried = [(self.error(self.direction @ turn.matrix.T, flux), turn) for turn in turns()]
        # A convention that chance allows is likelier than a turn that fits better.
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
        """The cause of another total flux, and a remark; ``alike`` says that nothing else is wrong."""
        more = f"{factor:.4g} times that of the map"
        light = self.flux.mean(axis=1)
        drawn_evenly = np.ptp(light) <= 1e-3 * light.mean()
        if drawn_evenly and any(abs(light[0] * n - 1) < 1e-3 for n in (1, self.count)):
            return "flux normalised away", more
        if any(abs(total - 1) < 1e-3 for total in (found.sum(), found.mean(), self.flux.max())):
            return "flux normalised away", more
        area = self.area
        sine = np.sin(row_angles(len(self.radiance)))[:, None, None]
        per_pixel = 4 * math.pi / self.radiance[..., 0].size

        def is_that_of(other: np.ndarray, *factors: float) -> bool:
            return any(np.abs(found - other * f).max() < FLUX / 2 * (other * f).max() for f in factors)

        if is_that_of(self.radiance.sum(axis=(0, 1)), 1, area, per_pixel):
            return "no sin(theta)", more
        if is_that_of((self.radiance * sine**2).sum(axis=(0, 1)), 1, area, per_pixel):
            return "sin(theta) twice", more
        if is_that_of(self.total, 1 / area):
            return "solid angle missing", more
        for name, change in CHANGES.items():
            with np.errstate(over="ignore"):
                other = (change(self.radiance) * sine).sum(axis=(0, 1)) * area
            if is_that_of(other, 1):
                return name, more
        if is_that_of(self.total, math.pi, 1 / math.pi):
            return "pi missing", more
        if alike and (drawn_evenly or is_that_of(self.total, factor)):
            return "flux scaled", more
        return ("cut line in both halves" if factor > 1 else "cut line in neither half"), more
