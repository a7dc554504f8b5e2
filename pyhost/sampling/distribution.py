"""The distribution of light over an environment map, and samples drawn from it.

Luminance is I = (R + G + B) / 3; a pixel is drawn with probability p(x, y)
proportional to I sin(theta), the light that comes from it. Kernels: ``row_cdf.cl``,
``marginal_cdf.cl``, ``sample.cl`` and its variants. Source: Pharr, Jakob, Humphreys, Physically
Based Rendering, 4th ed., A.4, A.5 and 12.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import __version__, checks
from ..errors import LightdomeError
from ..maps.envmap import EnvironmentMap
from ..names import SEED, WITHIN
from ..opencl.device import Device
from .cdf import MapCDF, build_cdf
from .device_map import DeviceMap
from .draw import BLACK, PIXEL_OUTPUTS, Points, drawn, given_points, sequence_points
from .samples import Samples


@dataclass(frozen=True, eq=False)
class Distribution:
    """p(x, y) of one map on one device; build with :func:`build_distribution`."""

    map: DeviceMap
    cdf: MapCDF

    def __repr__(self) -> str:
        size = f"{self.envmap.width} x {self.envmap.height}"
        return f"<Distribution: of a {size} map, flux {self.flux:.4g}, on {self.device.description}>"

    @property
    def device(self) -> Device:
        """The device that draws."""
        return self.map.device

    @property
    def envmap(self) -> EnvironmentMap:
        """The map."""
        return self.map.envmap

    @property
    def total(self) -> float:
        """The sum over the map of ``map.scale`` (R + G + B) sin(theta), float64."""
        return self.cdf.total

    @property
    def flux(self) -> float:
        """Phi, the integral of I over the sphere of directions: radiance x steradian."""
        per_sine = self.map.solid_angles[0] / np.sin(self.map.row_angles[0])
        return self.total / self.map.scale / 3 * per_sine

    def sample(self, count: int, seed: int = SEED, sequence: str = "independent", within: str = "centre") -> Samples:
        """Draw ``count`` samples. The same ``seed`` gives the same samples on every device.

        ``sequence`` names the points (``clkernels/common/sequence.clh``): ``independent``; ``stratified``, in cells of
        equal area, for any count; ``sobol``, Owen-scrambled; ``r2``, a lattice of any length; or ``lattice``, one made
        for exactly ``count`` points. Except with ``stratified`` and ``lattice``, the first n samples of a larger set
        are the set of n.

        A point u = (across, down) of the sequence becomes a sample in a few steps. ``across`` picks a strip of columns,
        ``down`` a row by the strip's CDF over rows, and what is left of ``across`` a pixel by the CDF of the row in the
        strip. Then ``within="centre"`` takes the direction of the pixel's centre. ``within="pixel"`` takes a direction
        in the pixel, uniform over its solid angle: the place of ``across`` in its step of the CDF becomes phi, from one
        side of the column to the other, and that of ``down`` becomes cos(theta), from the top of the row to its bottom.
        Both draw the same pixels, with the same probabilities.

        Raises :class:`LightdomeError` if the map is black, or for an invalid count, seed, sequence or ``within``.
        """
        return self._sample(sequence_points(count, seed, sequence), sequence, seed, within)

    def sample_pixels(
        self, count: int, seed: int = SEED, sequence: str = "independent"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Only the ``pixel`` (N, 2) int32 and ``probability`` (N,) float32 of :meth:`sample`, in half the time.

        Raises :class:`LightdomeError` as :meth:`sample` does.
        """
        points = sequence_points(count, seed, sequence)
        self._check_light()
        pixels = drawn(self.map, self.cdf, points, PIXEL_OUTPUTS)
        return pixels["pixel"], pixels["probability"]

    def sample_at(self, points: np.ndarray, within: str = "centre") -> Samples:
        """The samples at given ``points``, (N, 2) in [0, 1): column 0 picks x, column 1 picks y.

        Use this to draw with your own uniform numbers; :meth:`sample` says how a point becomes a sample. The first 32
        bits of a number pick the pixel, and the place in it depends on lower bits too, so give float64.
        Raises :class:`LightdomeError` for points outside [0, 1), and as :meth:`sample` does.
        """
        points = checks.array("points", points, ("N", 2), np.float64)
        if len(points) == 0:
            raise LightdomeError("points must have shape (N, 2) with N at least 1, got (0, 2)")
        if not ((points >= 0) & (points < 1)).all():
            raise LightdomeError("points must lie in [0, 1)")
        return self._sample(given_points(self.device, points), "given", 0, within)

    def pdf(self, directions: np.ndarray) -> np.ndarray:
        """The density per steradian at ``directions``, unit vectors (N, 3): (N,) float64.

        Samples with ``within="pixel"`` have this density: p(x, y) / solid angle of the pixel in which the direction
        lies. That is I / Phi, and integrates to 1 over the sphere.
        Raises :class:`LightdomeError` if the map is black, or for directions that are not unit vectors.
        """
        w_x, w_y, w_z = checks.unit_vectors("directions", directions, np.float64).T
        self._check_light()
        y = np.arctan2(np.hypot(w_x, w_z), w_y) * (self.envmap.height / np.pi)
        x = np.arctan2(w_z, w_x) * (self.envmap.width / (2 * np.pi)) % self.envmap.width
        pixel = tuple(
            np.minimum(i.astype(np.int64), n - 1) for i, n in ((y, self.envmap.height), (x, self.envmap.width))
        )
        return self.envmap.radiance[pixel].sum(axis=1, dtype=np.float64) / (3 * self.flux)

    def probability_image(self) -> np.ndarray:
        """p(x, y) of every pixel, (H, W) float64; its sum is 1.

        Raises :class:`LightdomeError` if the map is black.
        """
        self._check_light()
        weight = self.envmap.radiance.sum(axis=2, dtype=np.float64) * np.sin(self.map.row_angles)[:, None]
        return weight / weight.sum()

    def _sample(self, points: Points, sequence: str, seed: int, within: str) -> Samples:
        checks.choice("place within a pixel", within, WITHIN)
        self._check_light()
        return checks.made(
            Samples,
            **drawn(self.map, self.cdf, points, within=within),
            map_shape=(self.envmap.height, self.envmap.width),
            sequence=sequence,
            seed=seed,
            version=__version__,
            within=within,
        )

    def _check_light(self) -> None:
        if self.total == 0:
            raise LightdomeError(BLACK)


def build_distribution(device: Device, envmap: EnvironmentMap) -> Distribution:
    """Build the CDFs over rows and the CDFs of every row of ``envmap`` on ``device``.

    Raises :class:`LightdomeError` if the device does not have enough memory, or if an argument is of another type.
    """
    of_map = DeviceMap.of(device, envmap)
    of_map.upload()
    return Distribution(of_map, build_cdf(of_map))
