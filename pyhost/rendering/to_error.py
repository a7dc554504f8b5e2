"""Render until the error is small enough, or until the time is up: samples are added while they are needed.

The image is the average of N independent images, whose spread estimates its error (:mod:`.estimate`). All of them
continue together, so each has the good points of its sequence, and no sample is thrown away.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .. import checks
from ..disc import disc_mask
from ..lighting.exact import exact
from ..names import SEED
from ..opencl import memory
from ..progress import Progress
from ..sampling.distribution import Distribution
from ..sampling.draw import philox_key
from .estimate import ErrorEstimate, estimate_error
from .per_pixel import Plan, build_sampler, is_black, planned

IMAGES = 4  # whose spread is measured
FIRST = 4  # samples per pixel of each image in the first round; later numbers are multiples of it
MOST = 2**16  # the same, after which rendering ends in any case
SMALLEST = 1e-5  # error that can be asked for: single precision is not far below
FACTOR = 4  # most by which a round increases the samples
SMALL = 64  # pixels across the exact image that says how bright an image of ``bsdf`` must be
UNLIKE = 0.01  # of its mean, by which that of another resolution may differ


@dataclass(frozen=True, eq=False)
class Rendered(ErrorEstimate):
    """An image and its error, see :class:`ErrorEstimate`, and why it was enough.

    - ``spp``: samples per pixel of all images together
    - ``seconds``: wall time
    - ``reason``: ``error``, the interval's upper end is at most the target; ``time``, the time was up; ``limit``, the
      largest number of samples was reached; or ``light``, one of these two, and the samples have missed light of the
      map, so the error is larger than estimated
    """

    spp: int
    seconds: float
    reason: Literal["error", "time", "limit", "light"]


def seeds_of(seed: int) -> list[int]:
    """The seeds of the independent images, as :func:`lightdome.rendering.render` takes them."""
    seed = checks.whole("a seed", seed, 0, 2**64 - 1)
    return [int(word) for word in np.random.SeedSequence(seed).generate_state(IMAGES, np.uint64)]


def render_to_error(
    distribution: Distribution,
    error: float,
    seconds: float | None = None,
    resolution: int = 511,
    albedo: float = 1.0,
    seed: int = SEED,
    estimator: str = "product",
    sequence: str = "lattice",
    mis_compensation: bool = False,
    within: Literal["centre", "pixel"] | None = None,
) -> Rendered:
    """Render until the relative RMSE is at most ``error``, or for ``seconds`` of wall time, whichever comes first.

    The relative RMSE is estimated without the exact image, and the upper end of its interval of 95 % must be at most
    ``error``, a fraction from 1e-5 to 1. After ``seconds``, the image so far is returned, of 16 samples per pixel at
    least. Without them, rendering ends after 2^18 samples per pixel. Other arguments are those of
    :func:`lightdome.rendering.render`, of which the result is the average over the seeds :func:`seeds_of`. With
    ``seconds``, the number of samples depends on the machine. A pixel of the image takes about 200 bytes of memory.

    The estimate knows only what samples have found, and directions of the cosine may miss a small sun. With ``bsdf``,
    rendering therefore goes on while the image is darker than the exact image by more than chance and 1 %. Raises
    :class:`LightdomeError` as ``render`` does, and for an error or time out of range.
    """
    start = time.perf_counter()
    plan = planned(distribution, resolution, albedo, estimator, sequence, mis_compensation, within)
    error = checks.real("the error", error, f"a fraction from {SMALLEST:g} to 1", SMALLEST, 1)
    end = math.inf if seconds is None else start + checks.positive("the time in seconds", seconds)
    keys = [philox_key(each) for each in seeds_of(seed)]
    device, shape = distribution.device, (plan.resolution, plan.resolution, 3)
    sampler = None
    if not is_black(plan):
        totals = [memory.zeros(device, (2, *shape), np.float32) for _ in keys]
        brightness = _brightness(plan) if estimator == "bsdf" else 0.0
        sampler = build_sampler(plan)
    if sampler is None:
        black, no_error = np.zeros(shape, np.float32), np.zeros(shape[:2], np.float32)
        return Rendered(black, no_error, 0.0, (0.0, 0.0), 0, time.perf_counter() - start, "error")

    spp, wanted, needed = 0, FIRST, FIRST  # of each image; needed is a guess
    a_sample = judging = 0.0  # seconds that they took last: a sample of every pixel, and an estimate
    sampler.add(keys[0], 0, 0, FIRST, totals[0])  # the first launch builds the kernel, and is not timed
    device.wait()
    rounds: list[tuple[int, float]] = []
    with Progress(f"rendering to {100 * error:g} %") as progress:
        while True:
            before = spp
            while spp < wanted:
                now = time.perf_counter()
                step = min(max(sampler.step, FIRST), wanted - spp, _fitting(end - judging - now, a_sample))
                step -= step % FIRST
                if step == 0 and spp > 0:
                    break
                step = max(FIRST, step)
                for key, total in zip(keys, totals, strict=True):
                    for begin in range(spp, spp + step, sampler.step):
                        sampler.add(key, begin, min(begin + sampler.step, spp + step), FIRST, total)
                        device.wait()
                spp += step
                a_sample = (time.perf_counter() - now) / step
                progress.update(min(1.0, spp / needed))
            if spp > before:
                now = time.perf_counter()
                found = estimate_error([sampler.image(device, total, spp) for total in totals])
                judging = time.perf_counter() - now
                rounds.append((spp, found.interval[1]))
            missed = _is_darker(found, brightness)
            reason: Literal["error", "time", "limit", "light"] | None = None
            if found.interval[1] <= error and not missed:
                reason = "error"
            elif spp < wanted or spp == MOST:
                reason = "light" if missed else "time" if spp < wanted else "limit"
            if reason:
                return Rendered(**vars(found), spp=IMAGES * spp, seconds=time.perf_counter() - start, reason=reason)
            needed = MOST if missed else _needed(rounds, error)
            wanted = min(_rounded(needed), FACTOR * spp, MOST)


def _brightness(plan: Plan) -> float:
    """The mean of the exact image over the sphere."""
    of_map, resolution = plan.distribution.map, min(plan.resolution, SMALL)
    image = exact(plan.distribution.device, of_map, resolution, plan.albedo, "areas")
    return float(image[disc_mask(resolution)].mean(dtype=np.float64))


def _is_darker(found: ErrorEstimate, brightness: float) -> bool:
    """Whether the image's mean is below ``brightness`` by more than its noise explains: four standard deviations."""
    inside = disc_mask(len(found.image))
    noise = np.linalg.norm(found.error[inside].astype(np.float64)) / inside.sum()
    mean = found.image[inside].mean(dtype=np.float64)
    return bool((1 - UNLIKE) * brightness - mean > 4 * noise)


def _fitting(left: float, a_sample: float) -> int:
    """How many samples fit into the seconds ``left``; 0 if the time of one is not known yet."""
    if math.isinf(left):
        return MOST
    return int(min(MOST, max(0.0, left) / a_sample)) if a_sample else 0


def _needed(rounds: list[tuple[int, float]], error: float) -> int:
    """The number of samples that should reach ``error``, from the numbers and errors of the rounds so far."""
    (spp, reached), exponent = rounds[-1], 0.5
    if len(rounds) > 1 and all(math.isfinite(end) for _, end in rounds[-2:]):
        fewer, larger = rounds[-2]
        exponent = min(1.0, max(0.5, math.log(larger / reached) / math.log(spp / fewer)))
    return math.ceil(min(MOST, spp * (reached / error) ** (1 / exponent)))


def _rounded(spp: int) -> int:
    """The next number of at most three binary digits: the points of a sequence are better there than in between."""
    part = max(FIRST, 2 ** (spp.bit_length() - 3))
    return -(-spp // part) * part
