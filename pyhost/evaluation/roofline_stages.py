"""What every stage does, at the least: the bytes that it must move and the operations that it needs.

Bytes are compulsory: every input read once, every result written once, tables between two passes over a map
written and read once. An operation is one lane of one vector instruction on 32-bit numbers, so a multiply-add is one
and so is a maximum. They are counted from formulas, not from the kernels' code: what a kernel does beyond them
lowers its share. Searches count nothing, since the number of steps depends on the map; what they wait for is latency.

A sphere lit by N lights is the exception. Nobody knows the least there, so it is counted as a brute-force kernel does
it, with 7 operations for each pair of pixel and light: a multiplication, 2 multiply-adds and a maximum for the cosine,
and 3 multiply-adds for R, G, B. A share above 1 then says how much of that was skipped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from ..disc import disc_mask
from ..lighting.exact import exact
from ..lighting.harmonics import Harmonics, project, shade_harmonics
from ..lighting.lights import Lights
from ..lighting.median_cut import median_cut
from ..lighting.shade import shade
from ..maps.envmap import EnvironmentMap
from ..names import ESTIMATORS
from ..opencl.device import Device
from ..opencl.memory import DeviceArray
from ..rendering.per_pixel import render
from ..sampling.cdf import RowCDFs, build_row_cdfs
from ..sampling.distribution import Distribution, build_distribution
from ..sampling.draw import PIXELS, draw, room_for, sequence_points

MADE = "made"  # the name of maps that were made to be measured
PAIR = 7  # operations for a pair of pixel and light
SPP = 16  # samples per pixel of the per-pixel estimators
ORDER = 10  # of spherical harmonics

POINT = 40  # operations: Philox's 10 rounds of 4 products and 4 xors, for two points
DIRECTION = 2  # sin theta cos phi and sin theta sin phi


@dataclass(frozen=True)
class Work:
    """The least that a stage can do, see above; ``amount`` and ``unit`` say what comes of it.

    ``pairs`` of pixel and light are those that a brute-force kernel would evaluate; a stage that ``skips`` has
    their operations for its own.
    """

    bytes: float
    operations: float
    amount: float
    unit: str
    pairs: float = 0.0
    skips: bool = False


@dataclass(frozen=True)
class Stage:
    """One stage at one size: ``run`` does it, and ``events`` of the device's profile are its time.

    None stands for all events but transfers. ``map_shape`` is (height, width), None where no map is read. ``N``
    counts samples or lights, of per-pixel estimators samples per pixel; for harmonics it is the order. A stage that is
    little more than a copy runs in turn with one, ``beside_copy``: a core that slept slows down both.
    """

    name: str
    run: Callable[[], object]
    work: Work
    events: tuple[str, ...] | None = None
    map: str = ""
    map_shape: tuple[int, int] | None = None
    resolution: int | None = None
    N: int | None = None
    beside_copy: bool = False


def made_map(height: int) -> EnvironmentMap:
    """Log-normal noise, (height, 2 height, 3), quickly: a block of it repeated, each row with a factor of its own."""
    rng = np.random.default_rng(1)
    block = np.exp(rng.normal(0, 2, (min(height, 512), min(2 * height, 1024), 3))).astype(np.float32)
    radiance = np.tile(block, (-(-height // 512), -(-height // 512), 1))[:height, : 2 * height]
    radiance *= np.exp(rng.normal(0, 1, (height, 1, 1))).astype(np.float32)
    return EnvironmentMap(radiance)


class MapStages:
    """The stages that read one map, called ``name`` in what is measured."""

    def __init__(self, device: Device, envmap: EnvironmentMap, name: str) -> None:
        self.device = device
        self.envmap = envmap
        self.name = name
        self.pixels = envmap.width * envmap.height

    @cached_property
    def distribution(self) -> Distribution:
        """The distribution that all stages share."""
        return build_distribution(self.device, self.envmap)

    def _stage(self, name: str, run: Callable[[], object], work: Work, **fields: Any) -> Stage:
        return Stage(name, run, work, map=self.name, map_shape=self.envmap.radiance.shape[:2], **fields)

    def tables(self) -> Iterator[Stage]:
        """Row CDFs, the CDF over rows, guide tables, harmonics: what depends on the map alone."""
        height, pixels = self.envmap.height, self.pixels
        built: list[RowCDFs] = []

        def rows() -> None:
            built[:] = [build_row_cdfs(self.distribution.map, out=built[0] if built else None)]

        # A weight, their sum, rounding, the prefix sum.
        work = Work((12 + 4) * pixels, 7 * pixels, pixels, "pixels")
        yield self._stage("row cdf", rows, work, beside_copy=True)
        build = partial(build_distribution, self.device, self.envmap)
        work = Work((8 + 4 + 4) * height, 5 * height, height, "rows")
        yield self._stage("marginal cdf", build, work, events=("marginal cdf",))
        # Every entry of the CDFs is read and compared once, an index for every bucket is written.
        guide = self.distribution.cdf.guide
        work = Work(4 * pixels + guide.rows.dtype.itemsize * guide.rows.shape[1] * height, pixels, pixels, "pixels")
        yield self._stage("guide", lambda: replace(self.distribution.cdf).guide, work)
        work = Work(12 * pixels, 3 * (2 * ORDER + 1) * pixels, pixels, "pixels")
        of_map = self.distribution.map
        yield self._stage("harmonics project", partial(project, self.device, of_map, ORDER), work, N=ORDER)

    def sample(self, N: int) -> Iterator[Stage]:
        """N directions drawn, with tables that are there; and N pixels, written over those of the run before."""
        # Pixel, probability, direction and radiance are written; a pixel's CDF and radiance are read.
        work = Work(36 * N + 16 * min(N, self.pixels), (POINT + DIRECTION + 4) * N, N, "samples")
        yield self._stage("sample", lambda: self.distribution.sample(N), work, N=N)
        work = Work(12 * N + 8 * min(N, self.pixels), (POINT + 2) * N, N, "samples")
        out: dict[str, DeviceArray] = {}

        def run() -> None:
            out.update(out or room_for(self.device, N, PIXELS))
            draw(self.distribution.map, self.distribution.cdf, sequence_points(N, 0, "independent"), out)

        yield self._stage("sample pixels", run, work, N=N)

    def median_cut(self, N: int) -> Stage:
        """N lights by median cut."""
        # The map twice, before and after the cuts, and tables of 12 bytes a pixel between.
        work = Work((12 + 24 + 12) * self.pixels, 17 * self.pixels, self.pixels, "pixels")
        return self._stage("median cut", lambda: median_cut(self.distribution, N), work, N=N)

    def images(self, resolution: int) -> Iterator[Stage]:
        """The exact image, and those of the per-pixel estimators."""
        mask = disc_mask(resolution)
        disc = int(mask.sum())
        # The map's prefix sums of 9 numbers; and for each pixel and each row that its horizon cuts, a difference of
        # two and a sum.
        n_y = (2.0 * np.arange(resolution) + 1 - resolution) / resolution
        arcs = self.envmap.height * float(mask.sum(axis=1) @ (1 - 2 / np.pi * np.arcsin(np.abs(n_y))))
        pairs = float(disc) * self.pixels
        image = 12 * resolution**2
        work = Work(12 * self.pixels + image, 9 * self.pixels + 18 * arcs, pairs, "pairs", pairs)
        run = partial(exact, self.device, self.distribution.map, resolution)
        yield self._stage("exact", run, work, resolution=resolution)
        count = disc * SPP
        for estimator in ESTIMATORS:
            work = Work(
                image + 16 * min(count, self.pixels), ESTIMATORS[estimator].operations * count, count, "samples"
            )

            def all_spp(estimator: str = estimator) -> None:
                list(render(self.distribution, [SPP], resolution, estimator=estimator, sequence="sobol"))

            yield self._stage(estimator, all_spp, work, resolution=resolution, N=SPP)


def shading(device: Device, distribution: Distribution, N: int, resolution: int) -> Iterator[Stage]:
    """The sphere lit by N samples: as it is done, and by evaluating every pair of pixel and light."""
    lights = Lights.of(distribution.sample(N))
    pairs = float(N) * int(disc_mask(resolution).sum())
    for brute_force in (False, True):
        work = Work(12 * resolution**2 + 24 * N, PAIR * pairs, pairs, "pairs", pairs, skips=not brute_force)
        run = partial(shade, device, lights, resolution=resolution, brute_force=brute_force)
        yield Stage("shade brute force" if brute_force else "shade", run, work, resolution=resolution, N=N)


def harmonics(device: Device, resolution: int) -> Stage:
    """The sphere lit by spherical harmonics."""
    disc = int(disc_mask(resolution).sum())
    # A Legendre function by its recurrence; R, G, B with the real and the imaginary part where A_l is not 0.
    terms = ((m, n) for m in range(ORDER + 1) for n in range(m, ORDER + 1))
    a_pixel = sum(2 + (3 if m == 0 else 6) * (n <= 1 or n % 2 == 0) for m, n in terms)
    work = Work(12 * resolution**2, a_pixel * disc, disc, "pixels")
    run = partial(shade_harmonics, device, Harmonics(np.ones(((ORDER + 1) ** 2, 3))), resolution)
    return Stage("harmonics shade", run, work, resolution=resolution, N=ORDER)


def plan(
    device: Device,
    envmap: EnvironmentMap,
    name: str,
    heights: Sequence[int],
    resolutions: Sequence[int],
    resolution: int,
    counts: Sequence[int],
    N: int,
) -> Iterator[tuple[float, Stage]]:
    """Stages with the fraction of the plan that lies before them, to be run in turn: maps live only meanwhile.

    One thing changes at a time: the map, 2 ``heights`` x ``heights`` pixels, the image's ``resolutions``, and
    the ``counts`` of samples or lights; what does not change is ``envmap``, ``resolution`` and ``N``.
    """
    maps = 1 + len(heights)
    for index, height in enumerate((None, *heights)):
        of_map = MapStages(device, envmap if height is None else made_map(height), name if height is None else MADE)
        stages = list(of_map.tables())
        for count in counts if height is None else [max(counts)]:
            stages += of_map.sample(count)
        cuts = [count for count in counts if count <= of_map.pixels] if height is None else [N]
        stages += [of_map.median_cut(count) for count in cuts]
        for side in resolutions if height is None else (resolution,):
            stages += of_map.images(side)
        if height is None:
            sizes = [(N, side) for side in resolutions] + [(count, resolution) for count in counts if count != N]
            for count, side in sizes:
                stages += shading(device, of_map.distribution, count, side)
            stages += [harmonics(device, side) for side in resolutions]
        for done, stage in enumerate(stages):
            yield (index + done / len(stages)) / maps, stage
