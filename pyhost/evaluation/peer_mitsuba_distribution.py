"""Mitsuba 3's ``DiscreteDistribution2D`` on the stability table's maps, in a separate process.

It is given luminance x sin(theta) in float32, in the variant ``llvm_ad_rgb``, and asked for p of all pixels and for
draws.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from .. import reference
from ..checks import made
from ..disc import disc_mask
from ..errors import LightdomeError
from ..maps.geometry import column_angles, directions, row_angles, solid_angles
from ..sampling.samples import Samples
from .mitsuba_process import INSTALL, MitsubaProcess, installed, use_variant

TIMEOUT = 300.0  # seconds


class MitsubaSamplers:
    """Mitsuba's process, made with :func:`start`; :meth:`sampler` makes a sampler for a map."""

    def __init__(self, process: MitsubaProcess) -> None:
        self._process = process
        self.about = process.about

    def sampler(self, radiance: np.ndarray) -> MitsubaSampler:
        """A :class:`lightdome.evaluation.stability.Sampler` for a map.

        Raises :class:`LightdomeError` if Mitsuba fails or ends.
        """
        return MitsubaSampler(self._process, radiance)


@contextmanager
def start() -> Iterator[MitsubaSamplers]:
    """Start the process; it ends with the ``with`` block. Raises :class:`LightdomeError` if Mitsuba does not work."""
    if not installed():
        raise LightdomeError(INSTALL)
    process = MitsubaProcess(DistributionWorker)
    try:
        yield MitsubaSamplers(process)
    finally:
        process.stop()


class MitsubaSampler:
    """Mitsuba's distribution of one map, as a :class:`lightdome.evaluation.stability.Sampler`."""

    def __init__(self, process: MitsubaProcess, radiance: np.ndarray) -> None:
        self._process = process
        self._radiance = radiance
        height, width = radiance.shape[:2]
        weights = np.empty((height, width), np.float32)
        for row, weight, theta in zip(radiance, weights, row_angles(height), strict=True):
            weight[:] = row.sum(axis=1, dtype=np.float64) / 3 * np.sin(theta)
        total = process.call("build", weights, timeout=TIMEOUT)
        self.flux = total * solid_angles(height, width)[0] / np.sin(row_angles(height)[0])

    def probability(self, rows: slice) -> np.ndarray:
        """p(x, y) of whole rows, (n, W)."""
        width = self._radiance.shape[1]
        p: np.ndarray = self._process.call("probability", rows.start, rows.stop, width, timeout=TIMEOUT)
        return p

    def draw(self, count: int, seed: int) -> Samples:
        """``count`` samples, from points of 24 bits that numpy draws."""
        height, width = self._radiance.shape[:2]
        x, y, p = self._process.call("draw", count, seed, timeout=TIMEOUT)
        direction = directions(row_angles(height)[y], column_angles(width)[x])
        return made(  # unchecked, because their correctness is what is being measured
            Samples,
            direction=direction.astype(np.float32),
            radiance=self._radiance[y, x],
            probability=p,
            pixel=np.stack([x, y], axis=1).astype(np.int32),
            map_shape=(height, width),
        )

    def image(self, samples: Samples, resolution: int) -> np.ndarray:
        """The sphere lit by the samples, shaded by numpy in float64."""
        image = np.zeros((resolution, resolution, 3))
        mask = disc_mask(resolution)
        normals = reference.normals(resolution)[mask]
        image[mask] = reference.shade(normals, samples.direction, samples.radiance.astype(np.float64), samples.density)
        return image


# ---- in the process ----


class DistributionWorker:
    """Holds the most recently built distribution."""

    def __init__(self) -> None:
        self.about = use_variant("llvm_ad_rgb")
        self.build(np.ones((2, 2), np.float32))

    def build(self, weights: np.ndarray) -> float:
        """Build the distribution; returns the total weight, from the brightest pixel's weight and p."""
        import mitsuba

        self._distribution = mitsuba.DiscreteDistribution2D(weights)
        y, x = np.unravel_index(weights.argmax(), weights.shape)
        at = mitsuba.Point2u(int(x), int(y))
        with np.errstate(all="ignore"):
            return float(np.float64(self._distribution.eval(at)[0]) / np.float64(self._distribution.pdf(at)[0]))

    def probability(self, first: int, last: int, width: int) -> np.ndarray:
        """p of the rows ``first`` to ``last`` - 1."""
        import mitsuba

        y, x = np.mgrid[first:last, 0:width].astype(np.uint32)
        p = np.array(self._distribution.pdf(mitsuba.Point2u(x.ravel(), y.ravel())))
        return np.broadcast_to(p, y.size).reshape(y.shape)

    def draw(self, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x, y and p of ``count`` drawn pixels."""
        import mitsuba

        u = np.random.default_rng(seed).random((2, count), dtype=np.float32)
        at, p, _ = self._distribution.sample(mitsuba.Point2f(u[0], u[1]))
        # If all entries are equal, as y is for a map of one row, Dr.Jit keeps a single value.
        x, y, p = (np.broadcast_to(np.array(v), count) for v in (at.x, at.y, p))
        return x, y, p
