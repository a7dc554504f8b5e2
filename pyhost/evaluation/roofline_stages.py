"""The least work of each stage: the bytes that it must move and the operations that it needs.

Bytes are compulsory traffic: every input is read once, every result is written once, and tables between two passes over
a map are written and read once. An operation is one lane of one vector instruction on 32-bit numbers, so a multiply-add
counts as one, and so does a maximum. Operations are counted from formulas, not from the kernels' code; whatever a
kernel does beyond them lowers its share. Searches count nothing, since their number of steps depends on the map, and
what they wait for is latency.

A sphere lit by N lights is the exception. The minimum there is unknown, so it counts as in a brute-force kernel, with 7
operations for each pair of pixel and light: a multiplication, 2 multiply-adds and a maximum for the cosine, and 3
multiply-adds for R, G, B. A share above 1 then tells how much of that was skipped.
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
from ..rendering.light_share import choose_share
from ..rendering.per_pixel import render
from ..sampling.cdf import RowCDFs, build_row_cdfs
from ..sampling.distribution import Distribution, build_distribution
from ..sampling.draw import PIXEL_OUTPUTS, draw, room_for, sequence_points

MADE = "made"  # the name of maps made for the measurement
PAIR = 7  # operations per pair of pixel and light
SPP = 16  # samples per pixel, for the per-pixel estimators
ORDER = 10  # of spherical harmonics

POINT = 40  # operations: half of Philox's 10 rounds of 4 products and 4 xors, which give two points
DIRECTION = 2  # sin(theta) cos(phi) and sin(theta) sin(phi)


@dataclass(frozen=True)
class Work:
    """The least work of a stage, see above; it produces ``amount`` of ``unit``.

    ``pairs`` of pixel and light are those that a brute-force kernel would evaluate. A stage that ``skips`` some is
    charged their operations nevertheless.
    """

    bytes: float
    operations: float
    amount: float
    unit: str
    pairs: float = 0.0
    skips: bool = False


@dataclass(frozen=True)
class Stage:
    """One stage at one size: ``run`` executes it, and ``events`` of the device's profile are its time.

    With None for ``events``, all events but transfers count. ``map_shape`` is (height, width), or None if no map is
    read. ``N`` is the number of samples or lights, for per-pixel estimators the samples per pixel, for harmonics the
    order. A stage that is little more than a copy alternates with one, ``beside_copy``, because a core that has slept
    slows down both.
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
    """Log-normal noise, (height, 2 height, 3), made quickly: a block is repeated, with a factor for each row."""
    rng = np.random.default_rng(1)
    block = np.exp(rng.normal(0, 2, (min(height, 512), min(2 * height, 1024), 3))).astype(np.float32)
    radiance = np.tile(block, (-(-height // 512), -(-height // 512), 1))[:height, : 2 * height]
    radiance *= np.exp(rng.normal(0, 1, (height, 1, 1))).astype(np.float32)
    return EnvironmentMap(radiance)


class MapStages:
    """The stages that read one map, called ``name`` in the measurements."""

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
        """What depends on the map alone: row CDFs, the CDF over rows, guide tables, harmonics."""
        height, pixels = self.envmap.height, self.pixels
        built: list[RowCDFs] = []

        def rows() -> None:
            built[:] = [build_row_cdfs(self.distribution.map, out=built[0] if built else None)]

        # Each pixel's weight, the sum of weights, rounding, the prefix sum.
        work = Work((12 + 4) * pixels, 7 * pixels, pixels, "pixels")
        yield self._stage("row cdf", rows, work, beside_copy=True)
        build = partial(build_distribution, self.device, self.envmap)
        strips, _ = self.distribution.cdf.marginal.shape
        work = Work((8 * strips + 4 + 4 * strips) * height, 5 * strips * height, height, "rows")
        yield self._stage("marginal cdf", build, work, events=("marginal cdf",))
        # Each entry of the CDFs is read and compared once, and an index per bucket is written.
        guide = self.distribution.cdf.guide
        cdfs, buckets, _ = guide.rows.shape
        work = Work(4 * pixels + guide.rows.dtype.itemsize * cdfs * buckets, pixels, pixels, "pixels")
        yield self._stage("guide", lambda: replace(self.distribution.cdf).guide, work)
        work = Work(12 * pixels, 3 * (2 * ORDER + 1) * pixels, pixels, "pixels")
        of_map = self.distribution.map
        yield self._stage("harmonics project", partial(project, self.device, of_map, ORDER), work, N=ORDER)

    def sample(self, N: int) -> Iterator[Stage]:
        """Draw N directions, with existing tables; draw N pixels, overwriting those of the previous run."""
        # Pixel, probability, direction and radiance are written; the pixel's CDF entry and radiance are read.
        work = Work(36 * N + 16 * min(N, self.pixels), (POINT + DIRECTION + 4) * N, N, "samples")
        yield self._stage("sample", lambda: self.distribution.sample(N), work, N=N)
        work = Work(12 * N + 8 * min(N, self.pixels), (POINT + 2) * N, N, "samples")
        out: dict[str, DeviceArray] = {}

        def run() -> None:
            out.update(out or room_for(self.device, N, PIXEL_OUTPUTS))
            draw(self.distribution.map, self.distribution.cdf, sequence_points(N, 0, "independent"), out)

        yield self._stage("sample pixels", run, work, N=N)

    def median_cut(self, N: int) -> Stage:
        """N lights by median cut."""
        # The map twice, before and after the cuts, and a table of 8 bytes per pixel in between.
        work = Work((12 + 8 + 12) * self.pixels, 17 * self.pixels, self.pixels, "pixels")
        return self._stage("median cut", lambda: median_cut(self.distribution, N), work, N=N)

    def images(self, resolution: int) -> Iterator[Stage]:
        """The exact image, and the images of the per-pixel estimators."""
        mask = disc_mask(resolution)
        disc = int(mask.sum())
        # Prefix sums of 9 numbers over the map; and for each pixel and each row that its horizon cuts, a difference of
        # two entries and a sum.
        n_y = (2.0 * np.arange(resolution) + 1 - resolution) / resolution
        arcs = self.envmap.height * float(mask.sum(axis=1) @ (1 - 2 / np.pi * np.arcsin(np.abs(n_y))))
        pairs = float(disc) * self.pixels
        image = 12 * resolution**2
        work = Work(12 * self.pixels + image, 9 * self.pixels + 18 * arcs, pairs, "pairs", pairs)
        run = partial(exact, self.device, self.distribution.map, resolution)
        yield self._stage("exact", run, work, resolution=resolution)
        count = disc * SPP
        for estimator in ESTIMATORS:
            by_light, by_cosine = ESTIMATORS[estimator].operations
            operations = float(by_light + by_cosine)
            if estimator == "mis":  # two directions
                share = choose_share(self.distribution)
                operations = 2 * (share * by_light + (1 - share) * by_cosine)
            work = Work(image + 16 * min(count, self.pixels), operations * count, count, "samples")

            def all_spp(estimator: str = estimator) -> None:
                list(render(self.distribution, [SPP], resolution, estimator=estimator, sequence="sobol"))

            yield self._stage(estimator, all_spp, work, resolution=resolution, N=SPP)


def shading(device: Device, distribution: Distribution, N: int, resolution: int) -> Iterator[Stage]:
    """The sphere lit by N samples: as lightdome does it, and by evaluating every pair of pixel and light."""
    lights = Lights.of(distribution.sample(N))
    pairs = float(N) * int(disc_mask(resolution).sum())
    for brute_force in (False, True):
        work = Work(12 * resolution**2 + 24 * N, PAIR * pairs, pairs, "pairs", pairs, skips=not brute_force)
        run = partial(shade, device, lights, resolution=resolution, brute_force=brute_force)
        yield Stage("shade brute force" if brute_force else "shade", run, work, resolution=resolution, N=N)


def harmonics(device: Device, resolution: int) -> Stage:
    """The sphere lit by spherical harmonics."""
    disc = int(disc_mask(resolution).sum())
    # A Legendre function by its recurrence; R, G, B with real and imaginary parts where A_l is not 0.
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
    """Yield (fraction of the plan done, next stage), to be run in turn: maps live only as long as their stages.

    One thing changes at a time: the map, 2 ``heights`` x ``heights`` pixels; the image's ``resolutions``; or the
    ``counts`` of samples or lights. The rest stays at ``envmap``, ``resolution`` and ``N``.
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
