"""The cheapest method that reaches an error on one map and device, found by measuring them on a small image.

The small image's truth is its exact image, which takes milliseconds on a map of 1024 x 512 pixels. The errors of lights
and harmonics are smooth, and those of samples per pixel do not depend on the resolution, so their relative RMSE on a
large image is nearly the same. Times are measured at two resolutions, and from there on are assumed to grow with the
number of pixels. The first run of each method, which may build kernels, is not timed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from .. import checks
from ..disc import check_resolution, disc_mask
from ..float_range import to_float32
from ..lighting.exact import exact
from ..lighting.harmonics import project, shade_harmonics
from ..lighting.median_cut import median_cut
from ..lighting.shade import shade, shade_samples
from ..names import ESTIMATORS, PIXEL_SEQUENCES, SEED, WITHIN, per_pixel
from ..progress import Progress
from ..rendering.estimate import estimate_error
from ..rendering.per_pixel import render
from ..rendering.to_error import FACTOR, FIRST, IMAGES, MOST, SMALLEST, render_to_error
from ..sampling.distribution import Distribution
from .metrics import relative_rmse

SMALL, LARGER = 64, 192  # pixels across the images on which errors and times are measured
MARGIN = 0.95  # of the error asked for, since that of another resolution differs
SHARED = {  # orders, lights and samples to try
    "harmonics": (2, 4, 6, 8, 10, 12, 16, 24, 32),
    "median-cut": (16, 64, 256, 1024),
    "lattice": (64, 256, 1024, 4096, 16384),
}
TRIED = FIRST, 16 * FIRST  # samples per pixel
LONG = 0.1  # seconds of a run that need not be measured again

Run = Callable[[int], np.ndarray]  # (resolution) -> image


@dataclass(frozen=True)
class Choice:
    """A method that should reach an error.

    - ``method``: ``exact``, ``harmonics``, ``median-cut``, ``lattice`` (samples that all pixels share), or an estimator
      and a sequence, as the benchmark names them
    - ``count``: the order of harmonics, the number of lights or samples, or about the samples per pixel
    - ``error``: its relative RMSE on a small image
    - ``seconds``: its predicted wall time at the resolution asked for, with a map and its CDFs on the device
    """

    method: str
    count: int
    error: float
    seconds: float

    def __str__(self) -> str:
        counts = {
            "exact": "",
            "harmonics": f" of order {self.count}",
            "median-cut": f" with {self.count} lights",
            "lattice": f" with {self.count} samples for all pixels",
        }
        count = counts.get(self.method, f" with {self.count} spp")
        return f"{self.method}{count}: {shown(self.seconds)}, error {100 * self.error:.2g} %"


@dataclass(frozen=True, eq=False)
class CheapestImage:
    """The image of the cheapest method.

    - ``image``: (R, R, 3) float32, radiance
    - ``error``: (R, R) float32, radiance: the error of each pixel, root mean square of the channels. For a method that
      is not per pixel it is that of the small image, enlarged
    - ``rmse``, ``interval``: the relative RMSE, and its interval of 95 % where samples per pixel estimate it
    - ``choices``: all methods measured that should reach the error, the cheapest first
    - ``seconds``: the wall time of the image alone
    - ``reason``: why samples per pixel ended, as in :class:`lightdome.rendering.Rendered`; None for another method
    """

    image: np.ndarray
    error: np.ndarray
    rmse: float
    interval: tuple[float, float] | None
    choices: list[Choice]
    seconds: float
    reason: Literal["error", "time", "limit", "light"] | None


def shown(seconds: float) -> str:
    """A time for people to read."""
    if seconds < 0.1:
        return f"{1e3 * seconds:.2g} ms"
    return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"


def render_cheapest(
    distribution: Distribution,
    error: float,
    resolution: int = 511,
    albedo: float = 1.0,
    seed: int = SEED,
    within: Literal["centre", "pixel"] | None = None,
) -> CheapestImage:
    """Measure which method reaches the relative RMSE ``error`` in the least time, and render with it.

    The methods are the exact image, harmonics, median cut, samples shared by all pixels, and the estimators with fresh
    samples for every pixel. They are compared with the exact image of centres, or with that of areas for
    ``within="pixel"``. Raises :class:`LightdomeError` for an error outside 1e-5 to 1, and as
    :func:`lightdome.rendering.render` does.
    """
    checks.instance("the distribution", distribution, Distribution)
    error = checks.real("the error", error, f"a fraction from {SMALLEST:g} to 1", SMALLEST, 1)
    resolution, albedo = check_resolution(resolution), checks.albedo(albedo)
    if within is not None:
        checks.choice("place within a pixel", within, WITHIN)
    trial = _Trial(distribution, error, resolution, seed, within, albedo)
    choices: list[Choice] = []
    with Progress("measuring methods") as progress:
        for choice in trial.choices():
            choices.append(choice)
            progress.update(len(choices) / (len(SHARED) + 1 + len(trial.per_pixel)))  # at most so many
    choices.sort(key=lambda choice: choice.seconds)
    best = choices[0]
    if best.method in trial.per_pixel:
        estimator, sequence = trial.per_pixel[best.method]
        distribution.device.decisions.take()  # those of trials are not those of the image
        found = render_to_error(distribution, error, None, resolution, albedo, seed, estimator, sequence, within=within)
        return CheapestImage(found.image, found.error, found.rmse, found.interval, choices, found.seconds, found.reason)
    run = trial.run(best.method, best.count)
    of_pixels = np.sqrt(((run(trial.small) - trial.truth.astype(np.float64)) ** 2).mean(axis=2))
    distribution.device.decisions.take()
    start = time.perf_counter()
    image = run(resolution)
    seconds = time.perf_counter() - start
    nearest = np.arange(resolution) * trial.small // resolution
    enlarged = np.where(disc_mask(resolution), of_pixels[np.ix_(nearest, nearest)], 0)
    return CheapestImage(image, to_float32(enlarged), best.error, None, choices, seconds, None)


class _Trial:
    """Measures methods on small images."""

    def __init__(
        self, distribution: Distribution, error: float, resolution: int, seed: int, within: str | None, albedo: float
    ) -> None:
        self.distribution, self.error, self.resolution, self.seed = distribution, error, resolution, seed
        self.albedo = albedo
        self.within: Any = within
        self.pixels: Any = "areas" if within == "pixel" else "centres"
        self.small, self.larger = min(resolution, SMALL), min(resolution, LARGER)
        self.truth = self.run("exact", 1)(self.small)
        self.per_pixel = {
            per_pixel(estimator, sequence): (estimator, sequence)
            for estimator, facts in ESTIMATORS.items()
            if self.pixels in ("areas", facts.pixels)
            for sequence in reversed(PIXEL_SEQUENCES)  # the best first
        }

    def run(self, method: str, count: int) -> Run:
        """A function from a resolution to the method's image."""
        albedo, distribution = self.albedo, self.distribution
        device, of_map = distribution.device, distribution.map
        if method == "exact":
            return lambda resolution: exact(device, of_map, resolution, albedo, self.pixels)
        if method == "harmonics":
            return lambda resolution: shade_harmonics(device, project(device, of_map, count), resolution, albedo)
        if method == "median-cut":
            return lambda resolution: shade(
                device, median_cut(distribution, count), resolution=resolution, albedo=albedo
            )
        if method == "lattice":
            within = self.within or "centre"
            return lambda resolution: shade_samples(
                device, distribution.sample(count, self.seed, "lattice", within), resolution, albedo
            )
        estimator, sequence = self.per_pixel[method]
        return lambda resolution: next(
            render(distribution, [count], resolution, albedo, self.seed, estimator, sequence, within=self.within)
        )[1]

    def one_round(self, method: str) -> Run:
        """A function from a resolution to the image of a single round of :func:`render_to_error`."""
        estimator, sequence = self.per_pixel[method]
        return lambda resolution: (
            render_to_error(
                self.distribution,
                SMALLEST,
                1e-9,
                resolution,
                self.albedo,
                self.seed,
                estimator,
                sequence,
                within=self.within,
            ).image
        )

    def off(self, run: Run) -> float:
        """The relative RMSE of the small image."""
        mask = disc_mask(self.small)
        return relative_rmse(run(self.small)[mask], self.truth[mask])

    def seconds(self, run: Run, copies: int = 1) -> float:
        """The time of an image of the resolution asked for, of which ``copies`` times the pixels' share is needed."""
        shorter, longer = (self.shortest(run, size) for size in (self.small, self.larger))
        if self.larger == self.small:
            return copies * longer
        of_pixel = max(0.0, longer - shorter) / (self.larger**2 - self.small**2)
        return longer + of_pixel * (copies * self.resolution**2 - self.larger**2)

    @staticmethod
    def shortest(run: Run, resolution: int) -> float:
        """The shortest of three runs, or fewer if one takes long."""
        walls: list[float] = []
        while len(walls) < 3 and max(walls, default=0) < LONG:
            start = time.perf_counter()
            run(resolution)
            walls.append(time.perf_counter() - start)
        return min(walls)

    def choices(self) -> Iterator[Choice]:
        """All methods that should reach the error."""
        whole = self.run("exact", 1)
        yield (best := Choice("exact", 1, 0.0, self.seconds(whole)))
        if not self.truth.any():
            return
        for method, counts in SHARED.items():
            for count in counts:
                run = self.run(method, count)
                off = self.off(run)
                if off <= MARGIN * self.error:
                    yield (choice := Choice(method, count, off, self.seconds(run)))
                    best = min(best, choice, key=lambda each: each.seconds)
                    break
        for method in self.per_pixel:
            first, more = (self.run(method, count) for count in TRIED)
            once = self.one_round(method)
            once(self.small)  # builds the kernels
            fewest = self.seconds(once)
            if fewest >= best.seconds:  # and the other estimators need about as much
                return
            sampled = self.with_samples(method, first, more, fewest)
            if sampled:
                yield sampled
                best = min(best, sampled, key=lambda each: each.seconds)

    def with_samples(self, method: str, first: Run, more: Run, fewest: float) -> Choice | None:
        """The ``method`` with fresh samples for every pixel, from images of TRIED samples; None if it cannot reach it.

        Its image is the average of several, see :func:`lightdome.rendering.render_to_error`.
        """
        errors = [max(self.off(run), SMALLEST) for run in (first, more)]  # not 0, as in even light
        exponent = min(1.0, max(0.5, math.log(errors[0] / errors[1]) / math.log(TRIED[1] / TRIED[0])))
        wanted = TRIED[1] * (errors[1] / math.sqrt(IMAGES) / (MARGIN * self.error)) ** (1 / exponent)
        if wanted > MOST:
            return None
        spp = max(TRIED[0], math.ceil(wanted))
        least, most = (self.seconds(run, IMAGES) for run in (first, more))
        a_sample = max(most - least, most / 2) / (TRIED[1] - TRIED[0])  # not 0, as by an unlucky measurement
        estimates = math.ceil(math.log(spp / FIRST, FACTOR))  # after the first, which ``fewest`` has
        estimate = self.seconds(lambda size: estimate_error([np.ones((size, size, 3), np.float32)] * IMAGES).image)
        return Choice(method, IMAGES * spp, self.error, fewest + (spp - TRIED[0]) * a_sample + estimates * estimate)
